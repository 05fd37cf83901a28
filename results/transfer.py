"""Evaluate policies on robots that they were not trained on, and save the rates.

python results/transfer.py POLICY... --robots fetch fetch-mocap --episodes 100 --out results/transfer/NAME.json
"""

from __future__ import annotations

import argparse
import json
import sys
from datetime import datetime
from pathlib import Path

import torch

from iher_robot.evaluation.evaluate import evaluate
from iher_robot.evaluation.policy_file import load_policy
from iher_robot.storage.provenance import collect_provenance


def main() -> None:
    """Evaluate every policy on every robot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("policies", nargs="+", type=Path)
    parser.add_argument("--robots", nargs="+", default=["fetch", "fetch-mocap"])
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for path in options.policies:
        trained = load_policy(path)
        for robot in options.robots:
            result = evaluate(path, episodes=options.episodes, robot=robot, accept_interface=True)
            rows.append(
                {
                    "policy": path.parent.name,
                    "task": trained.task,
                    "trained": trained.trained,
                    "evaluated_on": robot,
                    "successes": result.successes,
                    "episodes": result.episodes,
                }
            )
            print(path.parent.name, "on", robot, f"{result.successes}/{result.episodes}")
    document = collect_provenance(sys.argv, 0, datetime.now().astimezone()) | {"rates": rows}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
