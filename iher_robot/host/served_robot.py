"""The robot that a host serves: its driver for a scene, and what the host adds to it."""

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
"""Source of poses that another publisher than the robot sends."""


class ServedRobot:
    """A driver, made anew for each scene, with one tick counter over all of them.

    Every fault that its driver latches is written down, and is latched again by the next one.
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
            scene: The one to begin with; the first that the driver has where None.
            memory: What the robot remembers.
            perception: Objects whose poses come from another publisher.
            clock: The host's.

        Raises:
            UserError: An object of perception that the robot does not have.
        """
        self._make = make
        self._memory = memory
        self._perception = frozenset(perception)
        self._clock = clock
        self._specs: dict[str, RobotSpec] = {}
        self._made: dict[str, RobotDriver] = {}  # described, and not yet used
        self._seen: dict[str, tuple[ObjectMessage, int]] = {}
        self.scene, self.driver = (
            make_in_first_scene(make) if scene is None else (scene, make(scene))
        )
        self.spec = self._spec_of(self.driver)
        missing = self._perception - self.spec.objects.keys()
        if missing:
            raise UserError(
                f"perception of {', '.join(sorted(missing))} is asked for, objects of "
                f"{self.spec.name}: {', '.join(sorted(self.spec.objects)) or 'none'}"
            )
        self._specs[self.scene] = self.spec
        self._ahead = memory.ticks
        self._latch_again()

    def describe(self, scene: str) -> RobotSpec:
        """Return the description of the robot in a scene.

        Raises:
            DriverError: There is no such scene.
        """
        if scene not in self._specs:
            self._made[scene] = self._make(scene)
            self._specs[scene] = self._spec_of(self._made[scene])
        return self._specs[scene]

    def knows(self, scene: str) -> bool:
        """Whether describing the robot in a scene takes no time."""
        return scene in self._specs

    def use(self, scene: str) -> None:
        """Change to another scene. The robot is held and disarmed afterwards.

        Raises:
            DriverError: There is no such scene, and the old one stays.
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
        self._seen.clear()
        self._latch_again()
        if old.fault is not None:  # a stop came meanwhile
            driver.stop(old.fault.reason, old.fault.name)
        self.driver.open()
        self._ahead = last + 1 - self.driver.measure().seq

    def open(self) -> None:
        """Connect; the tick counter goes on where it was when the robot was last served."""
        self.driver.open()
        if self._memory.human:
            self.driver.expect_human()
        self._ahead = self._memory.ticks + 1 - self.driver.measure().seq

    def reset(self, request: ResetRequest) -> ResetResult:
        """Reset, and remember over a restart of the host whether a human was asked for."""
        try:
            return self.driver.reset(request)
        finally:
            self._memory.keep_human(self.driver.after_human_help)

    def close(self) -> None:
        """Hold, disarm and disconnect."""
        self.driver.close()

    def answers(self, seq: int) -> int:
        """Return a sequence as the driver counts."""
        return seq - self._ahead

    def state(self) -> RobotState:
        """Return the newest state, as this host counts, with the poses that others sent."""
        state = self.driver.measure()
        applied = state.applied
        if applied is not None:
            command = dataclasses.replace(
                applied.command, answers=applied.command.answers + self._ahead
            )
            applied = AppliedCommand(applied.tick + self._ahead, command, applied.clipped)
        objects = {n: pose for n, pose in state.objects.items() if n not in self._perception}
        objects |= {name: self._pose(name, state.stamp_ns) for name in self._seen}
        return dataclasses.replace(
            state, seq=state.seq + self._ahead, applied=applied, objects=objects
        )

    def see(self, name: str, message: ObjectMessage) -> None:
        """Take the pose of an object from another publisher; older ones are dropped.

        Raises:
            InvalidRequest: Nobody asked for poses of this object, or it is not of this robot.
        """
        if name not in self._perception or name not in self.spec.objects:
            wanted = ", ".join(sorted(self._perception & self.spec.objects.keys())) or "of none"
            raise InvalidRequest(f"pose of {name!r:.40} is not asked for; poses wanted: {wanted}")
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
        known = self._seen.get(name)
        if known is None or message.n > known[0].n:
            self._seen[name] = (message, self._clock.now_ns())

    def stop(self, reason: str, fault: str) -> None:
        """Stop, latch and write it down; from any thread, whatever scene is being loaded.

        Args:
            reason: What happened, in words.
            fault: Name under which it latches.
        """
        while True:
            driver = self.driver
            driver.stop(reason, fault)
            self.keep_fault()
            if driver is self.driver:
                return

    def keep_fault(self) -> None:
        """Write down the latched fault, if it has changed."""
        self._memory.keep(lambda: self.driver.fault)

    def _pose(self, name: str, now_ns: int) -> ObjectPose:
        message, received_ns = self._seen[name]
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

    def _latch_again(self) -> None:
        fault = self._memory.fault
        if fault is not None:
            self.driver.stop(fault.reason, fault.name)
