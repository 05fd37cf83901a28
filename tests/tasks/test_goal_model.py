"""Goal models: pure, batched, the same on arrays and tensors."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tasks import TASKS, GoalModel, TaskFrame, UnboundTask, make_task
from tests.drivers.fake_robot import fake_spec

SEEDS = st.integers(min_value=0, max_value=2**32 - 1)


def goal_model(name: str, **frame: object) -> GoalModel:
    default = TASKS[name].default_frame
    changed = TaskFrame(**(vars(default) | frame))
    return make_task(name, changed).bind(fake_spec()).goal_model


@pytest.fixture(params=list(TASKS))
def model(request: pytest.FixtureRequest) -> GoalModel:
    return goal_model(request.param)


def observations(model: GoalModel, *shape: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(*shape, model.layout.obs_dim))


def goals_near(goals: np.ndarray) -> np.ndarray:
    # About half of them within the threshold of 0.05 m.
    return goals + np.random.default_rng(1).normal(scale=0.03, size=goals.shape)


def test_batches_equal_loops(model: GoalModel) -> None:
    obs = observations(model, 4, 5)
    achieved = model.achieved_goal(obs)
    desired = goals_near(achieved)
    reward, complete = model.compute_reward(achieved, desired), model.complete(obs)
    assert set(np.unique(reward)) == {-1.0, 0.0}
    for i in range(4):
        for j in range(5):
            np.testing.assert_array_equal(achieved[i, j], model.achieved_goal(obs[i, j]))
            np.testing.assert_array_equal(complete[i, j], model.complete(obs[i, j]))
            assert reward[i, j] == model.compute_reward(achieved[i, j], desired[i, j])


def test_tightened_goals_are_met_within_a_share_of_the_threshold(model: GoalModel) -> None:
    desired = np.zeros((3, model.goal_dim))
    achieved = desired.copy()
    achieved[:, 0] = model.threshold * np.array([0.39, 0.41, 0.99])
    strict = model.tightened(0.4)
    assert strict.compute_reward(achieved, desired).tolist() == [0.0, -1.0, -1.0]
    assert model.compute_reward(achieved, desired).tolist() == [0.0, 0.0, 0.0]


def test_tensors_equal_arrays(model: GoalModel) -> None:
    obs = observations(model, 64)
    tensor = torch.from_numpy(obs)
    achieved = model.achieved_goal(obs)
    desired = goals_near(achieved)
    both = model.achieved_goal(tensor), torch.from_numpy(desired)
    np.testing.assert_array_equal(achieved, both[0].numpy())
    np.testing.assert_array_equal(model.complete(obs), model.complete(tensor).numpy())
    reward = model.compute_reward(*both)
    assert reward.is_floating_point()
    np.testing.assert_array_equal(model.compute_reward(achieved, desired), reward.numpy())
    np.testing.assert_array_equal(
        model.is_success(achieved, desired), model.is_success(*both).numpy()
    )


def test_single_precision_stays_single(model: GoalModel) -> None:
    tensor = torch.from_numpy(observations(model, 3)).float()
    assert model.complete(tensor).dtype == torch.float32
    assert model.achieved_goal(tensor).dtype == torch.float32
    assert model.compute_reward(model.achieved_goal(tensor), torch.zeros(3)).dtype == torch.float32


def test_rewards_and_success_meet_at_the_threshold(model: GoalModel) -> None:
    origin = np.zeros((3, 3))
    beside = np.array([[0.049, 0, 0], [0.05, 0, 0], [0.0501, 0, 0]])
    # As in the reference: at the threshold itself there is no penalty, and no success either.
    np.testing.assert_array_equal(model.compute_reward(origin, beside), [0.0, 0.0, -1.0])
    np.testing.assert_array_equal(model.is_success(origin, beside), [1.0, 0.0, 0.0])


def test_completing_changes_derived_entries_only_and_copies_its_input() -> None:
    model = goal_model("push")
    array = observations(model, 7)
    obs, tensor = array.copy(), torch.from_numpy(array.copy())
    complete = model.complete(obs)
    np.testing.assert_array_equal(model.complete(tensor).numpy(), complete)
    np.testing.assert_array_equal(obs, array)
    np.testing.assert_array_equal(tensor.numpy(), array)
    kept = np.delete(np.arange(25), np.arange(6, 9))
    np.testing.assert_array_equal(complete[:, kept], array[:, kept])
    np.testing.assert_array_equal(complete[:, 6:9], array[:, 3:6] - array[:, 0:3])


def test_gradients_pass_through_completion_and_achieved_goals() -> None:
    model = goal_model("push")
    obs = torch.from_numpy(observations(model, 2)).requires_grad_()
    model.complete(obs)[..., 6:9].sum().backward()
    assert obs.grad is not None
    np.testing.assert_array_equal(obs.grad[:, 3:6].numpy(), 1.0)
    np.testing.assert_array_equal(obs.grad[:, 0:3].numpy(), -1.0)
    np.testing.assert_array_equal(obs.grad[:, 6:9].numpy(), 0.0)


@given(SEEDS)
def test_goals_stay_in_their_region(seed: int) -> None:
    home = np.array(fake_spec().home.ee_pos)
    start = np.zeros((32, 25))
    for name, model in ((name, goal_model(name)) for name in TASKS):
        goals = model.sample_goal(np.random.default_rng(seed), start[:, : model.layout.obs_dim])
        assert goals.shape == (32, 3)
        offset = goals - home - np.array(TASKS[name].default_frame.goal_offset)
        assert (np.abs(offset[:, :2]) <= TASKS[name].default_frame.goal_range).all()
        if name == "reach":
            assert (np.abs(offset[:, 2]) <= 0.15).all()
        elif name == "pick_and_place":
            assert ((goals[:, 2] >= 0.4) & (goals[:, 2] <= 0.85)).all()
        else:
            assert (goals[:, 2] == 0.4).all(), "the height at which the robot says objects rest"


def test_about_half_of_the_goals_of_pick_and_place_are_in_the_air() -> None:
    goals = goal_model("pick_and_place").sample_goal(np.random.default_rng(0), np.zeros((2000, 25)))
    assert np.mean(goals[:, 2] > 0.4) == pytest.approx(0.5, abs=0.05)
    assert goals[:, 2].max() > 0.8


def test_a_configured_frame_moves_the_goals() -> None:
    far = goal_model("push", home=(2.0, -1.0, 0.7), object_height=0.55, goal_range=0.01)
    goals = far.sample_goal(np.random.default_rng(0), np.zeros((50, 25)))
    np.testing.assert_allclose(goals, np.tile((2.0, -1.0, 0.55), (50, 1)), atol=0.01)
    assert (goals[:, 2] == 0.55).all()


def test_without_a_known_height_goals_take_that_of_the_start_as_measured() -> None:
    spec = fake_spec()
    spec.home.object_heights.clear()  # type: ignore[attr-defined]
    model = make_task("push").bind(spec).goal_model
    start = np.zeros((3, 25))
    start[:, 5] = (0.41, 0.42, 0.43)
    goals = model.sample_goal(np.random.default_rng(0), start)
    np.testing.assert_array_equal(goals[:, 2], (0.41, 0.42, 0.43))


@pytest.mark.parametrize("name", list(TASKS))
def test_rewards_need_no_robot_and_goals_do(name: str) -> None:
    model = make_task(name).goal_model
    assert model.compute_reward(np.zeros(3), np.ones(3)) == -1.0
    with pytest.raises(UnboundTask, match=r"use task.bind\(spec\)"):
        model.sample_goal(np.random.default_rng(0), np.zeros((1, model.layout.obs_dim)))
