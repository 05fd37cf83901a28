"""Tidy tables of an experiment: a row for each evaluation, and a row for each run."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping
from typing import Any

from iher_robot.chosen_robot import DEFAULT_DRIVER
from iher_robot.config import RunConfig, read_config
from iher_robot.durable_file import read_file, write_atomically
from iher_robot.errors import UserError
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.provenance import read_provenance
from iher_robot.run_directory import RunDirectory
from iher_robot.run_result import read_result

NEEDED = "pip install 'iher-robot[report]'"

_IDENTITY = {
    "cell": "string",
    "task": "string",
    "robot": "string",
    "algo": "string",
    "preset": "string",
    "variant": "string",
    "budget": "Float64",
    "seed": "Int64",
}
EVALUATION_COLUMNS = _IDENTITY | {
    "budget_minutes": "Float64",
    "epoch": "Int64",
    "robot_minutes": "Float64",
    "success": "Float64",
    "evaluation_episodes": "Int64",
    "episodes": "Int64",
    "updates": "Int64",
    "wall_seconds": "Float64",
    "imagined_success": "Float64",
    "model_error_1": "Float64",
    "model_error_10": "Float64",
    "model_error_50": "Float64",
    "still_error_1": "Float64",
    "still_error_10": "Float64",
    "still_error_50": "Float64",
    "intrinsic_real": "Float64",
    "intrinsic_imagined": "Float64",
    "object_moved": "Float64",
}
"""Columns of the table of evaluations, with pandas' types."""
RUN_COLUMNS = _IDENTITY | {
    "budget_minutes": "Float64",
    "until_success": "Float64",
    "state": "string",
    "epochs": "Int64",
    "robot_minutes": "Float64",
    "success": "Float64",
    "final_successes": "Int64",
    "final_episodes": "Int64",
    "wall_seconds": "Float64",
    "command": "string",
    "commit": "string",
    "dirty": "boolean",
    "cpu": "string",
    "cores": "Int64",
    "system": "string",
    "python": "string",
    "torch": "string",
    "mujoco": "string",
    "numpy": "string",
}
"""Columns of the table of runs."""


def require_pandas() -> Any:
    """Import pandas.

    Raises:
        UserError: It is not installed.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise UserError(f"tables need pandas (the extra 'report'): {NEEDED}") from error
    return pd


def write_tables(folder: ExperimentFolder) -> None:
    """Gather what the runs of an experiment measured, as CSV and Parquet.

    Raises:
        UserError: A run is damaged, or the extra ``report`` is missing.
    """
    pd = require_pandas()
    evaluations: list[dict[str, Any]] = []
    runs: list[dict[str, Any]] = []
    for identity in folder.identities():
        directory = folder.run(identity.name)
        shared: dict[str, Any] = {"cell": identity.name, **identity.as_row()}
        if not directory.config_path.exists() or not directory.config_path.read_bytes():
            runs.append(shared | {"state": "not begun"})
            continue
        config = read_config(directory.config_path)
        shared["budget_minutes"] = config.budget_minutes
        rows = directory.read_metrics()
        evaluations += _evaluations(shared, config, rows)
        runs.append(shared | _run(directory, config, rows))
    for path, rows, columns in (
        (folder.evaluations_path, evaluations, EVALUATION_COLUMNS),
        (folder.runs_path, runs, RUN_COLUMNS),
    ):
        frame = pd.DataFrame(rows, columns=list(columns)).astype(columns)
        text = frame.to_csv(index=False, lineterminator="\n").encode()
        write_atomically(path, lambda file, text=text: file.write(text))  # type: ignore[misc]
        content = io.BytesIO()
        frame.to_parquet(content, index=False)
        data = content.getvalue()
        parquet = path.with_suffix(".parquet")
        write_atomically(parquet, lambda file, data=data: file.write(data))  # type: ignore[misc]


def read_table(folder: ExperimentFolder, *, runs: bool) -> Any:
    """Read a table back, from its CSV file.

    Args:
        folder: The experiment.
        runs: The table of runs, or that of evaluations.

    Returns:
        A pandas DataFrame with the columns above.

    Raises:
        UserError: It is missing or damaged.
    """
    pd = require_pandas()
    path = folder.runs_path if runs else folder.evaluations_path
    columns = RUN_COLUMNS if runs else EVALUATION_COLUMNS
    text = read_file(path, "table of an experiment")
    try:
        frame = pd.read_csv(io.BytesIO(text), dtype=columns)
        frame = frame[list(columns)]
    except (ValueError, KeyError) as error:
        raise UserError(f"{path} is no table of an experiment: {error}") from error
    names = [name for name, kind in columns.items() if kind == "string"]
    return frame.assign(**{name: frame[name].fillna("") for name in names})


def _evaluations(
    shared: Mapping[str, Any], config: RunConfig, rows: list[dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    simulated = config.driver == DEFAULT_DRIVER
    settings = config.evaluation
    count = settings.episodes if simulated else settings.robot_episodes
    for row in rows:
        if row.get("success") is not None:
            measured = {name: row.get(name) for name in EVALUATION_COLUMNS if name in row}
            yield {**measured, **shared, "evaluation_episodes": count}


def _run(directory: RunDirectory, config: RunConfig, rows: list[dict[str, Any]]) -> dict[str, Any]:
    result = read_result(directory.result_path)
    last = rows[-1] if rows else {}
    success = [row["success"] for row in rows if row.get("success") is not None]
    found: dict[str, Any] = {
        "until_success": config.until_success,
        "state": "interrupted" if result is None else "finished",
        "epochs": last.get("epoch", 0),
        "robot_minutes": last.get("robot_minutes", 0.0),
        "success": success[-1] if success else math.nan,
        "wall_seconds": last.get("wall_seconds", 0.0),
    }
    if result is not None and result.final_episodes:
        found["final_successes"] = result.final_successes
        found["final_episodes"] = result.final_episodes
    if directory.provenance_path.exists():
        found |= _origin(read_provenance(directory.provenance_path))
    return found


def _origin(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Where a run began; where it went on may differ."""
    machine, versions = provenance.get("machine", {}), provenance.get("versions", {})
    command = list(provenance.get("command", ()))
    return {
        "command": " ".join(["iher-robot", *command[1:]]),
        "commit": provenance.get("commit"),
        "dirty": provenance.get("dirty"),
        "cpu": machine.get("cpu"),
        "cores": machine.get("cores"),
        "system": machine.get("system"),
        **{name: versions.get(name) for name in ("python", "torch", "mujoco", "numpy")},
    }
