"""Coverage of a report's 95 % bootstrap intervals, by the number of seeds.

    python bench/bootstrap_coverage.py --out bench/results/bootstrap-coverage.json

Scores are drawn from a normal distribution, whose interquartile mean is its mean. Prints the
share of experiments whose interval contains it.
"""

from __future__ import annotations

import argparse
import json
import sys
from datetime import datetime
from pathlib import Path

import numpy as np
import scipy

from iher_robot.experiments.report.statistics import CONFIDENCE, REPETITIONS, estimate
from iher_robot.storage.provenance import collect_provenance

EXPERIMENTS = 2_000
SEEDS = (2, 3, 5, 10, 20)


def coverage(seeds: int, rng: np.random.Generator) -> float:
    """Share of experiments whose interval contains the true value, for a number of seeds."""
    held = 0
    for scores in rng.normal(size=(EXPERIMENTS, seeds)):
        found = estimate(scores.tolist(), kind="iqm")
        held += found.low <= 0.0 <= found.high
    return held / EXPERIMENTS


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    found = {str(seeds): round(coverage(seeds, rng), 3) for seeds in SEEDS}
    for seeds, share in found.items():
        print(f"{seeds:>3} seeds  {share:.1%}")
    if options.out is not None:
        document = collect_provenance(sys.argv, 0, datetime.now().astimezone()) | {
            "scipy": scipy.__version__,
            "experiments": EXPERIMENTS,
            "draws": REPETITIONS,
            "confidence": CONFIDENCE,
            "coverage": found,
        }
        options.out.write_text(json.dumps(document, indent=2) + "\n")


if __name__ == "__main__":
    main()
