"""Robots for joint commands that each break the contract in one way."""

from __future__ import annotations

import dataclasses

import numpy as np

from drivers import Acceptance, Command, JointCommand, JointSetpoint, RobotState
from examples.line_robot import LineRobot


class StandsStill(LineRobot):
    def _read(self) -> RobotState:
        return dataclasses.replace(super()._read(), q=np.array(self.spec.home.ee_pos))


class StandsElsewhere(LineRobot):
    def _read(self) -> RobotState:
        state = super()._read()
        return dataclasses.replace(state, ee_pos=state.ee_pos + np.array([0.0, 0.1, 0.0]))


class StopsDead(LineRobot):
    def _hold(self) -> None:
        super()._hold()
        self._setpoint = JointSetpoint(self._setpoint.q, np.zeros(3), self._setpoint.fingers)


class CoastsWhileHeld(LineRobot):
    def _advance(self) -> None:
        setpoint = self._setpoint
        moving = self._pending is not None
        super()._advance()
        if not moving:
            q = setpoint.q + setpoint.dq * self.spec.control_period_s
            self._setpoint = JointSetpoint(q, setpoint.dq, setpoint.fingers)


class HidesItsSetpoint(LineRobot):
    def _read(self) -> RobotState:
        state = super()._read()
        return state if self.is_armed else dataclasses.replace(state, setpoint=None)


class IgnoresTheFilter(LineRobot):
    def command(self, command: Command) -> Acceptance:
        answer = super().command(command)
        if answer.accepted:
            self._pending = (command, ("joint_speed",))
        return answer


class OvershootsItsSetpoint(LineRobot):
    def _read(self) -> RobotState:
        state = super()._read()
        return dataclasses.replace(state, dq=state.dq * 3.0)


class SwapsTwoMotors(LineRobot):
    def _read(self) -> RobotState:
        state = super()._read()
        swapped = [0, 2, 1]
        q, dq = state.q[swapped].copy(), state.dq[swapped].copy()
        return dataclasses.replace(state, q=q, dq=dq, ee_pos=q, ee_linvel=dq)


class MeasuresNoSpeed(LineRobot):
    def _read(self) -> RobotState:
        return dataclasses.replace(super()._read(), dq=np.zeros(3))


class OpensItsFingersWhenHeld(LineRobot):
    def _advance(self) -> None:
        held = self._pending is None
        super()._advance()
        if held:
            self._setpoint = dataclasses.replace(self._setpoint, fingers=np.full(2, 0.05))


class GoesTheOtherWay(LineRobot):
    def _read(self) -> RobotState:
        state = super()._read()
        mirrored = 2.0 * np.array(self.spec.home.ee_pos) - state.q
        return dataclasses.replace(state, q=mirrored)


class TakesTheFirstCommandOfATick(LineRobot):
    def _apply(self, command: Command, clipped: tuple[str, ...]) -> None:
        if self._pending is None:
            super()._apply(command, clipped)


class CarriesOutOneAfterTheOther(LineRobot):
    def __init__(self) -> None:
        super().__init__()
        self._queue: list[tuple[Command, tuple[str, ...]]] = []

    def _apply(self, command: Command, clipped: tuple[str, ...]) -> None:
        self._queue.append((command, clipped))

    def _advance(self) -> None:
        if self._queue:
            super()._apply(*self._queue.pop(0))
        super()._advance()


class MovesSlower(LineRobot):
    """Reports a command within the limits as it was asked, and halves it."""

    def _apply(self, command: Command, clipped: tuple[str, ...]) -> None:
        assert isinstance(command, JointCommand)
        super()._apply(dataclasses.replace(command, dq=command.dq / 2.0), clipped)
