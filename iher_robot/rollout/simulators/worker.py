"""Simulator process: runs ordered episodes until the training process ends it."""

from __future__ import annotations

import signal
import traceback
from contextlib import suppress
from multiprocessing.connection import Connection

import torch

from drivers import DriverError
from iher_robot.config.device import prepare_torch
from iher_robot.config.run import RunConfig
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.errors import UserError, describe
from iher_robot.learning.exploration import Explorer
from iher_robot.learning.policy import Policy
from iher_robot.rollout.actor import PolicyActor
from iher_robot.rollout.episode import run_episode
from iher_robot.rollout.simulators.actor import read_snapshot
from iher_robot.rollout.simulators.child_process import exit_on_hangup
from iher_robot.rollout.simulators.episode import Order, SentRecorder
from iher_robot.rollout.simulators.messages import GONE, Message, receive_message, send_message
from iher_robot.storage.episode import DONE
from tasks import TaskError

_EXPECTED = (UserError, DriverError, TaskError)
"""Errors whose message is a sentence for the user."""


def main(descriptor: int) -> None:
    """Run the simulator process.

    Args:
        descriptor: File descriptor of the socket to the training process.
    """
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the run, which gets one too, ends this process
    exit_on_hangup(descriptor)
    connection = Connection(descriptor)
    with suppress(*GONE):  # as this process is about to be
        try:
            _serve(connection)
        except _EXPECTED as error:
            send_message(connection, {"kind": "failed", "sentence": str(error)})


def _serve(connection: Connection) -> None:
    config = RunConfig.model_validate_json(receive_message(connection)["config"])
    prepare_torch(config)
    torch.set_num_threads(1)  # each simulator has a core; one row is too little to share
    with config.chosen_robot.make_env(config.task) as env:
        env.driver.open()  # before the first reset, so that all of them take equally long
        opened_ticks = env.driver.now_ns // env.driver.spec.control_period_ns
        send_message(connection, {"kind": "ready", "opened_ticks": opened_ticks})
        while True:
            order = receive_message(connection)
            if order["kind"] == "actor":
                policy, explorer = read_snapshot(
                    order["snapshot"], config.learner, env.task.contact_model
                )
            else:
                episode = Order(order["seed"], order["ticks"], order["explores"])
                send_message(connection, _run(env, episode, policy, explorer))


def _run(env: GoalRobotEnv, order: Order, policy: Policy, explorer: Explorer) -> Message:
    recorder, failure = SentRecorder(env), ""
    ended = DONE
    try:
        run_episode(
            env,
            PolicyActor(policy, explorer if order.explores else None),
            recorder,
            seed=order.seed,
            ticks=order.ticks,
        )
    except _EXPECTED as error:
        ended, failure = describe(error), str(error)
    except Exception as error:  # noqa: BLE001 - what was recorded is sent with it
        traceback.print_exc()
        ended = describe(error)
        failure = f"an episode in a simulator ended by {ended}, see its messages above"
    return recorder.message(recorder.aborted or ended, failure)
