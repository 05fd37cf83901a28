"""Accuracy of models and imagination, measured on held-out episodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from iher_robot.learning.episode import Episode, FloatArray
from iher_robot.learning.goal_model import IMAGINED, GoalModel
from iher_robot.learning.imagination.dynamics import DynamicsEnsemble
from iher_robot.learning.imagination.rollout import imagine
from iher_robot.learning.learner import Learner

HORIZONS = (1, 10, 50)
"""Ticks over which the models' errors are measured."""
CONTACT_M = 0.002
"""Motion of the achieved goal in one tick, m, that indicates contact."""


def _no_spread(predictions: torch.Tensor) -> torch.Tensor:
    return predictions.new_zeros(predictions.shape[1])


def open_loop_error(
    ensemble: DynamicsEnsemble,
    goal_model: GoalModel,
    episodes: Sequence[Episode],
    horizon: int,
    *,
    state_margin: float,
    generator: torch.Generator,
    least_motion: float = 0.0,
) -> tuple[float, float]:
    """Distance of the predicted from the real achieved goal after ``horizon`` ticks.

    Every window of ``horizon`` ticks of every episode counts once; the models see its first
    observation and its actions only.

    Args:
        ensemble: The models; a member is drawn at each step, as in imagination.
        goal_model: Achieved goals.
        episodes: Real episodes, preferably held out from training.
        horizon: Ticks to predict.
        state_margin: As in ``imagine``.
        generator: Draws the members.
        least_motion: Windows count only if the achieved goal ends at least this far from its start,
            in the goal's unit.

    Returns:
        Mean distance of the model's prediction, and of predicting no change, in the goal's
        unit. The first is nan where a prediction is not finite, both where no window counts.
    """
    windows = _windows(episodes, horizon, ensemble.obs_low.device)
    if windows is None:
        return float("nan"), float("nan")
    start, actions, end = windows
    real = goal_model.achieved_goal(end)
    motion = torch.linalg.vector_norm(goal_model.achieved_goal(start) - real, dim=-1)
    counts = motion >= least_motion
    if not counts.any():
        return float("nan"), float("nan")
    start, actions, real, motion = start[counts], actions[counts], real[counts], motion[counts]
    replayed = iter(actions.unbind(dim=1))
    rollouts = imagine(
        ensemble,
        goal_model,
        start=start,
        goals=real,
        act=lambda _: next(replayed),
        ticks=horizon,
        state_margin=state_margin,
        spread=_no_spread,
        generator=generator,
    )
    predicted = goal_model.achieved_goal(rollouts.observations[:, -1])
    model = torch.linalg.vector_norm(predicted - rollouts.goals, dim=-1).mean()
    return float("nan") if rollouts.dropped else float(model), float(motion.mean())


def _windows(
    episodes: Sequence[Episode], horizon: int, device: torch.device
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor] | None:
    """First observation, actions and last observation of every window of valid ticks."""
    windows = [
        (
            segment.observations[t],
            segment.actions[t : t + horizon],
            segment.observations[t + horizon],
        )
        for episode in episodes
        for segment in episode.segments()
        for t in range(len(segment) - horizon + 1)
    ]
    if not windows:
        return None

    def stack(column: int) -> torch.Tensor:
        return _tensor([window[column] for window in windows], device)

    return stack(0), stack(1), stack(2)


def _tensor(arrays: Sequence[FloatArray], device: torch.device) -> torch.Tensor:
    return torch.as_tensor(np.stack(arrays), dtype=torch.float32, device=device)


def imagined_success(
    learner: Learner, episodes: Sequence[Episode], *, generator: torch.Generator
) -> float:
    """Success rate in imagination from the starts and goals of real evaluation episodes.

    Args:
        learner: Its models and its acting policy, without noise and with the imagined source.
        episodes: Real episodes.
        generator: Draws the members.

    Returns:
        Share of rollouts whose last observation meets the goal.
    """
    device = learner.device
    starts = _tensor([e.observations[0] for e in episodes], device)
    goals = _tensor([e.desired_goal for e in episodes], device)
    source = torch.full((len(starts),), IMAGINED, device=device)
    policy = learner.acting_policy(device)
    rollouts = imagine(
        learner.ensemble,
        learner.goal_model,
        start=starts,
        goals=goals,
        act=lambda observation: policy.act(observation, goals, source),
        ticks=learner.shapes.episode_ticks,
        state_margin=learner.config.imagination.state_margin,
        spread=_no_spread,
        generator=generator,
    )
    achieved = learner.goal_model.achieved_goal(rollouts.observations[:, -1])
    met = learner.goal_model.compute_reward(achieved, rollouts.goals) == 0
    return float(met.sum()) / len(starts)


def diagnose(learner: Learner, episodes: Sequence[Episode]) -> dict[str, float]:
    """Model errors and imagined success on the episodes of an evaluation.

    Args:
        learner: After ``learn``; nothing is drawn from its generator.
        episodes: Evaluation episodes, held out from training.

    Returns:
        ``model_error_H`` and ``still_error_H`` for each horizon H, and for H = ``contact``, the
        single ticks in which the achieved goal moves; and ``imagined_success``. Empty if
        imagination is off.
    """
    if not learner.config.imagination.enabled or not episodes:
        return {}
    generator = torch.Generator(learner.device).manual_seed(learner.epoch)
    report: dict[str, float] = {}
    cases = [(str(horizon), horizon, 0.0) for horizon in HORIZONS] + [("contact", 1, CONTACT_M)]
    for name, horizon, least_motion in cases:
        model, still = open_loop_error(
            learner.ensemble,
            learner.goal_model,
            episodes,
            horizon,
            state_margin=learner.config.imagination.state_margin,
            generator=generator,
            least_motion=least_motion,
        )
        report[f"model_error_{name}"] = model
        report[f"still_error_{name}"] = still
    report["imagined_success"] = imagined_success(learner, episodes, generator=generator)
    return report
