"""The robot that a host serves: a driver for each scene, and one tick counter and fault for all."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from drivers import (
    ObjectPose,
    ObjectSource,
    ResetRequest,
    ResetResult,
    RobotDriver,
    RobotSpec,
    RobotState,
)
from drivers.clock import Clock
from drivers.errors import InvalidRequest
from drivers.registry import make_in_first_scene
from drivers.remote.messages import POSE_SIZES, ObjectMessage
from drivers.state import AppliedCommand
from iher_robot.errors import UserError
from iher_robot.host.persistence import RobotMemory

PERCEPTION = "perception"
"""Source of object poses that come from another publisher than the robot."""


class ServedRobot:
    """A driver per scene, with one tick counter over all of them.

    A latched fault is saved, and latched again in the driver of the next scene or start.
    """

    def __init__(
        self,
        make: Callable[[str], RobotDriver],
        scene: str | None,
        memory: RobotMemory,
        perception: tuple[str, ...],
        clock: Clock,
    ) -> None:
        """Make the driver of a scene, not yet open.

        Args:
            make: Makes a driver for a scene.
            scene: The scene to start with; where None the first that the driver supports.
            memory: What the robot remembers over restarts of the host.
            perception: Objects whose poses come from another publisher.
            clock: The host's.

        Raises:
            UserError: The robot does not have an object of perception.
        """
        self._make = make
        self._memory = memory
        self._perception = frozenset(perception)
        self._clock = clock
        self._specs: dict[str, RobotSpec] = {}
        self._made: dict[str, RobotDriver] = {}  # described, and not yet used
        self._poses: dict[str, tuple[ObjectMessage, int]] = {}
        self.scene, self.driver = (
            make_in_first_scene(make) if scene is None else (scene, make(scene))
        )
        self.spec = self._spec_of(self.driver)
        missing = self._perception - self.spec.objects.keys()
        if missing:
            raise UserError(
                f"--perception names {', '.join(sorted(missing))}, objects of "
                f"{self.spec.name}: {', '.join(sorted(self.spec.objects)) or 'none'}"
            )
        self._specs[self.scene] = self.spec
        self._seq_offset = memory.ticks
        self._restore_fault()

    def describe(self, scene: str) -> RobotSpec:
        """Return the description of the robot in a scene.

        Raises:
            DriverError: There is no such scene.
        """
        if scene not in self._specs:
            self._made[scene] = self._make(scene)
            self._specs[scene] = self._spec_of(self._made[scene])
        return self._specs[scene]

    def has_described(self, scene: str) -> bool:
        """Whether the description of the robot in a scene is known without loading the scene."""
        return scene in self._specs

    def change_scene(self, scene: str) -> None:
        """Change to another scene. The robot is held and disarmed afterwards.

        Raises:
            DriverError: There is no such scene; the current one stays in use.
        """
        if scene == self.scene:
            return
        spec = self.describe(scene)
        driver = self._made.pop(scene, None) or self._make(scene)
        self.driver.disarm()
        last = self.state().seq
        old = self.driver
        old.close()
        self.driver, self.scene, self.spec = driver, scene, spec
        self._poses.clear()
        self._restore_fault()
        if old.fault is not None:  # stopped while the scene changed
            driver.stop(old.fault.reason, old.fault.name)
        self.driver.open()
        self._seq_offset = last + 1 - self.driver.measure().seq

    def open(self) -> None:
        """Connect; the tick counter continues above that of the last time the robot was served."""
        self.driver.open()
        if self._memory.human_needed:
            self.driver.expect_human()
        self._seq_offset = self._memory.ticks + 1 - self.driver.measure().seq

    def reset(self, request: ResetRequest) -> ResetResult:
        """Reset, and save whether the robot needs a human."""
        try:
            return self.driver.reset(request)
        finally:
            self._memory.save_human_needed(self.driver.after_human_help)

    def close(self) -> None:
        """Hold, disarm and disconnect."""
        self.driver.close()

    def driver_seq(self, seq: int) -> int:
        """Convert a sequence of this host's tick counter to the driver's."""
        return seq - self._seq_offset

    def state(self) -> RobotState:
        """Return the newest state, with this host's tick counter and the poses of perception."""
        state = self.driver.measure()
        applied = state.applied
        if applied is not None:
            command = dataclasses.replace(
                applied.command, answers=applied.command.answers + self._seq_offset
            )
            applied = AppliedCommand(applied.tick + self._seq_offset, command, applied.clipped)
        objects = {n: pose for n, pose in state.objects.items() if n not in self._perception}
        objects |= {name: self._pose(name, state.stamp_ns) for name in self._poses}
        return dataclasses.replace(
            state, seq=state.seq + self._seq_offset, applied=applied, objects=objects
        )

    def take_pose(self, name: str, message: ObjectMessage) -> None:
        """Take the pose of an object from another publisher; one older than the last is dropped.

        Raises:
            InvalidRequest: The robot has no such object, it is not an object of perception, or the
                pose is in another frame, of a wrong shape or not finite.
        """
        if name not in self._perception or name not in self.spec.objects:
            allowed = ", ".join(sorted(self._perception & self.spec.objects.keys())) or "none"
            raise InvalidRequest(
                f"pose is of object {name!r:.40}, which is not one of perception, allowed: "
                f"{allowed}"
            )
        frame = self.spec.objects[name].frame
        if message.frame != frame:
            raise InvalidRequest(
                f"pose of {name!r} is in frame {message.frame!r:.40}, allowed: {frame!r}"
            )
        for field, size in POSE_SIZES.items():
            value = getattr(message, field)
            if value.shape != (size,):
                raise InvalidRequest(
                    f"{field} of {name!r} has shape {value.shape}, allowed: ({size},)"
                )
            if not np.isfinite(value).all():
                raise InvalidRequest(f"{field} of {name!r} is {value}, allowed: finite numbers")
        known = self._poses.get(name)
        if known is None or message.n > known[0].n:
            self._poses[name] = (message, self._clock.now_ns())

    def stop(self, reason: str, fault: str) -> None:
        """Stop, latch the fault and save it. Thread-safe, also while another scene is loaded.

        Args:
            reason: What happened, for people.
            fault: Name of the fault.
        """
        while True:
            driver = self.driver
            driver.stop(reason, fault)
            self.save_fault()
            if driver is self.driver:
                return

    def save_fault(self) -> None:
        """Save the latched fault, if it has changed."""
        self._memory.save_fault(lambda: self.driver.fault)

    def _pose(self, name: str, now_ns: int) -> ObjectPose:
        message, received_ns = self._poses[name]
        age_ns = self._clock.now_ns() - received_ns + round(message.age_s * 1e9)
        return ObjectPose(
            pos=message.pos.copy(),
            quat=message.quat.copy(),
            linvel=message.linvel.copy(),
            angvel=message.angvel.copy(),
            stamp_ns=now_ns - age_ns,
            source=PERCEPTION,
            frame=message.frame,
        )

    def _spec_of(self, driver: RobotDriver) -> RobotSpec:
        spec = driver.spec
        objects = {
            name: ObjectSource(PERCEPTION, source.frame, source.max_age_s)
            if name in self._perception
            else source
            for name, source in spec.objects.items()
        }
        return dataclasses.replace(spec, objects=objects) if self._perception else spec

    def _restore_fault(self) -> None:
        fault = self._memory.fault
        if fault is not None:
            self.driver.stop(fault.reason, fault.name)
