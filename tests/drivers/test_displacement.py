"""Displacements beyond the action's scale, the speed limit or the region."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers import Box, EndEffectorCommand, ResetRequest
from drivers.displacement import DisplacementLimit
from drivers.mujoco import FetchRobot, MujocoDriver
from tests.drivers.fake_robot import fake_spec

SPEC = fake_spec()
ACTION = SPEC.action
SCALE_M = ACTION.position_scale_m
HOME = np.array(SPEC.home.ee_pos)
# Not so small that their direction is lost in a division.
NUMBERS = st.floats(-1e300, 1e300).filter(lambda value: value == 0.0 or abs(value) > 1e-9)
SMALL = st.floats(-0.05, 0.05)


def limit_of(keep_out: tuple[Box, ...] = ()) -> DisplacementLimit:
    """Return the limit of the fake robot without its speed limit."""
    limits = dataclasses.replace(SPEC.limits, max_ee_speed_m_s=np.inf, keep_out=keep_out)
    return DisplacementLimit(dataclasses.replace(SPEC, limits=limits))


@given(st.lists(st.floats(-1.0, 1.0, width=32), min_size=4, max_size=4), st.booleans())
def test_displacements_within_the_scale_are_unchanged_to_the_bit(
    parts: list[float], single: bool
) -> None:
    action: NDArray[np.floating] = np.array(parts, dtype=np.float32 if single else np.float64)
    delta_pos = (action[:3] * SCALE_M).astype(np.float64)  # an action of 1 is above the scale
    fingers = np.full(2, float(action[3]) * ACTION.gripper_scale_m)
    command = EndEffectorCommand(3, delta_pos, fingers)
    assert limit_of().limit(command, HOME, 1.0) == (command, ())


@given(st.lists(NUMBERS, min_size=3, max_size=3), st.lists(NUMBERS, min_size=2, max_size=2))
def test_larger_displacements_are_cut_to_the_scale_and_keep_their_direction(
    delta: list[float], fingers: list[float]
) -> None:
    asked = EndEffectorCommand(7, np.array(delta), np.array(fingers))
    applied, reasons = limit_of().limit(asked, HOME, 1.0)
    assert applied.answers == 7
    for reason, before, after, scale in (
        ("position_scale", asked.delta_pos, applied.delta_pos, SCALE_M),
        ("gripper_scale", asked.finger_delta, applied.finger_delta, ACTION.gripper_scale_m),
    ):
        greatest = np.abs(before).max()
        assert (reason in reasons) == bool(greatest > scale * (1 + 1e-6))
        if reason in reasons:
            assert np.abs(after).max() == pytest.approx(scale)
            np.testing.assert_allclose(after / scale, before / greatest, rtol=1e-12)
        else:
            np.testing.assert_array_equal(after, before)


@given(st.lists(SMALL, min_size=3, max_size=3), st.floats(0.01, 1.0))
def test_speed_is_cut_as_a_whole_and_scales(delta: list[float], speed_scale: float) -> None:
    most_m = SPEC.limits.max_ee_speed_m_s * SPEC.control_period_s * speed_scale
    asked = EndEffectorCommand(0, np.array(delta), np.zeros(2))
    applied, reasons = DisplacementLimit(SPEC).limit(asked, HOME, speed_scale)
    distance = np.linalg.norm(delta)
    assert np.linalg.norm(applied.delta_pos) <= most_m * (1 + 1e-6)
    assert ("ee_speed" in reasons) == bool(distance > most_m * (1 + 1e-6))
    np.testing.assert_allclose(np.cross(applied.delta_pos, asked.delta_pos), 0.0, atol=1e-12)


@given(
    st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3),
    st.lists(SMALL, min_size=3, max_size=3),
)
def test_nothing_leaves_the_workspace_or_enters_the_table(
    place: list[float], delta: list[float]
) -> None:
    table = Box((0.2, 0.2, -1.0), (0.8, 0.8, 0.4))
    limit = limit_of(keep_out=(table,))
    start, asked = np.array(place), EndEffectorCommand(0, np.array(delta), np.zeros(2))

    def depths(point: NDArray[np.float64]) -> NDArray[np.float64]:
        outside = np.max([-point, point - 1.0])
        inside = np.min([point - table.lower, np.array(table.upper) - point])
        return np.maximum([outside, inside], 0.0)

    applied, reasons = limit.limit(asked, start, 1.0)
    assert (depths(start + applied.delta_pos) <= depths(start) + 1e-9).all()
    broken = depths(start + asked.delta_pos) > depths(start)
    named = ("workspace", "keep_out")
    assert set(reasons) == {
        name for name, is_broken in zip(named, broken, strict=True) if is_broken
    }


def test_the_way_back_from_outside_is_open() -> None:
    outside = np.array([1.02, 0.5, 0.5])
    back = EndEffectorCommand(0, np.array([-0.01, 0.0, 0.0]), np.zeros(2))
    further = EndEffectorCommand(0, np.array([0.01, 0.0, 0.0]), np.zeros(2))
    assert limit_of().limit(back, outside, 1.0) == (back, ())
    applied, reasons = limit_of().limit(further, outside, 1.0)
    assert reasons == ("workspace",)
    np.testing.assert_allclose(applied.delta_pos, 0.0, atol=1e-6)


def test_the_simulated_robot_applies_and_reports_the_cut_command() -> None:
    ends = []
    for delta, fingers in (([5.0, -2.5, 0.0], 40.0), ([0.05, -0.025, 0.0], 1.0)):
        driver = MujocoDriver("pick_and_place", FetchRobot(actuation="mocap"))
        with driver:
            driver.reset(ResetRequest())
            driver.arm()
            seq = driver.read().seq
            driver.command(EndEffectorCommand(seq, np.array(delta), np.full(2, fingers)))
            driver.advance()
            ends.append(driver.read())
            assert bool(driver.clips) == (delta[0] > 1.0)
    cut, legal = ends
    assert cut.applied is not None
    assert legal.applied is not None
    assert cut.applied.clipped == ("position_scale", "gripper_scale")
    assert legal.applied.clipped == ()
    assert isinstance(cut.applied.command, EndEffectorCommand)
    np.testing.assert_allclose(cut.applied.command.delta_pos, (0.05, -0.025, 0.0))
    np.testing.assert_allclose(cut.applied.command.finger_delta, 1.0)
    np.testing.assert_allclose(cut.ee_pos, legal.ee_pos, atol=1e-9)
    np.testing.assert_allclose(cut.fingers_pos, legal.fingers_pos, atol=1e-9)
