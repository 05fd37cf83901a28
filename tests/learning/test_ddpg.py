"""DDPG: targets, target networks, and what each loss may touch."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

from iher_robot.learning.ddpg import DDPG, target_bounds
from iher_robot.learning.policy import Policy
from iher_robot.learning.replay import Transitions
from tests.learning.point_mass import SHAPES, small_config
from tests.learning.stand_ins import ACTION, CPU, OBS, generator

Settings = dict[str, Any]


def ddpg(seed: int = 0, intrinsic_clip: float = 0.8, **settings: Any) -> DDPG:
    config = small_config(ddpg={"hidden": (32, 32)} | settings, intrinsic={"clip": intrinsic_clip})
    rng = generator(seed)
    policy = Policy.from_config(SHAPES, config, generator=rng, device=CPU)
    return DDPG(policy, SHAPES, config, generator=rng, device=CPU)


def batch(size: int = 64, seed: int = 1) -> Transitions:
    rng = generator(seed)
    return Transitions(
        observation=torch.randn(size, OBS, generator=rng),
        action=2 * torch.rand(size, ACTION, generator=rng) - 1,
        next_observation=torch.randn(size, OBS, generator=rng),
        goal=torch.randn(size, SHAPES.goal_dim, generator=rng),
        extrinsic=-torch.randint(2, (size,), generator=rng).float(),
        intrinsic=torch.rand(size, generator=rng),
        source=torch.randint(2, (size,), generator=rng),
    )


def with_target_value(learner: DDPG, value: float) -> DDPG:
    """Make the target critic say the same value everywhere."""
    state = learner.state_dict()
    weights = state["target_critic"]
    *_, weight, bias = weights
    weights[weight], weights[bias] = weights[weight] * 0, weights[bias] * 0 + value
    learner.load_state_dict(state)
    return learner


def weights(learner: DDPG, name: str) -> torch.Tensor:
    state = learner.policy.snapshot() if name == "actor" else learner.state_dict()
    return torch.cat([tensor.flatten() for tensor in state[name].values()])


def change(learner: DDPG, name: str, data: Transitions, updates: int = 1) -> float:
    before = weights(learner, name)
    for _ in range(updates):
        learner.update(data)
    return float((weights(learner, name) - before).abs().max())


@pytest.mark.parametrize(
    ("clip_target", "bounds"),
    [("her", (-10.0, 0.0)), ("intrinsic", (-10.0, 6.0)), ("off", (-float("inf"), float("inf")))],
)
@pytest.mark.parametrize("value", [-30.0, -9.5, 0.0, 0.4, 6.0, 30.0])
def test_targets_are_rewards_and_discounted_value_clipped_to_what_can_be(
    clip_target: str, bounds: tuple[float, float], value: float
) -> None:
    learner = ddpg(gamma=0.9, clip_target=clip_target, intrinsic_clip=0.6)
    assert target_bounds(learner.config) == pytest.approx(bounds)
    data = batch()
    raw = data.extrinsic + data.intrinsic + 0.9 * value  # rewards of 0 bootstrap as well
    targets, clipped = with_target_value(learner, value).targets(data)
    torch.testing.assert_close(targets, raw.clamp(*bounds))
    outside = (raw < bounds[0]) | (raw > bounds[1])
    assert torch.equal(clipped, outside)
    reported = learner.update(data)["target_clipped"]
    assert float(reported) == pytest.approx(float(outside.float().mean()))


def test_targets_look_at_the_next_observation_with_the_target_networks() -> None:
    learner, data = ddpg(clip_target="off"), batch()
    before, _ = learner.targets(data)
    for field in ("observation", "action"):
        changed = replace(data, **{field: torch.zeros_like(getattr(data, field))})
        assert torch.equal(learner.targets(changed)[0], before), field
    for field in ("next_observation", "goal", "extrinsic", "intrinsic"):
        changed = replace(data, **{field: getattr(data, field) + 1})
        assert not torch.allclose(learner.targets(changed)[0], before), field
    flipped = replace(data, source=1 - data.source)
    assert not torch.allclose(learner.targets(flipped)[0], before)
    for _ in range(3):
        learner.update(data)  # moves the online networks only
    assert torch.equal(learner.targets(data)[0], before)


@pytest.mark.parametrize("tau", [0.05, 0.5, 1.0])
def test_target_networks_move_by_exactly_tau_and_only_when_told(tau: float) -> None:
    learner, data = ddpg(tau=tau), batch()
    old = {name: weights(learner, f"target_{name}") for name in ("actor", "critic")}
    for _ in range(5):
        learner.update(data)
    for name, start in old.items():
        assert torch.equal(weights(learner, f"target_{name}"), start)
        assert (weights(learner, name) - start).abs().max() > 1e-3
    remaining = 1.0
    for _ in range(2):
        learner.update_targets()
        remaining *= 1 - tau
        for name, start in old.items():
            expected = remaining * start + (1 - remaining) * weights(learner, name)
            torch.testing.assert_close(weights(learner, f"target_{name}"), expected)


def test_targets_start_as_the_networks_they_follow() -> None:
    learner = ddpg()
    for name in ("actor", "critic"):
        assert torch.equal(weights(learner, f"target_{name}"), weights(learner, name))


def test_the_actors_loss_leaves_the_critic_alone() -> None:
    # The target networks stand still, so the critic's path depends on its own loss only.
    gentle, harsh = ddpg(action_l2=0.0, actor_lr=1e-4), ddpg(action_l2=100.0, actor_lr=1e-1)
    for _ in range(4):
        assert change(gentle, "critic", batch()) > 0
        assert change(harsh, "critic", batch()) > 0
        assert torch.equal(weights(gentle, "critic"), weights(harsh, "critic"))
    assert not torch.allclose(weights(gentle, "actor"), weights(harsh, "actor"))


def test_the_actor_climbs_the_critic() -> None:
    learner, data = ddpg(critic_lr=1e-12, action_l2=0.0), batch()
    values = [float(learner.update(data)["q"]) for _ in range(30)]
    assert values == sorted(values)
    assert values[-1] > values[0] + 0.005


def test_the_action_penalty_pulls_actions_towards_zero() -> None:
    def size_after(action_l2: float) -> tuple[float, float]:
        learner, data = ddpg(critic_lr=1e-12, action_l2=action_l2), batch()
        state = learner.state_dict()
        state["critic"] = {name: 0 * tensor for name, tensor in state["critic"].items()}
        learner.load_state_dict(state)  # a critic to which every action is the same
        moved = change(learner, "actor", data, updates=40)
        action = learner.policy.act(data.observation, data.goal, data.source)
        return float(action.square().mean()), moved

    free, penalised = size_after(0.0), size_after(1.0)
    assert free[1] == 0.0
    assert penalised[1] > 0.0
    assert penalised[0] < 0.2 * free[0]


def test_updates_lower_the_critics_loss_on_a_fixed_batch() -> None:
    learner, data = ddpg(), batch()
    losses = [float(learner.update(data)["critic_loss"]) for _ in range(60)]
    assert losses[-1] < 0.5 * losses[0]
    features = learner.policy.features(data.observation, data.goal, data.source)
    value = learner.critic(torch.cat([features, data.action], dim=-1)).squeeze(-1)
    expected = (value - learner.targets(data)[0]).square().mean().detach()
    assert float(learner.update(data)["critic_loss"]) == pytest.approx(float(expected), rel=1e-5)


def test_the_critic_hears_the_source_only_where_it_is_an_input() -> None:
    data = batch()
    flipped = replace(data, source=1 - data.source)
    for told in (True, False):
        learner = ddpg(source_input=told, clip_target="off")
        same = torch.equal(learner.targets(data)[0], learner.targets(flipped)[0])
        assert same is not told


def test_a_restored_learner_goes_on_as_the_original_does() -> None:
    original, data = ddpg(seed=0), batch()
    for _ in range(3):
        original.update(data)
        original.update_targets()
    state, snapshot = original.state_dict(), original.policy.snapshot()
    copies = ddpg(seed=1), ddpg(seed=2)
    for learner in (original, *copies):  # in turn: none may write to the state of the others
        if learner is not original:
            learner.load_state_dict(state)
            learner.policy.load_snapshot(snapshot)
        for step in range(3):
            learner.update(batch(seed=step))
            learner.update_targets()
    for copy in copies:
        for name in ("actor", "critic", "target_actor", "target_critic"):
            assert torch.equal(weights(copy, name), weights(original, name)), name
