"""Result of a training run."""

from __future__ import annotations

import datetime
import shlex
from dataclasses import dataclass
from pathlib import Path

from iher_robot.config.robot import ChosenRobot
from iher_robot.evaluation.evaluate import EvaluationResult


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
        ticks: Timing of the control ticks, as a sentence; empty in simulation.
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
