"""What a run came to: the file that it writes last."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from iher_robot.errors import UserError
from iher_robot.storage.files.atomic import read_file, write_atomically
from iher_robot.storage.files.checksum import add_checksum, load_checked


@dataclass(frozen=True)
class RunResult:
    """What a run came to.

    Attributes:
        epochs: Epochs done.
        robot_minutes: Robot minutes spent.
        budget_minutes: Robot minutes granted.
        success: Success rate of the last evaluation while training; None if there was none.
        final_successes: Fresh episodes of the final policy that succeeded; None without any.
        final_episodes: How many there were; 0 on a robot that is the only one.
        wall_seconds: Wall-clock time of the training, interruptions left out.
    """

    epochs: int
    robot_minutes: float
    budget_minutes: float
    success: float | None
    final_successes: int | None
    final_episodes: int
    wall_seconds: float


def write_result(path: Path, result: RunResult) -> None:
    """Write it, whole or not at all.

    Raises:
        UserError: The system refuses, such as on a full disk.
    """
    text = json.dumps(add_checksum(asdict(result)), indent=2, allow_nan=False) + "\n"
    write_atomically(path, lambda file: file.write(text.encode()))


def read_result(path: Path) -> RunResult | None:
    """Read it; None if the run has not ended.

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
