"""A person helps with a reset, also one that was asked for before."""

from __future__ import annotations

import pytest

from drivers import HandsNotClear, ResetOutcome, ResetRequest, ResetResult
from iher_robot.env.operator import ASKED_BEFORE, reset_with_help
from tests.drivers.fake_robot import FakeRobot


class Clumsy(FakeRobot):
    """Needs a hand so many times."""

    hands = 2

    def _reset(self, request: ResetRequest) -> ResetResult:
        if self.hands:
            self.hands -= 1
            return ResetResult(ResetOutcome.NEEDS_HUMAN, f"put it back ({self.hands})")
        return super()._reset(request)


def test_a_person_is_asked_until_it_is_done() -> None:
    asked: list[str] = []
    with Clumsy() as robot:
        assert reset_with_help(robot, ResetRequest(), asked.append).outcome is ResetOutcome.DONE
    assert asked == ["put it back (1)", "put it back (0)"]


def test_without_a_person_it_stays_undone() -> None:
    with Clumsy() as robot:
        result = reset_with_help(robot, ResetRequest(), None)
        assert result.outcome is ResetOutcome.NEEDS_HUMAN
        with pytest.raises(HandsNotClear):
            reset_with_help(robot, ResetRequest(), None)


def test_a_person_who_was_asked_before_is_asked_whether_it_is_done() -> None:
    asked: list[str] = []
    with FakeRobot() as robot:
        robot.expect_human()
        assert reset_with_help(robot, ResetRequest(), asked.append).outcome is ResetOutcome.DONE
        assert robot.speed_scale == 1.0
    assert asked == [ASKED_BEFORE]


def test_nothing_moves_if_the_person_does_not_answer() -> None:
    def nobody(message: str) -> None:
        raise EOFError

    with Clumsy() as robot:
        with pytest.raises(EOFError):
            reset_with_help(robot, ResetRequest(), nobody)
        with pytest.raises(HandsNotClear):
            robot.arm()
