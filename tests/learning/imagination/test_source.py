"""The imaginary source: policies, models, amounts and order of its rollouts."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.goal_model import IMAGINED, REAL
from iher_robot.learning.imagination import source as imaginary_source
from iher_robot.learning.imagination.dynamics import DynamicsEnsemble
from iher_robot.learning.imagination.source import ImaginarySource
from iher_robot.learning.policy import Policy
from iher_robot.learning.replay import EpisodeReplay
from iher_robot.learning.transitions import Transitions
from tests.learning.fakes import (
    CPU,
    OBS,
    drifting_ensemble,
    generator,
    linear_ensemble,
    linear_policy,
    marked_episode,
    quiet_config,
    replay_of,
    stored,
)
from tests.learning.point_mass import SHAPES, PointMassGoals

TICKS = SHAPES.episode_ticks
STARTS = torch.zeros(1, OBS)
# 3 cycles of 2 rollouts, so 6 rollouts a policy in a refill.
SCHEDULE = {"cycles": 3, "imaginary_rollouts": 2}


def source(config: LearnerConfig, starts: torch.Tensor = STARTS) -> ImaginarySource:
    """A source whose real episodes have these starts."""
    real, count = replay_of(), len(starts)
    observations = starts.unsqueeze(1).expand(count, 2, OBS)
    actions, goals = torch.zeros(count, 1, SHAPES.action_dim), torch.zeros(count, SHAPES.goal_dim)
    real.add(observations, actions, goals, epoch=1)
    return ImaginarySource(
        SHAPES, PointMassGoals(), config, real, generator=generator(), device=CPU
    )


def filled(config: LearnerConfig, cycles: int, drift: float = 1.0) -> ImaginarySource:
    imagined = source(config)
    for _ in range(cycles):
        imagined.imagine_cycle(drifting_ensemble(drift), linear_policy(), epoch=1)
    return imagined


def refill(
    imagined: ImaginarySource,
    ensemble: DynamicsEnsemble,
    *,
    policy: Policy | None = None,
    cycle: int = 99,
) -> dict[str, float]:
    return imagined.refill(
        ensemble,
        linear_policy() if policy is None else policy,
        epoch=2,
        cycle=cycle,
        progress=lambda phase, done, total: None,
    )


def actors(imagined: ImaginarySource) -> list[float]:
    """Bias of the policy that acted in each stored episode, in order."""
    _, action, _ = stored(imagined.replay)
    return [round(a, 3) for a in torch.atanh(action[::TICKS, 0]).tolist()]


def sample(imagined: ImaginarySource, count: int = 2000) -> Transitions:
    return imagined.replay.sample(count, generator(), PointMassGoals(), future_fraction=0.8)


@pytest.mark.parametrize("chunk", [4, 4_000])
def test_a_refill_restores_the_level_with_the_newest_models_only(
    chunk: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(imaginary_source, "CHUNK", chunk)
    imagined = filled(quiet_config(schedule=SCHEDULE), cycles=8, drift=1.0)
    assert imagined.level == imagined.replay.num_transitions == 16 * TICKS
    refill(imagined, drifting_ensemble(-1.0))
    assert imagined.level == imagined.replay.num_transitions == 16 * TICKS
    observation, _, following = stored(imagined.replay)
    # The old model moved entry 2 up, the new one moves it down.
    assert set((following - observation)[:, 2].tolist()) == {-1.0}
    assert imagined.replay.newest_epoch == 2


def test_the_current_policy_comes_first_then_copies_from_the_newest_to_the_oldest() -> None:
    imagined = filled(quiet_config(schedule=SCHEDULE), cycles=8)  # level: 16 rollouts
    for cycle in (2, 4, 6):
        imagined.keep_copy(linear_policy((cycle / 10, 0.0)), cycle)
    refill(imagined, drifting_ensemble(0.0), policy=linear_policy((0.9, 0.0)), cycle=7)
    assert actors(imagined) == [0.9] * 6 + [0.6] * 6 + [0.4] * 4


def test_the_newest_copy_is_used_once_if_it_is_the_current_policy() -> None:
    imagined = filled(quiet_config(schedule=SCHEDULE), cycles=8)
    for cycle in (2, 4, 6):
        imagined.keep_copy(linear_policy((cycle / 10, 0.0)), cycle)
    refill(imagined, drifting_ensemble(0.0), policy=linear_policy((0.6, 0.0)), cycle=6)
    assert actors(imagined) == [0.6] * 6 + [0.4] * 6 + [0.2] * 4


def test_too_few_copies_share_the_level_equally() -> None:
    imagined = filled(quiet_config(schedule=SCHEDULE), cycles=8)
    imagined.keep_copy(linear_policy((0.2, 0.0)), 2)
    refill(imagined, drifting_ensemble(0.0), policy=linear_policy((0.9, 0.0)))
    assert actors(imagined) == [0.9] * 8 + [0.2] * 8


def test_copies_are_independent_of_the_policy_and_keep_their_normalisers() -> None:
    imagined = filled(quiet_config(schedule={"cycles": 1, "imaginary_rollouts": 1}), cycles=3)
    policy = linear_policy(goal_gain=0.5)
    policy.obs_normalizer.update(torch.full((4, OBS), 10.0))  # a position of 0 is now far below
    imagined.keep_copy(policy, 1)
    policy.obs_normalizer.update(torch.full((400, OBS), -10.0))  # and now far above
    imagined.keep_copy(policy, 2)
    policy.load_snapshot(linear_policy((0.1, 0.0)).snapshot())
    refill(imagined, drifting_ensemble(0.0), policy=policy)
    assert actors(imagined)[0] == pytest.approx(0.1)
    _, action, _ = stored(imagined.replay)
    assert (action[TICKS : 2 * TICKS] < -0.9).all()
    assert (action[2 * TICKS :] > 0.9).all()


def test_the_oldest_copies_are_dropped_beyond_the_capacity() -> None:
    imagined = filled(quiet_config(schedule=SCHEDULE, replay={"capacity": 16 * TICKS}), cycles=8)
    for cycle in range(1, 20):
        imagined.keep_copy(linear_policy((cycle / 20, 0.0)), cycle)
    kept = [cycle for cycle, _ in imagined.state_dict()["policy_copies"]]
    assert kept == [16, 17, 18, 19]  # a copy of the current policy, and three that fill 16 rollouts


def test_collected_counts_new_rollouts_neither_refilled_nor_capped_by_the_capacity() -> None:
    imagined = filled(quiet_config(schedule=SCHEDULE, replay={"capacity": 4 * TICKS}), cycles=10)
    assert imagined.collected == 20 * TICKS
    assert imagined.level == imagined.replay.num_transitions == 4 * TICKS
    refill(imagined, drifting_ensemble(0.0))
    assert imagined.collected == 20 * TICKS
    assert imagined.replay.num_transitions == 4 * TICKS


def overflowing() -> tuple[DynamicsEnsemble, torch.Tensor]:
    """A model that diverges from the second of two starts."""
    ensemble = drifting_ensemble(0.0, 0.0)
    state = ensemble.state_dict()
    state["members"]["1.0.weight"][2, 0] = 1e38
    ensemble.load_state_dict(state)
    starts = torch.zeros(2, OBS)
    starts[1, 0] = 100.0
    return ensemble, starts


def test_dropped_rollouts_are_counted_and_replaced_in_a_refill() -> None:
    ensemble, starts = overflowing()
    imagined = source(quiet_config(schedule={"cycles": 2, "imaginary_rollouts": 200}), starts)
    report = imagined.imagine_cycle(ensemble, linear_policy(), epoch=1)
    kept = 200 * (1 - report["imagined_dropped"])
    assert 60 < kept < 140
    assert imagined.collected == imagined.level == pytest.approx(kept * TICKS)
    level = imagined.level
    report = refill(imagined, ensemble)
    assert 0 < report["imagined_dropped"] < 1
    assert imagined.level == imagined.replay.num_transitions == level
    assert (stored(imagined.replay)[0][:, 0] == 0).all()


def test_a_few_rollouts_dropped_by_chance_at_the_end_do_not_stop_a_refill() -> None:
    ensemble, starts = overflowing()
    imagined = source(quiet_config(schedule={"cycles": 1, "imaginary_rollouts": 60}), starts)
    imagined.imagine_cycle(ensemble, linear_policy(), epoch=1)
    for _ in range(20):  # each ends with passes of one or two rollouts, half of them bad
        refill(imagined, ensemble)
        assert imagined.replay.num_transitions == imagined.level


def test_a_refill_without_finite_rollouts_fails_and_names_the_remedy() -> None:
    imagined = filled(quiet_config(schedule=SCHEDULE), cycles=1)
    with pytest.raises(FloatingPointError, match=r"every imagined rollout.*learner\.dynamics\.lr"):
        refill(imagined, drifting_ensemble(float("nan"), 0.0))


def test_rollouts_start_where_real_episodes_started_with_goals_of_the_task() -> None:
    starts = PointMassGoals().complete(torch.randn(3, OBS, generator=generator()))
    imagined = source(quiet_config(schedule={"imaginary_rollouts": 60}), starts)
    imagined.imagine_cycle(drifting_ensemble(0.0), linear_policy(), epoch=1)
    begun = imagined.replay.start_observations()
    assert {tuple(row) for row in begun.tolist()} == {tuple(row) for row in starts.tolist()}
    goals = imagined.replay.sample(4000, generator(), PointMassGoals(), future_fraction=0.0).goal
    assert len(goals.unique(dim=0)) == 60  # one a rollout
    assert goals.abs().max() <= 0.3
    assert goals.std() > 0.1


def test_imagined_actions_are_explored_like_real_ones() -> None:
    config = quiet_config(
        schedule={"imaginary_rollouts": 200}, exploration={"random_fraction": 0.3}
    )
    imagined = source(config)
    imagined.imagine_cycle(drifting_ensemble(0.0), linear_policy(), epoch=1)
    _, action, _ = stored(imagined.replay)
    assert float((action != 0).all(-1).float().mean()) == pytest.approx(0.3, abs=0.04)


class Recording(Policy):
    """Records its source input at each step."""

    sources: list[torch.Tensor]

    def act(
        self, observation: torch.Tensor, goal: torch.Tensor, source: torch.Tensor
    ) -> torch.Tensor:
        self.sources.append(source)
        return super().act(observation, goal, source)


@pytest.mark.parametrize("share", [0.0, 0.1, 1.0])
def test_a_share_of_rollouts_acts_with_the_real_source_but_is_stored_as_imagined(
    share: float,
) -> None:
    config = quiet_config(schedule={"imaginary_rollouts": 1000}, exploration={"source_flip": share})
    imagined = source(config)
    policy = linear_policy((0.1, 0.0), real_bias=0.4, cls=Recording)
    assert isinstance(policy, Recording)
    policy.sources = []
    imagined.imagine_cycle(drifting_ensemble(0.0), policy, epoch=1)
    sources = torch.stack(policy.sources)
    assert sources.shape == (TICKS, 1000)
    assert (sources == sources[0]).all()  # for the whole rollout
    assert float((sources[0] == REAL).float().mean()) == pytest.approx(share, abs=0.03)
    assert actors(imagined) == pytest.approx([0.5 if s == REAL else 0.1 for s in sources[0]])
    assert (sample(imagined).source == IMAGINED).all()


@pytest.mark.parametrize("enabled", [True, False])
def test_stored_rewards_are_the_intrinsic_ones_or_zero(enabled: bool) -> None:
    # Normalised predictions of entry 2 are -1 and 1: variance 1 in one of six entries.
    settings: dict[str, Any] = {"enabled": enabled, "scale": 0.3}
    imagined = source(quiet_config(intrinsic=settings))
    report = imagined.imagine_cycle(drifting_ensemble(-1.0, 1.0), linear_policy(), epoch=1)
    expected = 0.3 / 6 if enabled else 0.0
    assert sample(imagined).intrinsic.tolist() == pytest.approx([expected] * 2000)
    assert report["intrinsic_imagined"] == pytest.approx(expected)
    assert report["intrinsic_clipped"] == 0.0


def test_the_share_of_clipped_intrinsic_rewards_is_reported() -> None:
    imagined = source(quiet_config(intrinsic={"reduce": "sum", "scale": 0.5, "clip": 0.2}))
    report = imagined.imagine_cycle(drifting_ensemble(-1.0, 1.0), linear_policy(), epoch=1)
    assert report["intrinsic_clipped"] == 1.0
    assert report["intrinsic_imagined"] == pytest.approx(0.2)


def test_a_restored_source_refills_like_the_original() -> None:
    config = quiet_config(schedule=SCHEDULE)
    original, restored = filled(config, cycles=8), filled(config, cycles=1)
    original.keep_copy(linear_policy((0.2, 0.0)), 2)
    original.keep_copy(linear_policy((0.4, 0.0)), 4)
    restored.load_state_dict(original.state_dict())
    assert restored.replay.num_episodes == 0
    assert restored.collected == original.collected
    for each in (original, restored):
        refill(each, drifting_ensemble(0.0), policy=linear_policy((0.4, 0.0)), cycle=4)
    assert actors(restored) == actors(original) == [0.4] * 8 + [0.2] * 8


def branching(**exploration: float) -> tuple[ImaginarySource, EpisodeReplay]:
    """Branches of 3 ticks from four real episodes with distinct observations."""
    config = quiet_config(
        schedule={"imaginary_rollouts": 200},
        imagination={"branch_ticks": 3},
        replay={"future_fraction": 0.5},
        exploration=exploration,
    )
    real = replay_of([marked_episode(number, TICKS) for number in range(4)])
    imagined = ImaginarySource(
        SHAPES, PointMassGoals(), config, real, generator=generator(), device=CPU
    )
    return imagined, real


def test_branches_begin_anywhere_in_a_real_episode_with_one_of_its_goals() -> None:
    imagined, _ = branching()
    imagined.imagine_cycle(drifting_ensemble(0.0), linear_policy(), epoch=1)
    assert imagined.replay.num_transitions == 200 * 3
    batch = imagined.sample(4000)
    episode, tick = batch.observation[:, 0].round(), batch.observation[:, 1].round()
    assert set(tick.tolist()) == set(range(TICKS))  # never after the last action
    desired = batch.goal[:, 0] == -1.0
    assert 0.4 < desired.float().mean() < 0.6
    assert torch.equal(batch.goal[desired, 1], episode[desired])  # its own goal
    assert torch.equal(batch.goal[~desired, 0], episode[~desired])  # or one achieved in it, later
    assert (batch.goal[~desired, 1] > tick[~desired]).all()


def test_branches_are_not_relabelled_within_themselves() -> None:
    imagined, _ = branching()
    imagined.imagine_cycle(drifting_ensemble(0.0), linear_policy(), epoch=1)
    stored_goals = {tuple(goal) for goal in imagined.replay._goals[:200].tolist()}
    assert {tuple(goal) for goal in imagined.sample(2000).goal.tolist()} <= stored_goals


def test_new_models_drop_the_branches_of_the_old_ones() -> None:
    imagined, _ = branching()
    imagined.imagine_cycle(drifting_ensemble(1.0), linear_policy(), epoch=1)
    assert refill(imagined, drifting_ensemble(-1.0)) == {}
    assert imagined.replay.num_episodes == 0
    imagined.imagine_cycle(drifting_ensemble(-1.0), linear_policy(), epoch=2)
    batch = imagined.sample(500)
    assert (batch.next_observation[:, 2] < batch.observation[:, 2]).all()


def test_the_rollouts_on_which_the_models_agree_best_are_kept() -> None:
    # Two members drift apart by what the action says: the larger it is, the less they agree.
    weight = torch.zeros(OBS, OBS + SHAPES.action_dim)
    ensemble = linear_ensemble([[0.0] * OBS] * 2, weight)
    state = ensemble.state_dict()
    state["members"]["1.0.weight"][2, OBS] = 1.0
    ensemble.load_state_dict(state)
    config = quiet_config(
        schedule=SCHEDULE,
        exploration={"random_fraction": 1.0},
        imagination={"keep": 0.25, "branch_ticks": 1},
    )
    imagined = source(config)
    report = imagined.add_rollouts(ensemble, linear_policy(), 50, epoch=1)
    assert report["kept"] == 50
    _, action, _ = stored(imagined.replay)
    assert len(action) == 50
    assert float(action[:, 0].abs().max()) == pytest.approx(0.25, abs=0.1)
    assert float(action[:, 1].abs().max()) > 0.9
