"""Policies: acting, inputs, snapshots."""

from __future__ import annotations

import dataclasses
import io

import pytest
import torch

from iher_robot.learning.goal_model import IMAGINED, REAL
from iher_robot.learning.policy import Policy
from tests.learning.fakes import (
    CPU,
    generator,
    linear_policy,
    saved_and_loaded,
)
from tests.learning.point_mass import SHAPES, small_config


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


def test_actions_depend_on_normalised_inputs() -> None:
    actor = linear_policy(goal_gain=0.5)
    observation, goal = torch.zeros(1, 6), torch.tensor([[1.0, -2.0]])
    source = torch.tensor([REAL])
    expected = torch.tanh(torch.tensor([[0.5, -1.0]]))
    torch.testing.assert_close(actor.act(observation, goal, source), expected)
    actor.goal_normalizer.update(torch.tensor([[0.0, -4.0], [4.0, 4.0]]))  # 2 +- 2 and 0 +- 4
    actor.obs_normalizer.update(torch.tensor([[3.0] * 6, [5.0] * 6]))  # 4 +- 1
    expected = torch.tanh(0.5 * torch.tensor([[-0.5 + 4.0, -0.5 + 4.0]]))
    torch.testing.assert_close(actor.act(observation, goal, source), expected)


def test_the_source_is_the_last_feature_one_for_real() -> None:
    observation, goal, source = inputs()
    features = policy().features(observation, goal, source)
    assert features.shape == (20, policy().input_dim) == (20, SHAPES.obs_dim + SHAPES.goal_dim + 1)
    assert torch.equal(features[:, -1], (source == REAL).float())
    assert not torch.equal(*(policy().act(observation, goal, torch.full((20,), s)) for s in (0, 1)))


def test_without_the_source_input_the_source_has_no_effect() -> None:
    observation, goal, _ = inputs()
    without_source = policy(source_input=False)
    assert without_source.input_dim == SHAPES.obs_dim + SHAPES.goal_dim
    assert torch.equal(
        *(without_source.act(observation, goal, torch.full((20,), s)) for s in (0, 1))
    )


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


def test_a_snapshot_is_independent_of_the_policy() -> None:
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


def test_relative_inputs_are_invariant_to_a_shift_of_the_scene() -> None:
    policy = relative_policy()
    action = policy.act(*inputs())
    torch.testing.assert_close(policy.act(*shifted(3.0)), action)
    observation, goal, source = inputs()
    assert not torch.allclose(policy.act(observation, goal + 0.3, source), action)
    observation[:, 2:] += 0.3  # what a shift leaves as it is
    assert not torch.allclose(policy.act(observation, goal, source), action)


def test_absolute_inputs_are_not_invariant_to_a_shift() -> None:
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
