"""Numbers that show whether imagination can be trusted, from episodes never learned from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from iher_robot.learning.episode import Episode
from iher_robot.learning.goal_model import IMAGINED, GoalModel
from iher_robot.learning.imagination.dynamics import DynamicsEnsemble
from iher_robot.learning.imagination.rollout import imagine
from iher_robot.learning.learner import Learner

HORIZONS = (1, 10, 50)
CONTACT_M = 0.002
"""Motion of the achieved goal in a tick, m, from which something pushes it."""


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
    """Distance of the predicted from the real achieved goal after some ticks of known actions.

    Every window of ``horizon`` ticks of every episode counts once; the model sees the window's
    first observation and its actions, nothing else.

    Args:
        ensemble: The models; a member is drawn at each step, as when imagining.
        goal_model: Achieved goals.
        episodes: Real episodes, best ones that the models were not trained on.
        horizon: Ticks to predict.
        state_margin: As in ``imagine``.
        generator: Draws the members.
        least_motion: Only windows count in which the achieved goal ends this far from where it
            began, in the goal's unit.

    Returns:
        Mean distance of the model's prediction, and of predicting no change, in the goal's
        unit. The first is nan where a prediction is not finite, both where no window counts.
    """
    device = ensemble.obs_low.device
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
        return float("nan"), float("nan")

    def stack(column: int) -> torch.Tensor:
        array = np.stack([window[column] for window in windows])
        return torch.as_tensor(array, dtype=torch.float32, device=device)

    start, actions, real = stack(0), stack(1), goal_model.achieved_goal(stack(2))
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


def imagined_success(
    learner: Learner, episodes: Sequence[Episode], *, generator: torch.Generator
) -> float:
    """Success rate in imagination from the starts and goals of real evaluation episodes.

    Args:
        learner: Its models and the policy that acts, without noise, told that it imagines.
        episodes: Real episodes.
        generator: Draws the members.

    Returns:
        Share of rollouts whose last observation meets the goal.
    """
    device = learner.device
    starts = torch.as_tensor(
        np.stack([e.observations[0] for e in episodes]), dtype=torch.float32, device=device
    )
    goals = torch.as_tensor(
        np.stack([e.desired_goal for e in episodes]), dtype=torch.float32, device=device
    )
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
        learner: After ``learn``; its own random stream is left alone.
        episodes: Evaluation episodes, which nothing was trained on.

    Returns:
        ``model_error_H`` and ``still_error_H`` for each horizon H, and with ``contact`` for H in
        the ticks in which the achieved goal moves; and ``imagined_success``. Nothing where
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
