"""Robots for end-effector commands that each break the contract in one way."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from drivers import (
    Acceptance,
    AppliedCommand,
    Command,
    EndEffectorCommand,
    Mode,
    MonotonicClock,
    ResetRequest,
    ResetResult,
    RobotState,
)
from tests.drivers.fake_robot import FakeRobot, fake_spec


class AppliesAfterDisarm(FakeRobot):
    def _hold(self) -> None:
        self._called("hold")


class RepeatsItsLastCommand(FakeRobot):
    def _advance(self) -> None:
        pending = self.pending
        super()._advance()
        self.pending = pending


class DriftsWhileHeld(FakeRobot):
    def _advance(self) -> None:
        self.position = self.position + np.array([0.0, 0.002, 0.0])
        super()._advance()


class CountsTicksTwice(FakeRobot):
    def _advance(self) -> None:
        self.seq += 1
        super()._advance()


class StampsEveryOtherTick(FakeRobot):
    def _advance(self) -> None:
        stamp_ns = self.stamp_ns
        super()._advance()
        if self.seq % 2:
            self.stamp_ns = stamp_ns


class NeverWaits(FakeRobot):
    def __init__(self) -> None:
        super().__init__(clock=MonotonicClock())

    def _advance(self) -> None:
        self.seq += 1
        self.stamp_ns = self._clock.now_ns()


class AlwaysMissesATick(FakeRobot):
    def _advance(self) -> None:
        self.lost_ticks = 1
        super()._advance()


class StopsAtTheNextTick(FakeRobot):
    pressed: str | None = None

    def stop(self, reason: str, fault: str = "emergency_stop") -> None:
        self.pressed = reason

    def advance(self) -> None:
        super().advance()
        if self.pressed is not None:
            super().stop(self.pressed)


class ForgetsItsStop(FakeRobot):
    def close(self) -> None:
        super().close()
        if self.fault is not None:
            self.clear_fault(self.fault.name)


class KeepsTheLatestStop(FakeRobot):
    def stop(self, reason: str, fault: str = "emergency_stop") -> None:
        if self.fault is not None:
            self.clear_fault(self.fault.name)
        super().stop(reason, fault)


class ArmsWhenCleared(FakeRobot):
    def clear_fault(self, name: str) -> None:
        super().clear_fault(name)
        self.arm()


class ReportsWhatWasAsked(FakeRobot):
    def command(self, command: Command) -> Acceptance:
        self.asked = command
        return super().command(command)

    def _read(self) -> RobotState:
        state = super()._read()
        if state.applied is None:
            return state
        return dataclasses.replace(state, applied=AppliedCommand(state.applied.tick, self.asked))


class SaysNotWhyItClips(FakeRobot):
    def _apply(self, command: Command, clipped: tuple[str, ...]) -> None:
        super()._apply(command, ())


class RefusesWithoutCounting(FakeRobot):
    def command(self, command: Command) -> Acceptance:
        answer = super().command(command)
        self._gate._refusals.clear()
        return answer


class NeverExpires(FakeRobot):
    def command(self, command: Command) -> Acceptance:
        if self._gate._ages.age_ns(command.answers) is not None:
            self._gate._ages.add(command.answers, self.clock.now_ns())
        return super().command(command)


class AnswersAnyState(FakeRobot):
    def command(self, command: Command) -> Acceptance:
        return super().command(dataclasses.replace(command, answers=self.read().seq))


class TakesNumbersThatAreNone(FakeRobot):
    def command(self, command: Command) -> Acceptance:
        return self._gate.judge(command)


class GivesWritableArrays(FakeRobot):
    def _read(self) -> RobotState:
        state = super()._read()
        state.ee_pos.setflags(write=True)
        return state


class SharesItsBuffer(FakeRobot):
    def __init__(self) -> None:
        super().__init__()
        self.buffer = np.array(self.spec.home.ee_pos)

    def _read(self) -> RobotState:
        self.buffer.setflags(write=True)
        self.buffer[:] = self.position
        return dataclasses.replace(super()._read(), ee_pos=self.buffer)


class MeasuresInMillimetres(FakeRobot):
    def _read(self) -> RobotState:
        state = super()._read()
        return dataclasses.replace(state, ee_linvel=state.ee_linvel * 1000.0)


class HasOneFinger(FakeRobot):
    def _read(self) -> RobotState:
        return dataclasses.replace(super()._read(), fingers_pos=np.zeros(1))


class TurnsWithLongQuaternions(FakeRobot):
    def _read(self) -> RobotState:
        return dataclasses.replace(super()._read(), ee_quat=np.array([2.0, 0.0, 0.0, 0.0]))


class LosesItsObject(FakeRobot):
    def _read(self) -> RobotState:
        return dataclasses.replace(super()._read(), objects={})


class IsAlwaysMoving(FakeRobot):
    def _mode(self, moving: bool) -> Mode:
        return super()._mode(True)


class ResetsWhileArmed(FakeRobot):
    def reset(self, request: ResetRequest) -> ResetResult:
        self.disarm()
        return super().reset(request)


class StaysOpen(FakeRobot):
    def __exit__(self, *error: object) -> None:
        self.disarm()


class PlacesWhatItHasNot(FakeRobot):
    def _reset(self, request: ResetRequest) -> ResetResult:
        return super()._reset(ResetRequest())


class NeverGoesHome(FakeRobot):
    def _reset(self, request: ResetRequest) -> ResetResult:
        position = self.position
        result = super()._reset(request)
        self.position = position
        return result


class LeavesTheObjectWhereItIs(FakeRobot):
    def _reset(self, request: ResetRequest) -> ResetResult:
        place = self.place
        result = super()._reset(request)
        self.place = place
        return result


class RemembersTheLastEpisode(FakeRobot):
    def _reset(self, request: ResetRequest) -> ResetResult:
        applied = self.applied
        result = super()._reset(request)
        self.applied = applied
        return result


class IsAnotherEachTime(FakeRobot):
    serial = itertools.count()

    def __init__(self) -> None:
        gains = {"kp": float(next(self.serial))}
        super().__init__(dataclasses.replace(fake_spec(), gains=gains))


class SharesItsPosition(FakeRobot):
    everywhere: AppliedCommand | None = None

    def _advance(self) -> None:
        super()._advance()
        if self.applied is not None:
            SharesItsPosition.everywhere = self.applied

    def _read(self) -> RobotState:
        return dataclasses.replace(super()._read(), applied=self.everywhere)


class OvershootsItsCommands(FakeRobot):
    """Moves further than it reports, also in its velocities."""

    def _move(self, command: EndEffectorCommand, clipped: tuple[str, ...]) -> None:
        super()._move(command, clipped)
        self.position = self.position + 2.0 * self.moved
