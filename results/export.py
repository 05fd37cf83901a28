"""Keep the small part of a run that is worth committing: its curve, its plot and where it is from.

python results/export.py runs/RUN NAME     makes results/NAME/curve.json and success.png
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import yaml

from iher_robot.plot import plot_success
from iher_robot.run_directory import RunDirectory


def main() -> None:
    """Export one run."""
    run = RunDirectory.open(Path(sys.argv[1]))
    target = Path(__file__).parent / sys.argv[2]
    target.mkdir(exist_ok=True)
    rows = run.read_metrics()
    config = yaml.safe_load(run.config_path.read_text())
    provenance = json.loads(run.provenance_path.read_text())
    command = " ".join(["iher-robot", *provenance["command"][1:]])
    document = provenance | {
        "command": command,
        "wall_seconds": rows[-1]["wall_seconds"],
        "config": config,
        "epochs": rows,
    }
    (target / "curve.json").write_text(json.dumps(document, indent=1) + "\n")
    plot_success(
        {f"{config['algo']}, preset {config['preset']}": rows},
        target / "success.png",
        title=f"{config['task']} on {config['driver']}",
        subtitle=f"seed {config['seed']}, commit {provenance['commit'][:10]}",
        budget_minutes=config["budget_minutes"],
    )


if __name__ == "__main__":
    main()
