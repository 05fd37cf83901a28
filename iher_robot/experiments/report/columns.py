"""Columns of an experiment's tables, with their pandas types."""

from __future__ import annotations

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
"""Columns of the table of evaluations."""
VERSIONS = {
    name.replace("-", "_"): name
    for name in ("python", "iher-robot", "torch", "mujoco", "gymnasium-robotics", "numpy")
}
"""Columns of the table of runs with a version, and the package of each."""
RUN_COLUMNS = _IDENTITY | {
    "budget_minutes": "Float64",
    "until_success": "Float64",
    "state": "string",
    "reason": "string",
    "epochs": "Int64",
    "evaluations": "Int64",
    "robot_minutes": "Float64",
    "success": "Float64",
    "final_successes": "Int64",
    "final_episodes": "Int64",
    "wall_seconds": "Float64",
    "command": "string",
    "processes": "Int64",
    "commit": "string",
    "dirty": "boolean",
    "cpu": "string",
    "cores": "string",
    "system": "string",
    **dict.fromkeys(VERSIONS, "string"),
    "rows": "Int64",
}
"""Columns of the table of runs. ``rows`` is the number of its rows and ``evaluations`` that of the
run's evaluations, so that a truncated table is detected."""
