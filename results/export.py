"""Export the small part of runs to commit: curves, a plot, provenance.

python results/export.py runs/RUN... --name NAME [--official 100]

makes results/NAME/seedN.json for each run, and success.png of all of them. With --official, the
final policies run that many episodes in gymnasium-robotics' own environment first.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import torch
import yaml

from iher_robot.evaluation.evaluate import evaluate
from iher_robot.evaluation.plot import plot_success
from iher_robot.storage.provenance import read_provenance
from iher_robot.storage.run_directory import RunDirectory


def read_run(path: Path) -> dict[str, Any]:
    """Provenance, settings and metrics of a run."""
    run = RunDirectory.open(path)
    rows = run.read_metrics()
    provenance = read_provenance(run.provenance_path)
    config = yaml.safe_load(run.config_path.read_text())
    config["from_data"] = [Path(folder).name for folder in config["from_data"]]
    return provenance | {
        "command": " ".join(["iher-robot", *provenance["command"][1:]]),
        "wall_seconds": rows[-1]["wall_seconds"],
        "config": config,
        "epochs": rows,
    }


def main() -> None:
    """Export runs that differ by their seeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--name", required=True)
    parser.add_argument("--official", type=int, default=0, metavar="EPISODES")
    options = parser.parse_args()
    torch.set_num_threads(1)
    documents = [(path, read_run(path)) for path in options.runs]
    config = documents[0][1]["config"]
    if len({document["config"]["seed"] for _, document in documents}) < len(documents):
        parser.error("two runs have the same seed")
    if any(document["config"] | {"seed": 0} != config | {"seed": 0} for _, document in documents):
        parser.error("the runs differ by more than their seeds")
    target = Path(__file__).parent / options.name
    target.mkdir(parents=True, exist_ok=True)
    curves = {}
    for path, document in documents:
        if options.official:
            policy = RunDirectory.open(path).policy_path
            result = evaluate(policy, episodes=options.official, official=True)
            document["official"] = {
                "environment": result.environment,
                "episodes": result.episodes,
                "successes": result.successes,
                "warnings": list(result.warnings),
            }
            print(result.summary())
        seed = document["config"]["seed"]
        (target / f"seed{seed}.json").write_text(json.dumps(document, indent=1) + "\n")
        curves[f"seed {seed}"] = document["epochs"]
    plot_success(
        curves,
        target / "success.png",
        title=f"{config['task']} on {config.get('robot') or config['driver']}",
        subtitle=f"{config['algo']}, preset {config['preset']}, {options.name}",
        budget_minutes=config["budget_minutes"],
    )


if __name__ == "__main__":
    main()
