"""Resets that a person assists, including help requested earlier."""

from __future__ import annotations

import pytest

from drivers import HandsNotClear, ResetOutcome, ResetRequest, ResetResult
from iher_robot.env.operator import PENDING_HELP, reset_with_help
from tests.drivers.fake_robot import FakeRobot


class Clumsy(FakeRobot):
    """Needs help a number of times."""

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


def test_without_a_person_the_reset_needs_help() -> None:
    with Clumsy() as robot:
        result = reset_with_help(robot, ResetRequest(), None)
        assert result.outcome is ResetOutcome.NEEDS_HUMAN
        with pytest.raises(HandsNotClear):
            reset_with_help(robot, ResetRequest(), None)


def test_help_requested_earlier_must_be_confirmed() -> None:
    asked: list[str] = []
    with FakeRobot() as robot:
        robot.expect_human()
        assert reset_with_help(robot, ResetRequest(), asked.append).outcome is ResetOutcome.DONE
        assert robot.speed_scale == 1.0
    assert asked == [PENDING_HELP]


def test_nothing_moves_if_the_person_does_not_answer() -> None:
    def no_answer(message: str) -> None:
        raise EOFError

    with Clumsy() as robot:
        with pytest.raises(EOFError):
            reset_with_help(robot, ResetRequest(), no_answer)
        with pytest.raises(HandsNotClear):
            robot.arm()
