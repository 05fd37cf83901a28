"""Result file of a run, written when it ends."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from iher_robot.errors import UserError
from iher_robot.storage.files.atomic import read_file, write_atomically
from iher_robot.storage.files.checksum import add_checksum, load_checked


@dataclass(frozen=True)
class RunResult:
    """Result of a run.

    Attributes:
        epochs: Epochs done.
        robot_minutes: Robot minutes spent.
        budget_minutes: Robot minutes granted.
        success: Success rate of the last evaluation during training; None without one.
        final_successes: Successes of the final policy in fresh episodes; None without any.
        final_episodes: Number of these episodes; 0 where there is no simulator.
        wall_seconds: Wall-clock time of the training, without interruptions.
    """

    epochs: int
    robot_minutes: float
    budget_minutes: float
    success: float | None
    final_successes: int | None
    final_episodes: int
    wall_seconds: float


def write_result(path: Path, result: RunResult) -> None:
    """Write the result atomically.

    Raises:
        UserError: The system refuses, such as on a full disk.
    """
    text = json.dumps(add_checksum(asdict(result)), indent=2, allow_nan=False) + "\n"
    write_atomically(path, lambda file: file.write(text.encode()))


def read_result(path: Path) -> RunResult | None:
    """Read the result; None if the run has not ended.

    Raises:
        UserError: The file is damaged.
    """
    if not path.exists():
        return None
    content = load_checked(read_file(path, "result file"), path, "result file")
    try:
        return RunResult(**content)
    except TypeError:
        raise UserError(f"{path} is from another version of iher-robot") from None
