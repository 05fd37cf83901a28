"""Displacements beyond what an action can ask for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers import ActionSpec, EndEffectorCommand, ResetRequest
from drivers.clipping import clip_displacement
from drivers.mujoco import MujocoDriver

ACTION = ActionSpec()
SCALE_M = ACTION.position_scale_m
# Not so small that their direction is lost in a division.
NUMBERS = st.floats(-1e300, 1e300).filter(lambda value: value == 0.0 or abs(value) > 1e-9)


@given(st.lists(st.floats(-1.0, 1.0, width=32), min_size=4, max_size=4), st.booleans())
def test_what_an_action_can_ask_for_stays_to_the_bit(parts: list[float], single: bool) -> None:
    action: NDArray[np.floating] = np.array(parts, dtype=np.float32 if single else np.float64)
    delta_pos = (action[:3] * SCALE_M).astype(np.float64)  # an action of 1 is above the scale
    fingers = np.full(2, float(action[3]) * ACTION.gripper_scale_m)
    command = EndEffectorCommand(3, delta_pos, fingers)
    assert clip_displacement(command, ACTION) == (command, ())


@given(st.lists(NUMBERS, min_size=3, max_size=3), st.lists(NUMBERS, min_size=2, max_size=2))
def test_more_is_cut_to_the_scale_and_keeps_its_direction(
    delta: list[float], fingers: list[float]
) -> None:
    asked = EndEffectorCommand(7, np.array(delta), np.array(fingers))
    applied, reasons = clip_displacement(asked, ACTION)
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


def test_the_simulated_robot_moves_by_the_cut_command_and_says_so() -> None:
    ends = []
    for delta, fingers in (([5.0, -2.5, 0.0], 40.0), ([0.05, -0.025, 0.0], 1.0)):
        driver = MujocoDriver("pick_and_place")
        with driver:
            driver.reset(ResetRequest())
            driver.arm()
            seq = driver.read().seq
            driver.command(EndEffectorCommand(seq, np.array(delta), np.full(2, fingers)))
            driver.advance()
            ends.append(driver.read())
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
