"""Contract of `read`: states are complete, of the declared shapes, immutable and consistent."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from drivers import JointCommand, Kinematics, Mode, RobotDriver, RobotSpec, StaleState
from drivers.testing.suite import ContractSuite, must_raise

_TICKS = 10


def arrays(value: object, path: str) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Yield every array in a state, with its path."""
    if isinstance(value, np.ndarray):
        yield path, value
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from arrays(item, f"{path}[{key!r}]")
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from arrays(getattr(value, field.name), f"{path}.{field.name}")


def _shapes(spec: RobotSpec) -> dict[str, tuple[int, ...]]:
    joints, fingers = (len(spec.joint_names),), (len(spec.finger_names),)
    shapes: dict[str, tuple[int, ...]] = {
        "state.q": joints,
        "state.dq": joints,
        "state.ee_pos": (3,),
        "state.ee_quat": (4,),
        "state.ee_linvel": (3,),
        "state.ee_angvel": (3,),
        "state.fingers_pos": fingers,
        "state.fingers_vel": fingers,
    }
    for name in spec.objects:
        parts = {"pos": 3, "quat": 4, "linvel": 3, "angvel": 3}
        shapes |= {f"state.objects[{name!r}].{part}": (size,) for part, size in parts.items()}
    if JointCommand.kind in spec.command_kinds:
        parts_of_setpoint = {"q": joints, "dq": joints, "fingers": fingers}
        shapes |= {f"state.setpoint.{part}": shape for part, shape in parts_of_setpoint.items()}
    return shapes


class StateTests(ContractSuite):
    """`read` returns the newest measurement, complete and read-only."""

    def test_states_have_the_shapes_that_the_spec_names(
        self, driver: RobotDriver, kind: str
    ) -> None:
        first = self.start(driver)
        for state in (first, self.tick(driver, self.samples(driver, kind))):
            found = dict(arrays(state, "state"))
            for name, shape in _shapes(driver.spec).items():
                assert name in found, f"a state of {driver.spec.name} must have {name}"
                assert found[name].shape == shape, (
                    f"{name} must have shape {shape}, has {found[name].shape}"
                )
            for name, array in found.items():
                assert array.dtype == np.float64, f"{name} must be float64, is {array.dtype}"
                assert np.isfinite(array).all(), f"{name} must be finite, is {array}"
                if name.endswith("quat"):
                    length = float(np.linalg.norm(array))
                    assert abs(length - 1.0) < 1e-6, f"{name} must have length 1, has {length}"

    def test_objects_come_from_the_declared_sources(self, driver: RobotDriver) -> None:
        state = self.start(driver)
        sources = driver.spec.objects
        assert state.objects.keys() == sources.keys(), (
            f"a state must have the objects of the spec, {sorted(sources)}, has "
            f"{sorted(state.objects)}"
        )
        for name, pose in state.objects.items():
            declared = sources[name]
            assert (pose.source, pose.frame) == (declared.source, declared.frame), (
                f"source and frame of {name} must be those of the spec"
            )

    def test_states_cannot_be_written_to(self, driver: RobotDriver, kind: str) -> None:
        self.start(driver)
        state = self.tick(driver, self.samples(driver, kind))
        for name, array in arrays(state, "state"):
            assert not array.flags.writeable, f"{name} must be read-only"

    def test_states_stay_as_they_were_read(self, driver: RobotDriver, kind: str) -> None:
        state = self.start(driver)
        copies = {name: array.copy() for name, array in arrays(state, "state")}
        for _ in range(3):
            self.tick(driver, self.samples(driver, kind))
        for name, array in arrays(state, "state"):
            np.testing.assert_array_equal(
                array, copies[name], f"{name} must not change with later ticks; copy it in _read"
            )

    def test_velocities_fit_the_positions(self, driver: RobotDriver, kind: str) -> None:
        first = before = self.start(driver)
        expected = np.zeros(3)
        for _ in range(_TICKS):
            state = self.tick(driver, self.samples(driver, kind))
            time_s = (state.seq - before.seq) * driver.spec.control_period_s
            expected += (before.ee_linvel + state.ee_linvel) / 2.0 * time_s
            before = state
        way = before.ee_pos - first.ee_pos
        error, allowed = np.linalg.norm(way - expected), 0.5 * np.linalg.norm(way)
        assert error <= allowed, (
            "ee_linvel must be the velocity of ee_pos, in m/s and in its frame: ee_pos moved by "
            f"{way}, the velocities add up to {expected} m"
        )

    def test_the_kinematic_model_is_that_of_the_robot(self, driver: RobotDriver, kind: str) -> None:
        if kind != JointCommand.kind:
            return  # no other kind of command needs one
        model, home = Kinematics(driver.spec), driver.spec.home
        self.start(driver)
        for _ in range(_TICKS):
            state = self.tick(driver, self.samples(driver, kind))
        for where, q, ee_pos in (
            ("at home", np.array(home.q), np.array(home.ee_pos)),
            (f"at q = {state.q}", state.q, state.ee_pos),
        ):
            np.testing.assert_allclose(
                model.ee_pos(q),
                ee_pos,
                atol=self.home_tolerance,
                err_msg=f"{where} the kinematic model must give the position of the end effector",
            )

    def test_the_mode_says_what_the_robot_does(self, driver: RobotDriver, kind: str) -> None:
        driver.open()
        self.reset(driver)
        mode = driver.read().mode
        assert mode is Mode.DISARMED, f"the mode before arm must be disarmed, is {mode}"
        driver.arm()
        mode = driver.read().mode
        assert mode is Mode.HELD, f"the mode after arm must be held, is {mode}"
        modes = set()
        for _ in range(_TICKS):  # a robot in real time holds in a missed tick
            state = self.tick(driver, self.samples(driver, kind))
            if self.applied_at_once(state) is not None:
                modes.add(state.mode)
        assert modes == {Mode.MOVING}, (
            f"the mode after a tick with an accepted command must be moving, is {modes}"
        )
        driver.disarm()
        disarmed = driver.read()
        assert (disarmed.mode, disarmed.fault) == (Mode.DISARMED, None), (
            f"the mode after disarm must be disarmed without a fault, is {disarmed.mode} with "
            f"{disarmed.fault}"
        )

    def test_a_state_older_than_allowed_is_stale(self, driver: RobotDriver) -> None:
        self.start(driver)
        driver.advance()
        if not self.real_time:
            driver.read(max_age_s=0.0)  # a paused simulation is never stale
            return
        must_raise(
            StaleState,
            lambda: driver.read(max_age_s=0.0),
            "read(max_age_s=0.0) in real time, where every measurement is older",
        )
