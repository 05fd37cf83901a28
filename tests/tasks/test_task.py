from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks import TASKS, InvalidFrame, MissingObject, TaskFrame, UnknownTask, make_task
from tests.drivers.fake_robot import fake_spec


@given(st.integers(min_value=0, max_value=2**32 - 1))
def test_objects_start_in_the_square_and_not_under_the_gripper(seed: int) -> None:
    home = np.array(fake_spec().home.ee_pos[:2])
    for name in ("push", "pick_and_place", "slide"):
        task = make_task(name).bind(fake_spec())
        place = task.reset_request(np.random.default_rng(seed)).objects["object0"]
        offset = np.array(place) - home
        assert (np.abs(offset) <= task.frame.object_range).all()
        assert np.linalg.norm(offset) >= 0.1 - 1e-12


def test_reach_places_nothing_and_draws_nothing() -> None:
    rng = np.random.default_rng(3)
    assert make_task("reach").bind(fake_spec()).reset_request(rng).objects == {}
    assert rng.uniform() == np.random.default_rng(3).uniform()


def test_binding_leaves_the_first_task_free() -> None:
    task = make_task("push")
    bound = task.bind(fake_spec())
    assert bound.home == fake_spec().home.ee_pos
    assert bound.frame is task.frame
    other = dataclasses.replace(fake_spec(), control_period_s=0.1)
    assert bound.bind(other).spec.control_period_s == 0.1
    assert bound.spec.control_period_s == 0.04


def test_a_robot_without_the_object_is_refused() -> None:
    blind = dataclasses.replace(fake_spec(), objects={})
    with pytest.raises(MissingObject, match="needs object 'object0', fake reports: none"):
        make_task("push").bind(blind)
    assert make_task("reach").bind(blind).home == blind.home.ee_pos


def test_hyphens_stand_for_underscores() -> None:
    assert type(make_task("pick-and-place")) is TASKS["pick_and_place"]


def test_an_unknown_task_is_answered_with_the_nearest() -> None:
    with pytest.raises(UnknownTask, match=r"unknown task 'pusch'.*did you mean 'push'"):
        make_task("pusch")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"object_range": 0.0}, "object_range is 0.0"),
        ({"goal_range": float("inf")}, "goal_range is inf"),
        ({"threshold": -0.05}, "threshold is -0.05"),
        ({"air_probability": 1.5}, "air_probability is 1.5, allowed: 0 to 1"),
        ({"air_height": -0.1}, "air_height is -0.1"),
        ({"object_range": 0.05}, "min_object_distance is 0.1, allowed: 0 to below 0.0707"),
    ],
    ids=str,
)
def test_a_frame_in_which_no_episode_can_start_is_an_error(
    change: dict[str, float], message: str
) -> None:
    with pytest.raises(InvalidFrame, match=message):
        TaskFrame(**change)  # type: ignore[arg-type]
