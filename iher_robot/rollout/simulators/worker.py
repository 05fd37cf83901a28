"""The process of a simulator: runs the episodes that it is told until its starter ends."""

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
from iher_robot.rollout.episode import run_episode
from iher_robot.rollout.simulators.actor import read_snapshot
from iher_robot.rollout.simulators.child_process import end_with_the_other_side
from iher_robot.rollout.simulators.episode import Order, SentRecorder
from iher_robot.rollout.simulators.messages import GONE, Message, receive_message, send_message
from iher_robot.storage.episode import DONE
from tasks import TaskError

_TOLD = (UserError, DriverError, TaskError)
"""Errors that say what is wrong in a sentence."""


def main(descriptor: int) -> None:
    """Be a simulator.

    Args:
        descriptor: Of the socket to the process that started this one.
    """
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the run, which gets one too, ends this process
    end_with_the_other_side(descriptor)
    connection = Connection(descriptor)
    with suppress(*GONE):  # as this process is about to be
        try:
            _serve(connection)
        except _TOLD as error:
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
                told = Order(order["seed"], order["ticks"], order["explores"])
                send_message(connection, _run(env, told, policy, explorer))


def _run(env: GoalRobotEnv, order: Order, policy: Policy, explorer: Explorer) -> Message:
    recorder, failure = SentRecorder(env), ""
    ended = DONE
    try:
        run_episode(
            env,
            policy,
            recorder,
            seed=order.seed,
            ticks=order.ticks,
            explorer=explorer if order.explores else None,
        )
    except _TOLD as error:
        ended, failure = describe(error), str(error)
    except Exception as error:  # noqa: BLE001 - what was recorded is told with it
        traceback.print_exc()
        ended = describe(error)
        failure = f"an episode in a simulator ended by {ended}, see its messages above"
    return recorder.message(recorder.aborted or ended, failure)
