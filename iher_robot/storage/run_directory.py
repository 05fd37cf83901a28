"""Folder of a training run: paths, settings file and metrics."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from iher_robot.errors import UserError
from iher_robot.storage.files.atomic import read_file, write_atomically
from iher_robot.storage.files.checksum import dump_checked, load_checked

Row = Mapping[str, Any]

_CHECKSUM = b"# sha256: "


class RunDirectory:
    """Paths of a run's existing folder; use ``create`` or ``open``.

    Args:
        path: The run's folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.config_path = path / "config.yaml"
        self.provenance_path = path / "provenance.json"
        self.ledger_path = path / "ledger.sqlite"
        self.episodes_path = path / "episodes"
        self.warm_start_path = path / "warm-start"
        self.checkpoint_path = path / "checkpoint.pt"
        self.metrics_path = path / "metrics.jsonl"
        self.policy_path = path / "policy.pt"
        self.tensorboard_path = path / "tensorboard"
        self.plot_path = path / "success.png"
        self.film_path = path / "final.mp4"
        self.result_path = path / "result.json"

    @classmethod
    def create(cls, path: Path, config_text: str) -> RunDirectory:
        """Create the folder of a new run and write its settings.

        Args:
            path: A folder that does not exist yet, or is empty.
            config_text: Settings from ``dump_config``.

        Raises:
            UserError: The folder is not empty, is a file, or cannot be written.
        """
        try:
            path.mkdir(parents=True, exist_ok=True)
            if any(path.iterdir()):
                raise UserError(
                    f"run folder {path} is not empty; continue its run with --resume {path}, or "
                    "choose another folder with --out"
                )
            # Exclusive: two runs that start at once must not share the folder.
            (path / "config.yaml").touch(exist_ok=False)
        except FileExistsError:
            what = "is taken by another run that just started" if path.is_dir() else "is a file"
            raise UserError(f"run folder {path} {what}; choose another with --out") from None
        except OSError as error:
            raise UserError(
                f"cannot create run folder {path}: {error.strerror or error}; choose another with "
                "--out"
            ) from error
        directory = cls(path)
        text = config_text.encode()
        content = text + _config_checksum(text)
        try:
            write_atomically(directory.config_path, lambda file: file.write(content))
        except BaseException:  # an empty file would be a run that can neither begin nor resume
            directory.config_path.unlink(missing_ok=True)
            raise
        return directory

    @classmethod
    def open(cls, path: Path) -> RunDirectory:
        """Open the folder of an earlier run to resume it.

        Raises:
            UserError: There is no run, its settings have changed, or its ledger is missing.
        """
        directory = cls(path)
        if not path.is_dir():
            raise UserError(f"there is no run folder at {path}")
        needed = [directory.config_path]
        if directory.episodes_path.exists():
            # Without the ledger the budget would be spent again.
            needed.append(directory.ledger_path)
        for file in needed:
            if not file.is_file():
                raise UserError(f"{path} is no run that can be resumed: it has no {file.name}")
        directory.check_config()
        return directory

    def check_config(self) -> None:
        """Check that the settings file has not changed since the run began.

        Raises:
            UserError: It has changed.
        """
        text = read_file(self.config_path, "config file")
        end = text.rfind(_CHECKSUM)
        if end < 0 or text[end:] != _config_checksum(text[:end]):
            raise UserError(
                f"{self.config_path} has changed since the run began; restore it, or start a new "
                "run with another --out"
            )

    def append_metrics(self, row: Row) -> None:
        """Append one line to the metrics; non-finite numbers become null.

        Args:
            row: Metrics of an epoch; scalars of numpy and torch are written as numbers.

        Raises:
            UserError: The system refuses, such as on a full disk.
        """
        line = dump_checked(_plain(row))
        try:
            with self.metrics_path.open("a+b") as file:
                _drop_torn_line(file.fileno())
                file.write(line + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            reason = error.strerror or error
            raise UserError(f"cannot write {self.metrics_path}: {reason}") from error

    def read_metrics(self) -> list[dict[str, Any]]:
        """Read all lines of the metrics, except one that a crash cut off.

        Raises:
            UserError: A line is damaged.
        """
        if not self.metrics_path.exists():
            return []
        *lines, _ = read_file(self.metrics_path, "metrics file").split(b"\n")
        return [
            load_checked(line, f"{self.metrics_path}, line {number},", "metrics")
            for number, line in enumerate(lines, start=1)
        ]

    def replace_metrics(self, rows: Sequence[Row]) -> None:
        """Rewrite all lines of the metrics, to match a checkpoint."""
        text = b"".join(dump_checked(_plain(row)) + b"\n" for row in rows)
        write_atomically(self.metrics_path, lambda file: file.write(text))


def default_run_path(
    task: str,
    algo: str,
    preset: str,
    seed: int,
    root: Path = Path("runs"),
    now: datetime | None = None,
) -> Path:
    """Default folder of a run, such as ``push-iher-default-seed0-20250131-120000``.

    Args:
        task: Name of the task.
        algo: Name of the algorithm.
        preset: Name of the preset, or the path of a file, whose stem is used.
        seed: The run's seed.
        root: Folder of all runs.
        now: Start time; the current time by default.
    """
    moment = (now or datetime.now()).strftime("%Y%m%d-%H%M%S")
    return root / f"{task}-{algo}-{Path(preset).stem}-seed{seed}-{moment}"


def _config_checksum(text: bytes) -> bytes:
    return _CHECKSUM + hashlib.sha256(text).hexdigest().encode() + b"\n"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _drop_torn_line(descriptor: int) -> None:
    """Remove a partial last line that a crash left."""
    size = os.fstat(descriptor).st_size
    content = os.pread(descriptor, size, 0)
    if not content.endswith(b"\n"):
        os.ftruncate(descriptor, content.rfind(b"\n") + 1)
