"""Print results as rows of a Markdown table: robot minutes to 50 % and 90 %, the end, wall clock.

python results/table.py results/NAME...

Minutes are those of the first evaluation that reached the rate, for each seed in order; a seed that
never did sorts last in the median.
"""

from __future__ import annotations

import json
import math
import statistics
import sys
from pathlib import Path
from typing import Any

from iher_robot.evaluation.plot import success_points


def minutes_to(rate: float, run: dict[str, Any]) -> float:
    """Robot minutes of the first evaluation at a success rate; infinite without one."""
    points = success_points(run["epochs"])
    return next((minutes for minutes, success in points if success >= rate), math.inf)


def shown(minutes: float) -> str:
    """Robot minutes as text, with one or two decimals."""
    return "never" if math.isinf(minutes) else f"{minutes:.{1 if minutes >= 1.0 else 2}f}"


def cell(values: list[float]) -> str:
    """Median, and the value of each seed."""
    return f"**{shown(statistics.median(values))}** ({', '.join(map(shown, values))})"


def main() -> None:
    """Print a row for each folder of results."""
    print("| results | seeds | min to 50 % | min to 90 % | at the end, % | robot min | wall, min |")
    print("|---|---|---|---|---|---|---|")
    for argument in sys.argv[1:]:
        folder = Path(argument)
        runs = [json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))]
        if not runs:
            sys.exit(f"{folder} holds no results, expected one JSON file for each run")
        ends = [success_points(run["epochs"])[-1] for run in runs]
        wall = statistics.median(run["wall_seconds"] for run in runs) / 60.0
        print(
            f"| [{folder.name}]({folder.name}) | {len(runs)} "
            f"| {cell([minutes_to(0.5, run) for run in runs])} "
            f"| {cell([minutes_to(0.9, run) for run in runs])} "
            f"| {', '.join(f'{rate:.0%}'.rstrip('%') for _, rate in ends)} "
            f"| {statistics.median(minutes for minutes, _ in ends):.1f} | {wall:.0f} |"
        )


if __name__ == "__main__":
    main()
