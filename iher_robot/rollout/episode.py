"""The episode loop: the one place where a policy moves a robot, tick by tick."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from enum import IntEnum
from functools import partial
from types import TracebackType

import numpy as np

from iher_robot.env.goal_env import EpisodeAborted
from iher_robot.rollout.actor import Actor
from iher_robot.rollout.observer import EpisodeEnv, EpisodeObserver, EpisodeStart, Transition
from iher_robot.rollout.recorder import EpisodeOutcome
from iher_robot.signals import end_if_terminated


class Stream(IntEnum):
    """Independent streams of episode seeds within a run."""

    COLLECTION = 0
    EVALUATION = 1
    FINAL_EVALUATION = 2


def episode_seed(run_seed: int, stream: Stream, index: int) -> int:
    """Seed of one episode, which depends on nothing that happened before it.

    So a resumed run draws the starts, goals and noise that it would have drawn.

    Args:
        run_seed: Seed of the run.
        stream: What the episode is for.
        index: Number of the episode within its stream, from 0.

    Returns:
        A seed below 2**32.
    """
    sequence = np.random.SeedSequence((run_seed, int(stream), index))
    return int(sequence.generate_state(1, np.uint32)[0])


def run_episode(
    env: EpisodeEnv,
    actor: Actor,
    outcome: EpisodeOutcome,
    *,
    seed: int,
    ticks: int,
    observers: Sequence[EpisodeObserver] = (),
) -> None:
    """Run one episode; the robot is left held and disarmed however it ends.

    Collecting, evaluating, deploying, viewing and filming all run this loop and differ in what
    observes it.

    Args:
        env: The environment. It arms the robot at reset.
        actor: Chooses the actions.
        outcome: Counts the ticks, and is the first observer; the caller has it also when this
            raises.
        seed: Decides start, goal and noise.
        ticks: Most ticks to charge.
        observers: Follow the episode, in this order.

    Raises:
        Terminated: The process got a SIGTERM; it is heeded between two ticks.
    """
    watching = (outcome, *observers)
    actor.begin(seed)
    try:
        observation, _ = env.reset(seed=seed)
        for observer in watching:
            observer.start(EpisodeStart(env, observation, actor.policy_source))
        with _without_garbage_collection():
            while outcome.ticks < ticks:
                action = actor.act(observation)
                end_if_terminated()
                for observer in watching:
                    observer.before_tick(observation, action)
                after, _, _, _, info = env.step(action)
                for observer in watching:
                    observer.after_tick(Transition(observation, action, after, info))
                observation = after
    except EpisodeAborted as error:
        for observer in watching:  # what was recorded until then is kept, and learned from
            observer.abort(error)
    finally:
        failure = sys.exception()
        with ExitStack() as ends:  # each gets its end, whatever another one's raises
            for observer in reversed(watching):
                ends.push(partial(_end, observer, failure))
            env.hold(after=failure)


def _end(
    observer: EpisodeObserver,
    failure: BaseException | None,
    _kind: type[BaseException] | None,
    error: BaseException | None,
    _trace: TracebackType | None,
) -> None:
    observer.end(failure or error)


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    # One of all that torch and MuJoCo bring takes 0.2 s: five ticks, and as long as a host waits.
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if before:
            gc.enable()
