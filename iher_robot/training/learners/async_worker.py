"""Child process of an asynchronous learner: learns epochs until its run ends."""

from __future__ import annotations

import select
import signal
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from drivers import DriverError
from iher_robot.config.run import RunConfig
from iher_robot.errors import UserError
from iher_robot.rollout.simulators.child_process import exit_on_hangup
from iher_robot.rollout.simulators.messages import (
    GONE,
    Message,
    receive_message,
    send_message,
    unpack_episodes,
)
from iher_robot.training.learners.base import learn_epoch
from iher_robot.training.learners.messages import begin_learner
from iher_robot.training.setup import open_pool, seeds_runner
from tasks import TaskError


def main(descriptor: int) -> None:
    """Run the learner process.

    Args:
        descriptor: File descriptor of the socket to the run.
    """
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the run, which gets one too, ends this process
    exit_on_hangup(descriptor)  # in the middle of learning, too
    connection = Connection(descriptor)
    with suppress(*GONE):  # as this process is about to be
        try:
            _serve(connection)
        except (UserError, DriverError, TaskError) as error:
            send_message(connection, {"kind": "failed", "sentence": str(error)})


def _serve(connection: Connection) -> None:
    begin = receive_message(connection)
    config = RunConfig.model_validate_json(begin["config"])
    learner = begin_learner(begin, config, partial(receive_message, connection))

    def progress(phase: str, done: int, total: int) -> None:
        # Dropped rather than waited for: the run receives only between two episodes.
        if select.select([], [connection], [], 0.0)[1]:
            send_message(
                connection, {"kind": "progress", "phase": phase, "done": done, "total": total}
            )

    with ExitStack() as stack:
        run_seeds = None
        if begin["simulated"]:
            simulator = stack.enter_context(config.chosen_robot.make_env(config.task))
            run_seeds = seeds_runner(simulator, open_pool(config, simulator, stack))
        while True:
            order = receive_message(connection)
            metrics = learn_epoch(
                learner,
                unpack_episodes(order["episodes"]),
                config,
                run_seeds if order["evaluate"] else None,
                progress,
            )
            send_message(connection, _learned(metrics, learner.state_dict()))


def _learned(metrics: Mapping[str, Any], state: dict[str, Any]) -> Message:
    # NumPy's scalars would be objects, which weights_only refuses.
    plain = {key: v.item() if hasattr(v, "item") else v for key, v in metrics.items()}
    return {"kind": "learned", "metrics": plain, "state": state}
