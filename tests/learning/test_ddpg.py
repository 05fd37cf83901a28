"""DDPG: targets, target networks, and the networks that each loss trains."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import nn

from iher_robot.learning.ddpg import DDPG, target_bounds
from iher_robot.learning.policy import Policy
from iher_robot.learning.transitions import Transitions
from tests.learning.fakes import ACTION, CPU, OBS, generator
from tests.learning.point_mass import SHAPES, small_config

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


def heads(critics: nn.Module) -> list[nn.Linear]:
    """Last layer of each network, the members of the first component first."""
    layers = [layer for layer in critics.modules() if isinstance(layer, nn.Linear)]
    return [layer for layer in layers if layer.out_features == 1]


def with_target_values(learner: DDPG, values: Sequence[Sequence[float]]) -> DDPG:
    """Give each target critic a constant value. ``(components, members)``"""
    flat = [value for members in values for value in members]
    with torch.no_grad():
        for head, value in zip(heads(learner._networks.target_critics), flat, strict=True):
            head.weight.zero_()
            head.bias.fill_(value)
    return learner


def targets_of(learner: DDPG, data: Transitions) -> tuple[torch.Tensor, torch.Tensor]:
    """Targets of a batch, and whether each was clipped. ``(components, batch)`` each"""
    return learner._targets(learner._minibatches(data, 1), 0)


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
def test_targets_are_reward_plus_discounted_value_clipped_to_possible_returns(
    clip_target: str, bounds: tuple[float, float], value: float
) -> None:
    learner = ddpg(gamma=0.9, clip_target=clip_target, intrinsic_clip=0.6)
    assert target_bounds(learner.config) == [pytest.approx(bounds)]
    data = batch()
    raw = data.extrinsic + data.intrinsic + 0.9 * value  # rewards of 0 bootstrap as well
    targets, clipped = targets_of(with_target_values(learner, [[value]]), data)
    torch.testing.assert_close(targets, raw.clamp(*bounds)[None])
    outside = (raw < bounds[0]) | (raw > bounds[1])
    assert torch.equal(clipped, outside[None])
    reported = learner.update(data)["target_clipped"]
    assert float(reported) == pytest.approx(float(outside.float().mean()))


def test_targets_depend_on_the_next_observation_and_the_target_networks_only() -> None:
    learner, data = ddpg(clip_target="off"), batch()
    before, _ = targets_of(learner, data)
    for field in ("observation", "action"):
        changed = replace(data, **{field: torch.zeros_like(getattr(data, field))})
        assert torch.equal(targets_of(learner, changed)[0], before), field
    for field in ("next_observation", "goal", "extrinsic", "intrinsic"):
        changed = replace(data, **{field: getattr(data, field) + 1})
        assert not torch.allclose(targets_of(learner, changed)[0], before), field
    flipped = replace(data, source=1 - data.source)
    assert not torch.allclose(targets_of(learner, flipped)[0], before)
    for _ in range(3):
        learner.update(data)  # moves the online networks only
    assert torch.equal(targets_of(learner, data)[0], before)


@pytest.mark.parametrize("tau", [0.05, 0.5, 1.0])
def test_target_networks_move_by_exactly_tau_and_only_when_updated(tau: float) -> None:
    learner, data = ddpg(tau=tau), batch()
    old = {name: weights(learner, f"target_{name}") for name in ("actor", "critics")}
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
    for name in ("actor", "critics"):
        assert torch.equal(weights(learner, f"target_{name}"), weights(learner, name))


def test_the_actors_loss_leaves_the_critic_alone() -> None:
    # The target networks stand still, so the critic's path depends on its own loss only.
    gentle, harsh = ddpg(action_l2=0.0, actor_lr=1e-4), ddpg(action_l2=100.0, actor_lr=1e-1)
    for _ in range(4):
        assert change(gentle, "critics", batch()) > 0
        assert change(harsh, "critics", batch()) > 0
        assert torch.equal(weights(gentle, "critics"), weights(harsh, "critics"))
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
        state["critics"] = {name: 0 * tensor for name, tensor in state["critics"].items()}
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
    value = learner.critics(features, data.action)
    assert value.shape == (1, 1, len(data.source))
    expected = (value[:, 0] - targets_of(learner, data)[0]).square().mean().detach()
    assert float(learner.update(data)["critic_loss"]) == pytest.approx(float(expected), rel=1e-5)


def test_the_critics_depend_on_the_source_only_if_it_is_an_input() -> None:
    data = batch()
    flipped = replace(data, source=1 - data.source)
    for is_input in (True, False):
        learner = ddpg(source_input=is_input, clip_target="off")
        same = torch.equal(targets_of(learner, data)[0], targets_of(learner, flipped)[0])
        assert same is not is_input


MANY = {"critics": 3, "target_subset": 2}


@pytest.mark.parametrize("subset", [1, 2, 3])
def test_targets_bootstrap_from_the_minimum_of_the_drawn_critics(subset: int) -> None:
    learner = ddpg(gamma=0.5, clip_target="off", critics=3, target_subset=subset)
    values, data = [-3.0, 1.0, -7.0], batch()
    with_target_values(learner, [values])
    reward = data.extrinsic + data.intrinsic
    least = torch.stack([2.0 * (targets_of(learner, data)[0][0] - reward) for _ in range(300)])
    assert (least.std(dim=1) < 1e-5).all()  # one subset a batch
    counts = Counter(round(value, 3) for value in least[:, 0].tolist())
    subsets = [min(each) for each in itertools.combinations(values, subset)]
    assert set(counts) == set(subsets)
    for value, count in counts.items():
        assert count / 300 == pytest.approx(subsets.count(value) / len(subsets), abs=0.12)


def test_every_critic_is_trained_towards_the_same_targets() -> None:
    learner, data = ddpg(critic_lr=1e-2, tau=1e-9, **MANY), batch()
    for _ in range(300):
        learner.update(data)
    with_target_values(learner, [[-2.0] * 3])  # so that every subset has the same least
    targets, _ = targets_of(learner, data)
    features = learner.policy.features(data.observation, data.goal, data.source)
    before = (learner.critics(features, data.action) - targets).square().mean(-1)
    for _ in range(100):
        learner.update(data)
    after = (learner.critics(features, data.action) - targets).square().mean(-1)
    assert before.shape == (1, 3)
    assert (after < 0.1 * before).all()


def test_the_actor_climbs_the_mean_of_its_critics_summed_over_components() -> None:
    learner, data = ddpg(component_critics=True, action_l2=0.0, critic_lr=1e-12, **MANY), batch()
    features = learner.policy.features(data.observation, data.goal, data.source)
    for _ in range(3):
        with torch.no_grad():
            values = learner.critics(features, learner.policy.action(features))
        assert values.shape == (2, 3, len(data.source))
        expected = float(values.mean(dim=(1, 2)).sum())
        assert float(learner.update(data)["q"]) == pytest.approx(expected, abs=1e-6)
    # Either component alone moves the actor: what it does is not the one's or the other's.
    moves = []
    for silent in (0, 1):
        learner = ddpg(component_critics=True, action_l2=0.0, critic_lr=1e-12)
        with torch.no_grad():
            heads(learner.critics)[silent].weight.zero_()
        moves.append(change(learner, "actor", data))
    assert min(moves) > 1e-4


@pytest.mark.parametrize(
    ("clip_target", "bounds"),
    [
        ("her", [(-10.0, 0.0), (0.0, 6.0)]),
        ("intrinsic", [(-10.0, 0.0), (0.0, 6.0)]),
        ("off", [(-float("inf"), float("inf"))] * 2),
    ],
)
@pytest.mark.parametrize("values", [(-9.5, 6.5), (0.5, -1.0), (-30.0, 2.0)])
def test_each_component_has_targets_from_its_reward_and_bounds(
    clip_target: str, bounds: list[tuple[float, float]], values: tuple[float, float]
) -> None:
    settings: Settings = {"gamma": 0.9, "clip_target": clip_target, "intrinsic_clip": 0.6}
    learner = ddpg(component_critics=True, **settings)
    data = batch()
    targets, clipped = targets_of(with_target_values(learner, [[value] for value in values]), data)
    assert targets.shape == clipped.shape == (2, len(data.source))
    for index, reward in enumerate((data.extrinsic, data.intrinsic)):
        low, high = target_bounds(learner.config)[index]
        assert (low, high) == pytest.approx(bounds[index])
        raw = reward + 0.9 * values[index]
        torch.testing.assert_close(targets[index], raw.clamp(low, high))
        assert torch.equal(clipped[index], (raw < low) | (raw > high))


@pytest.mark.parametrize("period", [1, 3])
def test_the_actor_moves_once_a_period_and_the_critics_always(period: int) -> None:
    learner, moved = ddpg(actor_period=period), []
    for step in range(7):
        assert change(learner, "critics", batch(seed=2 * step)) > 0
        moved.append(change(learner, "actor", batch(seed=2 * step + 1)) > 0)
    assert moved == [step % period == 0 for step in range(1, 14, 2)]


def test_targets_move_at_each_update_or_at_the_end_of_a_cycle() -> None:
    data = batch()
    for when, at_update, at_cycle in (("update", True, False), ("cycle", False, True)):
        learner = ddpg(target_update=when, tau=0.3)
        for _ in range(3):
            for name in ("actor", "critics"):
                before = weights(learner, f"target_{name}")
                learner.update(data)
                after = weights(learner, f"target_{name}")
                expected = torch.lerp(before, weights(learner, name), 0.3 * at_update)
                torch.testing.assert_close(after, expected)
                learner.end_cycle()
                expected = torch.lerp(after, weights(learner, name), 0.3 * at_cycle)
                torch.testing.assert_close(weights(learner, f"target_{name}"), expected)
                assert not torch.equal(weights(learner, f"target_{name}"), before)


def test_the_running_mean_of_the_actors_weights_acts_if_enabled() -> None:
    data, mean = batch(), ddpg(policy_average=0.25)
    expected = weights(mean, "actor")
    assert torch.equal(acting(mean), expected)
    for update in range(1, 9):
        mean.update(data)
        expected = torch.lerp(expected, weights(mean, "actor"), max(0.25, 1.0 / update))
        torch.testing.assert_close(acting(mean), expected)
        assert update == 1 or not torch.allclose(acting(mean), weights(mean, "actor"))
    newest = ddpg()
    newest.update(data)
    assert torch.equal(acting(newest), weights(newest, "actor"))


def acting(learner: DDPG) -> torch.Tensor:
    return torch.cat([t.flatten() for t in learner.acting_snapshot()["actor"].values()])


@pytest.mark.parametrize(
    "settings",
    [
        {},
        MANY
        | {
            "actor_period": 2,
            "target_update": "update",
            "component_critics": True,
            "policy_average": 0.1,
        },
    ],
    ids=["paper", "ensemble"],
)
def test_a_restored_ddpg_continues_like_the_original(settings: Settings) -> None:
    original, data = ddpg(seed=0, **settings), batch()
    for _ in range(3):
        original.update(data)
        original.update_targets()
    state, snapshot = original.state_dict(), original.policy.snapshot()
    copies = ddpg(seed=1, **settings), ddpg(seed=2, **settings)
    for learner in (original, *copies):  # in turn: none may write to the shared state
        if learner is not original:
            learner.load_state_dict(state)
            learner.policy.load_snapshot(snapshot)
        for step in range(12):
            learner.update(batch(seed=step))
            learner.update_targets()
    for copy in copies:
        for name in ("actor", "critics", "target_actor", "target_critics", "mean_actor"):
            assert torch.equal(weights(copy, name), weights(original, name)), name
