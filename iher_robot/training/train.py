"""Train a policy within a budget of robot minutes: the application behind ``iher-robot train``."""

from __future__ import annotations

import datetime
import math
import shlex
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from iher_robot.config.robot import ChosenRobot
from iher_robot.config.run import change_simulators, dump_config, load_config, read_config
from iher_robot.env.operator import Operator
from iher_robot.errors import UserError
from iher_robot.evaluation.compatibility import check_fit, load_actor
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
from iher_robot.storage.run_directory import RunDirectory, default_run_path
from iher_robot.storage.run_result import RunResult, write_result
from iher_robot.training.display import TrainingDisplay
from iher_robot.training.loop import TrainingRun
from iher_robot.training.setup import TrainingSetup, open_training_setup
from iher_robot.training.warm_start import check_sources, copy_sources
from tasks import canonical_name


@dataclass(frozen=True)
class TrainResult:
    """How a run ended.

    Attributes:
        directory: The run folder.
        policy: The policy file.
        success_rate: Success of the last evaluation while training, NaN if there was none.
        final: What the policy did over fresh episodes in the end; None on a physical robot.
        robot_minutes: Robot minutes spent.
        budget_minutes: Robot minutes granted.
        wall_seconds: Wall-clock time, interruptions left out.
        epochs: Epochs done.
        plot: The plot of success against robot minutes.
        robot: The robot of the run.
        video: The film of the final policy, if there is one.
        ticks: How evenly the control ticks came, in words; empty in simulation.
    """

    directory: Path
    policy: Path
    success_rate: float
    final: EvaluationResult | None
    robot_minutes: float
    budget_minutes: float
    wall_seconds: float
    epochs: int
    plot: Path
    robot: ChosenRobot
    video: Path | None
    ticks: str

    def summary(self) -> str:
        """The result in a few lines."""
        epochs = "epoch" if self.epochs == 1 else "epochs"
        wall = datetime.timedelta(seconds=round(self.wall_seconds))
        ticks = f"ticks   {self.ticks}\n" if self.ticks else ""
        film = "" if self.video is None else f"video   {self.video}\n"
        if self.final is None:
            result = f"{self.success_rate:.0%} success in the last evaluation"
        else:
            result = f"success in {self.final.episodes} fresh episodes: {self.final.rate}"
        return (
            f"{result}, after "
            f"{self.robot_minutes:.2f} of {self.budget_minutes:g} robot minutes, "
            f"{self.epochs} {epochs}, {wall} of wall clock\n"
            f"policy  {self.policy}\n"
            f"plot    {self.plot}\n"
            f"{ticks}"
            f"{film}"
            f"check   iher-robot evaluate {shlex.quote(str(self.policy))} --episodes 100"
            f"{self.robot.command_options}"
        )


def train(
    *,
    task: str,
    driver: str | None = None,
    robot: str | None = None,
    connect: Sequence[str] = (),
    preset: str = "default",
    algo: str = "iher",
    budget_minutes: float | None = None,
    overrides: Sequence[str] = (),
    seed: int = 0,
    out: Path | None = None,
    until_success: float | None = 1.0,
    device: str = "auto",
    asynchronous: bool | None = None,
    simulators: int | None = None,
    display: bool = True,
    video: bool = False,
    from_data: Sequence[str | Path] = (),
) -> TrainResult:
    """Learn a task within a budget of robot minutes.

    Args:
        task: Name of the task.
        driver: Name of the robot driver; by default what the robot's file names, or ``mujoco``.
        robot: Name of a robot, or the path of a YAML file; the driver's default where None.
        connect: Where to reach a robot on the network; what its file says where empty.
        preset: Name of a preset, or the path of a YAML file.
        algo: ``iher``, or a model-free baseline.
        budget_minutes: Robot minutes to spend; the preset's where None.
        overrides: Settings to change, ``key=value`` each.
        seed: Decides every random draw.
        out: Run folder to make; by default a new one under ``runs``.
        until_success: Stop when the last two evaluations reach this rate; None never stops.
        device: Where replay, models and policy live: ``auto``, ``cpu`` or ``cuda``.
        asynchronous: Learn in a process of its own while the robot moves; as the preset says,
            usually in turn with it, where None.
        simulators: Simulated robots side by side; as the preset says, usually one, where None.
        display: Show progress while it runs.
        video: Film the final policy, in simulation.
        from_data: Folders of earlier runs of the same task and robot; the learner begins with
            their real episodes, which cost nothing.

    Returns:
        How the run ended.

    Raises:
        UserError: Bad input; nothing has moved.
    """
    task = canonical_name(task)
    options: dict[str, object] = {
        "seed": seed,
        "device": device,
        "until_success": until_success,
    }
    if driver is not None:
        options["driver"] = driver
    if asynchronous is not None:
        options["asynchronous"] = asynchronous
    if simulators is not None:
        options["simulators"] = simulators
    if budget_minutes is not None:
        options["budget_minutes"] = budget_minutes
    sources = [str(Path(folder).resolve()) for folder in from_data]
    twice = [source for source in sources if sources.count(source) > 1]
    if twice:
        raise UserError(f"--from-data names {twice[0]} twice; its episodes are to be learned once")
    config = load_config(task, preset, algo, overrides, options, robot, connect, sources)
    if video:
        require_film(config.chosen_robot, task)
    path = out or default_run_path(task, algo, preset, config.seed)
    # The robot is made first: a bad driver or budget should leave no folder behind.
    with open_training_setup(config) as cell:
        check_sources(config.from_data, cell.env.policy_interface())
        directory = RunDirectory.create(path, dump_config(config))
        return _run(cell, directory, display=display, video=video)


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
    with open_training_setup(config) as cell:
        return _run(cell, opened, display=display, video=video)


def _run(
    cell: TrainingSetup, directory: RunDirectory, *, display: bool, video: bool
) -> TrainResult:
    from torch.utils.tensorboard import SummaryWriter

    config = cell.config
    provenance = collect_provenance(sys.argv, config.seed, datetime.datetime.now().astimezone())
    if cell.group is not None:
        provenance["processes"] = cell.group.world_size
    with ExitStack() as stack:
        ledger = stack.enter_context(Ledger(directory.ledger_path))
        directory.result_path.unlink(missing_ok=True)  # with more minutes, a run goes on
        budget = Budget(ledger, cell.budget_ticks)
        minutes = cell.minutes_of(budget.budget_ticks)
        keep_interface(directory.episodes_path, cell.env.policy_interface())
        if not directory.checkpoint_path.exists():  # later another copy would be another run
            copy_sources(config.from_data, directory.warm_start_path)
        durable = cell.simulator is None  # a robot that somebody waits for: each tick is kept
        store = stack.enter_context(EpisodeStore(directory.episodes_path, durable_ticks=durable))
        writer = stack.enter_context(SummaryWriter(str(directory.tensorboard_path)))
        title = f"{config.task} on {config.chosen_robot.title}, {config.algo}, {config.preset}"
        shown = stack.enter_context(TrainingDisplay(minutes, title=title, enabled=display))
        operator = Operator()
        if operator.present:
            cell.env.ask_human = partial(_ask, operator, shown)
        shown.announce(cell.meaning_of_budget(budget.budget_ticks, budget.spent_ticks))
        try:
            run = TrainingRun(cell, directory, ledger, store, shown, writer, provenance)
            last = run.run()
        except KeyboardInterrupt as error:
            path = shlex.quote(str(directory.path))
            error.add_note(f"continue with: iher-robot train --resume {path}")
            raise
        # Beside the robot an epoch was collected that is not in the last row.
        spent_minutes = cell.minutes_of(budget.spent_ticks)
    final = _final_evaluation(cell, directory, video=video)
    success = next((row["success"] for row in reversed(run.rows) if "success" in row), None)
    write_result(
        directory.result_path,
        RunResult(
            epochs=int(last["epoch"]),
            robot_minutes=spent_minutes,
            budget_minutes=minutes,
            success=None if success is None else float(success),
            final_successes=None if final is None else final.successes,
            final_episodes=0 if final is None else final.episodes,
            wall_seconds=last["wall_seconds"],
        ),
    )
    return TrainResult(
        directory=directory.path,
        policy=directory.policy_path,
        success_rate=math.nan if success is None else success,
        final=final,
        robot_minutes=spent_minutes,
        budget_minutes=minutes,
        wall_seconds=last["wall_seconds"],
        epochs=int(last["epoch"]),
        plot=directory.plot_path,
        robot=config.chosen_robot,
        video=None if final is None else final.video,
        ticks=describe_jitter(run.rows),
    )


def _ask(operator: Operator, shown: TrainingDisplay, message: str) -> None:
    with shown.paused():
        operator.help(message)


def _final_evaluation(
    cell: TrainingSetup, directory: RunDirectory, *, video: bool
) -> EvaluationResult | None:
    config = cell.config
    episodes = config.evaluation.final_episodes or (FILMED_EPISODES if video else 0)
    if cell.simulator is None or not episodes:
        return None
    actor = load_actor(directory.policy_path)
    if cell.pool is not None and not video:  # frames are rendered one episode after the other
        seeds = [episode_seed(config.seed, Stream.FINAL_EVALUATION, i) for i in range(episodes)]
        warnings = check_fit(actor, cell.env)
        successes = run_evaluation(cell.pool.run(cell.learner, seeds)).successes
        title = config.chosen_robot.title
        return EvaluationResult(actor.task.name, title, successes, episodes, warnings, None)
    return evaluate_on(
        config.chosen_robot,
        actor,
        episodes=episodes,
        seed=config.seed,
        video=directory.film_path if video else None,
    )
