from __future__ import annotations

import dataclasses
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import (
    ActionSpec,
    Box,
    GripperLimits,
    Home,
    InvalidSpec,
    JointLimits,
    Limits,
    ObjectSource,
    RobotSpec,
)
from drivers.canonical import digest, to_json
from tests.drivers.fake_robot import fake_spec

JSON_LEAVES = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
JSON_VALUES = st.recursive(
    JSON_LEAVES,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


def with_limits(**changes: object) -> dict[str, object]:
    return {"limits": dataclasses.replace(fake_spec().limits, **changes)}  # type: ignore[arg-type]


INTERFACE: list[dict[str, object]] = [
    {"action": ActionSpec(position_scale_m=0.04)},
    {"action": ActionSpec(gripper_scale_m=0.5)},
    {"action": ActionSpec(frame="tool")},
    {"action": ActionSpec(names=("dx", "dy"))},
    {"command_kinds": ("ee_delta", "joint")},
    {"control_period_s": 0.05},
    {"frame": "base"},
    {"objects": {}},
    {"objects": {"object0": ObjectSource("lidar", "world", 0.2)}},
    {"objects": {"object0": ObjectSource("camera", "camera", 0.2)}},
]
BODY: list[dict[str, object]] = [
    {"finger_names": ("left", "right")},
    {"gains": {"kp": 101.0}},
    {"calibration_id": "2024-05-02"},
    {"kinematic_model": "abd"},
    with_limits(joints={"elbow": JointLimits(-1.0, 1.0, 2.0, 3.0)}),
    with_limits(joints={"shoulder": JointLimits(-1.0, 1.1, 2.0, 3.0)}),
    with_limits(joints={"shoulder": JointLimits(-1.0, 1.0, 2.1, 3.0)}),
    with_limits(joints={"shoulder": JointLimits(-1.0, 1.0, 2.0, 3.1)}),
    with_limits(gripper=GripperLimits(0.0, 0.06, 0.1)),
    with_limits(max_ee_speed_m_s=0.9),
    with_limits(workspace=Box((0.0, 0.0, 0.1), (1.0, 1.0, 1.0))),
    with_limits(watchdog_s=0.2),
]
NEITHER: list[dict[str, object]] = [
    {"physical": False},
    {"name": "other"},
    {"home": Home((0.1, 0.5, 0.5), (1.0, 0.0, 0.0, 0.0))},
    {"hold_on_silence_s": 0.1},
    {"enforces_joint_limits": False},
]


def changed(change: dict[str, object]) -> RobotSpec:
    return dataclasses.replace(fake_spec(), **change)  # type: ignore[arg-type]


@pytest.mark.parametrize("change", INTERFACE, ids=str)
def test_the_interface_digest_changes_with_the_interface_alone(change: dict[str, object]) -> None:
    assert changed(change).interface_digest != fake_spec().interface_digest
    assert changed(change).body_digest == fake_spec().body_digest
    assert fake_spec().interface_differences(changed(change))


@pytest.mark.parametrize("change", BODY, ids=str)
def test_the_body_digest_changes_with_the_body_alone(change: dict[str, object]) -> None:
    assert changed(change).body_digest != fake_spec().body_digest
    assert changed(change).interface_digest == fake_spec().interface_digest
    assert fake_spec().body_differences(changed(change))


@pytest.mark.parametrize("change", NEITHER, ids=str)
def test_place_and_safeguards_of_a_robot_are_in_neither_digest(
    change: dict[str, object],
) -> None:
    assert changed(change).body_digest == fake_spec().body_digest
    assert changed(change).interface_digest == fake_spec().interface_digest


def test_every_field_is_known_to_be_in_one_digest_or_in_neither() -> None:
    covered = {name for change in [*INTERFACE, *BODY, *NEITHER] for name in change}
    assert covered == {field.name for field in dataclasses.fields(RobotSpec)}


def test_differences_of_bodies_are_named_with_both_values() -> None:
    other = changed(
        {"calibration_id": "new"}
        | with_limits(joints={"shoulder": JointLimits(-1.0, math.inf, 2.0, 3.0)})
    )
    assert fake_spec().body_differences(other) == [
        'calibration_id: "2024-05-01", not "new"',
        'limits.joints.shoulder.upper: 1.0, not "inf"',
    ]
    assert fake_spec().body_differences(fake_spec()) == []


def test_a_physical_robot_must_hold_on_silence() -> None:
    with pytest.raises(InvalidSpec, match="physical and declares no hold_on_silence_s"):
        changed({"hold_on_silence_s": None})
    assert not changed({"hold_on_silence_s": None, "physical": False}).physical


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: JointLimits(1.0, 1.0, 1.0, 1.0), r"\[1.0, 1.0\], allowed: lower < upper"),
        (lambda: JointLimits(0.0, math.nan, 1.0, 1.0), "nan"),
        (lambda: JointLimits(0.0, 1.0, 0.0, 1.0), "max_velocity is 0.0, allowed: above 0"),
        (lambda: JointLimits(0.0, 1.0, 1.0, math.nan), "max_acceleration is nan"),
        (lambda: Box((0, 0, 0), (1, 0, 1)), "lower < upper"),
        (lambda: GripperLimits(0.1, 0.0, 1.0), "lower < upper"),
        (lambda: changed(with_limits(watchdog_s=math.inf)), "watchdog_s is infinite"),
        (lambda: changed(with_limits(reduced_speed_scale=1.5)), r"1\.5, allowed: \(0, 1\]"),
        (lambda: changed({"control_period_s": -0.04}), "control_period_s is -0.04"),
        (lambda: changed({"command_kinds": ()}), "no command kind"),
        (lambda: ObjectSource("camera", "world", 0.0), "max_age_s is 0.0"),
    ],
)
def test_a_contradictory_description_is_an_error(build: object, message: str) -> None:
    assert callable(build)
    with pytest.raises(InvalidSpec, match=message):
        build()


def test_the_description_is_plain_json() -> None:
    spec = changed(with_limits(joints={"wrist": JointLimits(-math.inf, math.inf, 1.0, 1.0)}))
    text = json.dumps(spec.to_dict(), allow_nan=False)
    assert json.loads(text)["interface_digest"] == spec.interface_digest
    assert json.loads(text)["limits"]["joints"]["wrist"]["lower"] == "-inf"


@given(st.dictionaries(st.text(), JSON_VALUES, max_size=5))
def test_a_digest_does_not_depend_on_the_order_of_names(value: dict[str, object]) -> None:
    backwards = dict(reversed(list(value.items())))
    assert digest(value) == digest(backwards)


@given(st.floats(min_value=1e-3, max_value=10.0), st.floats(min_value=1e-3, max_value=10.0))
def test_a_digest_tells_any_two_watchdogs_apart(first: float, second: float) -> None:
    digests = [changed(with_limits(watchdog_s=value)).body_digest for value in (first, second)]
    assert (digests[0] == digests[1]) == (first == second)


@given(JSON_VALUES)
def test_json_forms_survive_a_round_trip(value: object) -> None:
    form = to_json(value)
    assert json.loads(json.dumps(form, allow_nan=False)) == form


def test_nan_and_sets_have_no_digest() -> None:
    with pytest.raises(ValueError, match="nan"):
        digest({"gain": math.nan})
    with pytest.raises(TypeError, match="set has no JSON form"):
        digest({"names": {"a"}})


def test_limits_are_a_dataclass_that_replaces_whole() -> None:
    limits = fake_spec().limits
    assert isinstance(limits, Limits)
    assert fake_spec().joint_names == tuple(limits.joints)
