"""A fake robot that follows commands exactly, with injectable faults."""

from __future__ import annotations

import threading

import numpy as np

from drivers import (
    ActionSpec,
    AppliedCommand,
    Box,
    Clock,
    Command,
    EndEffectorCommand,
    GripperLimits,
    Home,
    InvalidRequest,
    JointLimits,
    Limits,
    ObjectPose,
    ObjectSource,
    ResetOutcome,
    ResetRequest,
    ResetResult,
    RobotDriver,
    RobotSpec,
    RobotState,
    SimulatedClock,
)

PERIOD_S = 0.04
PERIOD_NS = 40_000_000


def fake_spec() -> RobotSpec:
    return RobotSpec(
        name="fake",
        command_kinds=("ee_delta",),
        action=ActionSpec(),
        control_period_s=PERIOD_S,
        frame="world",
        objects={"object0": ObjectSource("camera", "world", max_age_s=0.2)},
        finger_names=("right", "left"),
        limits=Limits(
            joints={"shoulder": JointLimits(-1.0, 1.0, 2.0, 3.0)},
            gripper=GripperLimits(0.0, 0.05, 0.1),
            max_ee_speed_m_s=2.5,
            workspace=Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
            watchdog_s=0.1,
            reduced_speed_scale=0.25,
        ),
        gains={"kp": 100.0},
        calibration_id="2024-05-01",
        kinematic_model="abc",
        home=Home((0.5, 0.5, 0.5), (1.0, 0.0, 0.0, 0.0), {"object0": 0.4}),
        physical=True,
        hold_on_silence_s=0.2,
        enforces_joint_limits=True,
    )


class FakeRobot(RobotDriver):
    """Moves by ``delta_pos`` each tick.

    Attributes:
        clock: Its simulated clock, which the test may advance.
        calls: Hooks called, in order.
        failing: Hooks that raise.
        outcomes: Outcomes of the next resets, done when empty.
        lost_ticks: Ticks that pass without a state in the next `advance`.
        frozen: Whether `advance` leaves state and stamp unchanged.
        clip_to_m: Greatest displacement that it applies along an axis.
        camera_age_ns: Age of the object's pose at each measurement.
        waiting: Set while `advance` waits for `released`, if `slow` is set.
    """

    def __init__(self, spec: RobotSpec | None = None, clock: Clock | None = None) -> None:
        self.clock = SimulatedClock()
        super().__init__(fake_spec() if spec is None else spec, clock or self.clock)
        self.calls: list[str] = []
        self.failing: set[str] = set()
        self.outcomes: list[ResetOutcome] = []
        self.lost_ticks = 0
        self.frozen = False
        self.clip_to_m = np.inf
        self.camera_age_ns = 0
        self.slow = False
        self.waiting = threading.Event()
        self.released = threading.Event()
        self.position = np.array(self.spec.home.ee_pos)
        self.place = np.array([0.6, 0.6, 0.4])
        self.moved = np.zeros(3)
        self.pending: tuple[EndEffectorCommand, tuple[str, ...]] | None = None
        self.applied: AppliedCommand | None = None
        self.seq = 0
        self.stamp_ns = 0

    def _called(self, hook: str) -> None:
        self.calls.append(hook)
        if hook in self.failing:
            raise OSError(f"{hook} failed")

    def _open(self) -> None:
        self._called("open")
        self.stamp_ns = self._clock.now_ns()

    def _hold(self) -> None:
        self.pending = None
        self._called("hold")

    def _close(self) -> None:
        self._called("close")

    def _apply(self, command: Command, clipped: tuple[str, ...]) -> None:
        assert isinstance(command, EndEffectorCommand)
        self._called("apply")
        self.pending = (command, clipped)

    def _advance(self) -> None:
        self._called("advance")
        if self.slow:
            self.waiting.set()
            assert self.released.wait(timeout=10.0)
        self._clock.sleep_until_ns(self._clock.now_ns() + self.spec.control_period_ns)
        if self.frozen:
            return
        self.seq += 1 + self.lost_ticks
        self.stamp_ns = self._clock.now_ns()
        self.moved = np.zeros(3)
        if self.pending is not None:
            self._move(*self.pending)
        self.pending = None

    def _move(self, command: EndEffectorCommand, clipped: tuple[str, ...]) -> None:
        self.moved = np.clip(command.delta_pos, -self.clip_to_m, self.clip_to_m)
        if (self.moved != command.delta_pos).any():
            command = EndEffectorCommand(command.answers, self.moved, command.finger_delta)
            clipped = (*clipped, "ee_speed")
        self.applied = AppliedCommand(self.seq, command, clipped)
        self.position = self.position + self.moved

    def _reset(self, request: ResetRequest) -> ResetResult:
        self._called("reset")
        for name, place in request.objects.items():
            if name not in self.spec.objects or not np.less(np.abs(place), 10.0).all():
                raise InvalidRequest(f"{name!r} at {place}, allowed: object0 within 10 m")
        outcome = self.outcomes.pop(0) if self.outcomes else ResetOutcome.DONE
        if outcome is ResetOutcome.DONE:
            self.position = np.array(self.spec.home.ee_pos)
            self.moved = np.zeros(3)
            for place in request.objects.values():
                self.place = np.array([*place, 0.4])
            self.applied = None
            self.seq += 1
            self.stamp_ns = self._clock.now_ns()
        return ResetResult(outcome, "the object fell off the table")

    def _read(self) -> RobotState:
        self._called("read")
        zero = np.zeros(3)
        pose = ObjectPose(
            self.place.copy(),
            np.array([1.0, 0.0, 0.0, 0.0]),
            zero.copy(),
            zero.copy(),
            self.stamp_ns - self.camera_age_ns,
            "camera",
            "world",
        )
        moving = self.applied is not None and self.applied.tick == self.seq
        return RobotState(
            seq=self.seq,
            stamp_ns=self.stamp_ns,
            q=np.zeros(1),
            dq=np.zeros(1),
            ee_pos=self.position.copy(),
            ee_quat=np.array([1.0, 0.0, 0.0, 0.0]),
            ee_linvel=self.moved / self.spec.control_period_s,
            ee_angvel=zero.copy(),
            fingers_pos=np.zeros(2),
            fingers_vel=np.zeros(2),
            mode=self._mode(moving),
            fault=None if self.fault is None else self.fault.name,
            applied=self.applied,
            objects={"object0": pose},
        )
