"""Train a policy within a budget of robot minutes: the application behind ``iher-robot train``."""

from __future__ import annotations

import datetime
import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Unpack

from iher_robot.config.options import RunOptions, check_options, load_config
from iher_robot.config.run import RunConfig, change_simulators, dump_config, read_config
from iher_robot.env.operator import Operator
from iher_robot.errors import UserError
from iher_robot.evaluation.compatibility import check_fit, load_trained_policy
from iher_robot.evaluation.evaluate import FILMED_EPISODES, EvaluationResult, evaluate_on
from iher_robot.evaluation.success_rate import run_evaluation
from iher_robot.evaluation.video import require_film
from iher_robot.rollout.episode import Stream, episode_seed
from iher_robot.rollout.timing import describe_jitter
from iher_robot.storage.budget import Budget
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.interface import keep_interface
from iher_robot.storage.ledger import Ledger
from iher_robot.storage.provenance import collect_provenance
from iher_robot.storage.robot_time import RobotTime
from iher_robot.storage.run_directory import RunDirectory, default_run_path
from iher_robot.storage.run_result import RunResult, write_result
from iher_robot.training.display import TrainingDisplay
from iher_robot.training.listener import Row, RunListener, RunListeners, SuccessPlot
from iher_robot.training.loop import TrainingRun
from iher_robot.training.result import TrainResult
from iher_robot.training.setup import TrainingSetup, open_training_setup
from iher_robot.training.warm_start import check_sources, copy_sources


def train(
    config: RunConfig | None = None,
    *,
    task: str | None = None,
    out: Path | None = None,
    display: bool = True,
    video: bool = False,
    **options: Unpack[RunOptions],
) -> TrainResult:
    """Learn a task within a budget of robot minutes.

    Either with settings, as `load_config` and `read_config` return them, or with a task and the
    options of ``iher-robot train``: ``train(task="push", budget_minutes=10)``.

    Args:
        config: Settings of the run.
        task: Name of the task, instead of a config.
        out: Run folder to make; by default a new one under ``runs``.
        display: Show progress while it runs.
        video: Film the final policy, in simulation.
        options: Options of the run, beside a task; see `RunOptions`.

    Returns:
        How the run ended.

    Raises:
        UserError: Bad input; nothing has moved.
    """
    check_options("train", options)
    if (config is None) == (task is None) or (config is not None and options):
        raise UserError("train takes either a config, or a task with its options")
    if config is None:
        assert task is not None
        config = load_config(task, **options)
    if video:
        require_film(config.chosen_robot, config.task)
    path = out or default_run_path(config.task, config.algo, config.preset, config.seed)
    # The robot is made first: a bad driver or budget should leave no folder behind.
    with open_training_setup(config) as setup:
        check_sources(config.from_data, setup.env.policy_interface())
        directory = RunDirectory.create(path, dump_config(config))
        return _train(setup, directory, display=display, video=video)


def resume(
    directory: Path,
    *,
    simulators: int | None = None,
    display: bool = True,
    video: bool = False,
) -> TrainResult:
    """Continue a stopped run to its budget, as it was configured.

    Args:
        directory: The run folder.
        simulators: Simulated robots side by side, on which nothing in a run depends; as it was
            configured where None.
        display: Show progress while it runs.
        video: Film the final policy, in simulation.

    Returns:
        How the run ended.

    Raises:
        UserError: The folder holds no run, or a damaged one.
    """
    opened = RunDirectory.open(directory)
    config = read_config(opened.config_path)
    if simulators is not None:
        config = change_simulators(config, simulators)
    if video:
        require_film(config.chosen_robot, config.task)
    with open_training_setup(config) as setup:
        return _train(setup, opened, display=display, video=video)


def _train(
    setup: TrainingSetup, directory: RunDirectory, *, display: bool, video: bool
) -> TrainResult:
    with ExitStack() as stack:
        run = _open_run(stack, setup, directory, display=display)
        try:
            run.run()
        except KeyboardInterrupt as error:
            path = shlex.quote(str(directory.path))
            error.add_note(f"continue with: iher-robot train --resume {path}")
            raise
        # An asynchronous run has collected an epoch that is not in the last row.
        spent, granted = run.budget.spent, run.budget.total
    final = _final_evaluation(setup, directory, video=video)
    return _finish(setup, directory, run.rows, spent, granted, final)


def _open_run(
    stack: ExitStack, setup: TrainingSetup, directory: RunDirectory, *, display: bool
) -> TrainingRun:
    """Open the records of a run, and announce what its budget means."""
    provenance = _collect_provenance(setup)
    ledger = stack.enter_context(Ledger(directory.ledger_path))
    directory.result_path.unlink(missing_ok=True)  # with more minutes, a run goes on
    budget = Budget(ledger, setup.budget)
    keep_interface(directory.episodes_path, setup.env.policy_interface())
    if not directory.checkpoint_path.exists():  # later another copy would be another run
        copy_sources(setup.config.from_data, directory.warm_start_path)
    durable = setup.simulator is None  # a robot that a person waits for: each tick is kept
    store = stack.enter_context(EpisodeStore(directory.episodes_path, durable_ticks=durable))
    listener = _open_listeners(
        stack, setup, directory, provenance, budget.total.minutes, display=display
    )
    listener.announce(setup.describe_budget(budget.total, budget.spent))
    return TrainingRun(setup, directory, budget, store, listener, provenance)


def _finish(
    setup: TrainingSetup,
    directory: RunDirectory,
    rows: Sequence[Row],
    spent: RobotTime,
    granted: RobotTime,
    final: EvaluationResult | None,
) -> TrainResult:
    """Write the result of a run and return it."""
    last = rows[-1]
    success = next((row["success"] for row in reversed(rows) if "success" in row), None)
    result = RunResult(
        epochs=int(last["epoch"]),
        robot_minutes=spent.minutes,
        budget_minutes=granted.minutes,
        success=None if success is None else float(success),
        final_successes=None if final is None else final.successes,
        final_episodes=0 if final is None else final.episodes,
        wall_seconds=last["wall_seconds"],
    )
    write_result(directory.result_path, result)
    return TrainResult(
        directory=directory.path,
        policy=directory.policy_path,
        success_rate=math.nan if success is None else success,
        final=final,
        robot_minutes=result.robot_minutes,
        budget_minutes=result.budget_minutes,
        wall_seconds=result.wall_seconds,
        epochs=result.epochs,
        plot=directory.plot_path,
        robot=setup.config.chosen_robot,
        video=None if final is None else final.video,
        ticks=describe_jitter(rows),
    )


def _collect_provenance(setup: TrainingSetup) -> dict[str, Any]:
    now = datetime.datetime.now().astimezone()
    provenance = collect_provenance(sys.argv, setup.config.seed, now)
    if setup.group is not None:
        provenance["processes"] = setup.group.world_size
    return provenance


def _open_listeners(
    stack: ExitStack,
    setup: TrainingSetup,
    directory: RunDirectory,
    provenance: Mapping[str, Any],
    budget_minutes: float,
    *,
    display: bool,
) -> RunListener:
    """Make the listeners of a run; questions to the operator pause them."""
    from iher_robot.training.tensorboard import TensorBoard  # takes 0.5 s to import

    config, robot = setup.config, setup.config.chosen_robot.title
    title = f"{config.task} on {robot}, {config.algo}, {config.preset}"
    plot = SuccessPlot(
        directory.plot_path,
        label=f"{config.algo}, preset {config.preset}",
        title=f"{config.task} on {robot}",
        subtitle=f"seed {config.seed}, commit {provenance['commit'][:10]}",
        budget_minutes=budget_minutes,
    )
    board = stack.enter_context(TensorBoard(directory.tensorboard_path))
    shown = stack.enter_context(TrainingDisplay(budget_minutes, title=title, enabled=display))
    listener = RunListeners([board, plot, shown])
    operator = Operator()
    if operator.present:
        setup.env.ask_human = partial(_ask, operator, listener)
    return listener


def _ask(operator: Operator, listener: RunListener, message: str) -> None:
    with listener.question():
        operator.help(message)


def _final_evaluation(
    setup: TrainingSetup, directory: RunDirectory, *, video: bool
) -> EvaluationResult | None:
    config = setup.config
    episodes = config.evaluation.final_episodes or (FILMED_EPISODES if video else 0)
    if setup.simulator is None or not episodes:
        return None
    trained = load_trained_policy(directory.policy_path)
    if setup.pool is not None and not video:  # frames are rendered one episode after the other
        seeds = [episode_seed(config.seed, Stream.FINAL_EVALUATION, i) for i in range(episodes)]
        warnings = check_fit(trained, setup.env)
        successes = run_evaluation(setup.pool.run(setup.learner, seeds)).successes
        title = config.chosen_robot.title
        return EvaluationResult(trained.task.name, title, successes, episodes, warnings, None)
    return evaluate_on(
        config.chosen_robot,
        trained,
        episodes=episodes,
        seed=config.seed,
        video=directory.film_path if video else None,
    )
