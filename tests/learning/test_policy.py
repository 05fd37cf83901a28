"""Acting, exploring and keeping a policy."""

from __future__ import annotations

import dataclasses
import io

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from iher_robot.learning.config import ExplorationConfig
from iher_robot.learning.exploration import explore
from iher_robot.learning.goal_model import IMAGINED, REAL
from iher_robot.learning.policy import Policy
from tests.learning.point_mass import SHAPES, small_config
from tests.learning.stand_ins import (
    CPU,
    NO_NOISE,
    deviation,
    generator,
    linear_policy,
    saved_and_loaded,
)


def policy(seed: int = 0, *, source_input: bool = True) -> Policy:
    config = small_config(ddpg={"source_input": source_input})
    policy = Policy.from_config(SHAPES, config, generator=generator(seed), device=CPU)
    policy.obs_normalizer.update(1 + 3 * torch.randn(50, SHAPES.obs_dim, generator=generator()))
    policy.goal_normalizer.update(2 - torch.randn(50, SHAPES.goal_dim, generator=generator()))
    return policy


def inputs(batch: int = 20) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    rng = generator(7)
    return (
        5 * torch.randn(batch, SHAPES.obs_dim, generator=rng),
        torch.randn(batch, SHAPES.goal_dim, generator=rng),
        torch.randint(2, (batch,), generator=rng),
    )


def noise(std: float, random: float) -> ExplorationConfig:
    return ExplorationConfig(noise_std=std, random_fraction=random)


@settings(deadline=None, max_examples=50)
@given(st.floats(0, 50), st.floats(0, 1), st.integers(0, 2**31))
def test_explored_actions_stay_within_bounds(std: float, random: float, seed: int) -> None:
    rng = generator(seed)
    action = 2 * torch.rand(64, 4, generator=rng) - 1
    explored = explore(action, noise(std, random), rng)
    assert explored.shape == action.shape
    assert explored.abs().max() <= 1


def test_without_noise_and_random_actions_nothing_changes() -> None:
    action = torch.tanh(torch.randn(50, 4, generator=generator()))
    assert torch.equal(explore(action, NO_NOISE, generator(1)), action)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_share_of_whole_actions_is_replaced_by_uniform_ones(share: float) -> None:
    action = torch.full((20_000, 4), 0.25)
    explored = explore(action, noise(0.0, share), generator())
    changed = explored != action
    assert torch.equal(changed.all(-1), changed.any(-1))
    assert float(changed[:, 0].float().mean()) == pytest.approx(share, abs=0.015)
    if share:
        replaced = explored[changed[:, 0]].flatten()
        counts = torch.histc(replaced, bins=10, min=-1, max=1)
        assert counts.sum() == len(replaced)
        assert deviation(counts, torch.ones(10)) < 4


def test_noise_is_gaussian_of_the_given_deviation_around_the_action() -> None:
    action = torch.tensor([[0.0, 0.3]]).expand(50_000, 2)
    disturbed = explore(action, noise(0.2, 0.0), generator()) - action
    assert disturbed.mean(0).tolist() == pytest.approx([0.0, 0.0], abs=0.005)
    assert disturbed.std(0).tolist() == pytest.approx([0.2, 0.2], rel=0.02)
    within = (disturbed.abs() < 0.2).float().mean()
    assert float(within) == pytest.approx(0.683, abs=0.01)


def test_actions_depend_on_what_the_normalisers_make_of_the_inputs() -> None:
    actor = linear_policy(goal_gain=0.5)
    observation, goal = torch.zeros(1, 6), torch.tensor([[1.0, -2.0]])
    told = torch.tensor([REAL])
    expected = torch.tanh(torch.tensor([[0.5, -1.0]]))
    torch.testing.assert_close(actor.act(observation, goal, told), expected)
    actor.goal_normalizer.update(torch.tensor([[0.0, -4.0], [4.0, 4.0]]))  # 2 +- 2 and 0 +- 4
    actor.obs_normalizer.update(torch.tensor([[3.0] * 6, [5.0] * 6]))  # 4 +- 1
    expected = torch.tanh(0.5 * torch.tensor([[-0.5 + 4.0, -0.5 + 4.0]]))
    torch.testing.assert_close(actor.act(observation, goal, told), expected)


def test_the_source_is_the_last_feature_one_for_real() -> None:
    observation, goal, source = inputs()
    features = policy().features(observation, goal, source)
    assert features.shape == (20, policy().input_dim) == (20, SHAPES.obs_dim + SHAPES.goal_dim + 1)
    assert torch.equal(features[:, -1], (source == REAL).float())
    assert not torch.equal(*(policy().act(observation, goal, torch.full((20,), s)) for s in (0, 1)))


def test_without_the_source_input_the_source_changes_nothing() -> None:
    observation, goal, _ = inputs()
    deaf = policy(source_input=False)
    assert deaf.input_dim == SHAPES.obs_dim + SHAPES.goal_dim
    assert torch.equal(*(deaf.act(observation, goal, torch.full((20,), s)) for s in (0, 1)))


@pytest.mark.parametrize("source_input", [True, False])
def test_a_snapshot_acts_identically_after_a_safe_load(source_input: bool) -> None:
    original = policy(source_input=source_input)
    file = io.BytesIO()
    torch.save(original.snapshot(), file)
    file.seek(0)
    copy = Policy.from_snapshot(torch.load(file, weights_only=True), device=CPU)
    assert torch.equal(copy.act(*inputs()), original.act(*inputs()))
    assert not torch.equal(copy.act(*inputs()), policy(1, source_input=source_input).act(*inputs()))
    assert copy.snapshot().keys() == original.snapshot().keys()
    assert (copy.shapes, copy.hidden) == (original.shapes, original.hidden)


def test_a_snapshot_does_not_follow_the_policy() -> None:
    original = policy()
    snapshot = original.snapshot()
    before = original.act(*inputs())
    original.obs_normalizer.update(torch.full((500, SHAPES.obs_dim), 9.0))
    with torch.no_grad():
        for parameter in original.actor.parameters():
            parameter.mul_(-1)
    assert not torch.allclose(original.act(*inputs()), before)
    assert torch.equal(Policy.from_snapshot(snapshot, device=CPU).act(*inputs()), before)
    original.load_snapshot(snapshot)
    assert torch.equal(original.act(*inputs()), before)


def test_actions_are_bounded_whatever_the_input() -> None:
    observation, goal, source = inputs()
    action = policy().act(1e6 * observation, 1e6 * goal, source)
    assert action.abs().max() <= 1
    assert IMAGINED in source


RELATIVE = dataclasses.replace(SHAPES, goal_entries=(0, 1), shifted_entries=(0, 1))
"""Of the point mass's observation, a shift of the whole scene changes the position alone."""


def relative_policy() -> Policy:
    config = small_config(ddpg={"inputs": "relative"})
    policy = Policy.from_config(RELATIVE, config, generator=generator(), device=CPU)
    observation, goal, _ = inputs(50)
    policy.update_normalizers(observation, goal)
    return policy


def shifted(by: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    observation, goal, source = inputs()
    observation[:, :2] += by
    return observation, goal + by, source


def test_relative_inputs_do_not_see_a_shift_of_the_whole_scene() -> None:
    policy = relative_policy()
    action = policy.act(*inputs())
    torch.testing.assert_close(policy.act(*shifted(3.0)), action)
    observation, goal, source = inputs()
    assert not torch.allclose(policy.act(observation, goal + 0.3, source), action)
    observation[:, 2:] += 0.3  # what a shift leaves as it is
    assert not torch.allclose(policy.act(observation, goal, source), action)


def test_absolute_inputs_see_it() -> None:
    assert not torch.allclose(policy().act(*shifted(3.0)), policy().act(*inputs()))


def test_the_gap_to_the_goal_is_normalised_with_its_own_statistics() -> None:
    policy = relative_policy()
    observation, goal, source = inputs(50)
    width = SHAPES.obs_dim + SHAPES.goal_dim
    gap = policy.features(observation, goal, source)[:, width : width + 2]
    torch.testing.assert_close(gap, policy.gap_normalizer(goal - observation[:, :2]))
    assert gap.mean(0).abs().max() < 0.1
    assert (gap.std(0) - 1).abs().max() < 0.1


def test_a_snapshot_with_relative_inputs_acts_identically() -> None:
    policy = relative_policy()
    again = Policy.from_snapshot(saved_and_loaded(policy.snapshot()), device=CPU)
    assert torch.equal(again.act(*inputs()), policy.act(*inputs()))


def test_a_snapshot_from_before_relative_inputs_is_read() -> None:
    original = policy()
    snapshot = original.snapshot()
    for name in ("inputs", "gap_normalizer"):
        del snapshot[name]
    for name in ("goal_entries", "shifted_entries"):
        del snapshot["shapes"][name]
    again = Policy.from_snapshot(snapshot, device=CPU)
    assert torch.equal(again.act(*inputs()), original.act(*inputs()))


def test_statistics_of_the_gap_must_have_its_shape() -> None:
    snapshot = relative_policy().snapshot()
    snapshot["gap_normalizer"]["mean"] = torch.zeros(1)
    with pytest.raises(ValueError, match=r"gap_normalizer.mean has shape \(1,\), expected \(2,\)"):
        Policy.from_snapshot(snapshot, device=CPU)
