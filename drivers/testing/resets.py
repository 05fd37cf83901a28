"""Contract of `reset`: robot at home, objects in place, no command left over."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest

from drivers import InvalidRequest, Mode, ResetRequest, RobotDriver, RobotSpec
from drivers.testing.suite import ContractSuite, must_raise

_TICKS = 10


class ResetTests(ContractSuite):
    """`reset` brings the robot home and the objects to the requested places."""

    def places(self, spec: RobotSpec) -> dict[str, tuple[float, float]]:
        """Return where the objects may lie, in the spec's frame, m; 10 cm around home."""
        x, y, _ = spec.home.ee_pos
        turns = {name: 2.0 * math.pi * i / len(spec.objects) for i, name in enumerate(spec.objects)}
        return {
            name: (x + 0.1 * math.cos(turn), y + 0.1 * math.sin(turn))
            for name, turn in turns.items()
        }

    def test_a_reset_brings_the_robot_home(self, driver: RobotDriver, kind: str) -> None:
        self.start(driver)
        for _ in range(_TICKS):
            self.tick(driver, self.samples(driver, kind))
        driver.disarm()
        self.reset(driver)
        state, home = driver.read(), driver.spec.home
        distance = float(np.linalg.norm(state.ee_pos - np.array(home.ee_pos)))
        assert distance <= self.home_tolerance, (
            f"after a reset the end effector must be at the home of the spec, {home.ee_pos}; it is "
            f"{distance:.4f} m away, at {state.ee_pos}"
        )
        alignment = min(1.0, abs(float(state.ee_quat @ np.array(home.ee_quat))))
        angle = 2.0 * math.acos(alignment)
        assert angle <= self.home_tolerance, (
            "after a reset the end effector must be oriented as the home of the spec, "
            f"{home.ee_quat}; it is turned by {angle:.4f} rad, to {state.ee_quat}"
        )
        assert state.mode is Mode.DISARMED, f"a reset must not arm, the mode is {state.mode}"
        assert state.applied is None, (
            f"`applied` must be None after a reset, since nothing was applied: {state.applied}"
        )
        self.hold(driver, self.settling_ticks)
        self.assert_at_rest(driver, "after a reset the robot must be held")

    def test_a_reset_places_the_objects(self, driver: RobotDriver) -> None:
        if not self.places_objects:
            pytest.skip("this robot needs a person to place objects: places_objects is False")
        driver.open()
        places = self.places(driver.spec)
        self.reset(driver, ResetRequest(places))
        for name, pose in driver.read().objects.items():
            distance = math.dist(pose.pos[:2], places[name])
            assert distance <= self.object_tolerance, (
                f"{name} must be at {places[name]}, as requested of the reset; it is at {pose.pos}"
            )

    def test_impossible_requests_are_errors_and_move_nothing(self, driver: RobotDriver) -> None:
        driver.open()
        self.reset(driver)
        before = driver.read()
        requests = {"a reset that places an unknown object": {"no such object": (0.0, 0.0)}}
        for name in driver.spec.objects:
            requests[f"a reset that places {name} at nan"] = {name: (math.nan, 0.0)}
            requests[f"a reset that places {name} 1609 m away"] = {name: (1609.0, 0.0)}
        for wrong, objects in requests.items():
            must_raise(InvalidRequest, partial(driver.reset, ResetRequest(objects)), wrong)
        after = driver.read()
        # A robot in real time keeps holding meanwhile, as still as it can.
        atol = self.rest_speed * driver.spec.control_period_s if self.real_time else 0.0
        np.testing.assert_allclose(
            after.ee_pos,
            before.ee_pos,
            rtol=0.0,
            atol=atol,
            err_msg="a reset that raises must not move the robot",
        )
        self.reset(driver)
