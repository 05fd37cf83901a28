"""How often a report's 95 % intervals hold the true value, by the number of seeds.

    python bench/bootstrap_coverage.py

Scores are drawn from a normal distribution, whose interquartile mean is its mean. Prints the
share of experiments whose interval holds it, and writes it to
``bench/results/bootstrap-coverage.json``.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import scipy

from iher_robot.experiments.numbers import CONFIDENCE, REPETITIONS, estimate

EXPERIMENTS = 2_000
SEEDS = (2, 3, 5, 10, 20)
OUT = Path(__file__).parent / "results" / "bootstrap-coverage.json"


def coverage(seeds: int, rng: np.random.Generator) -> float:
    """Share of experiments with so many seeds whose interval holds the true value."""
    held = 0
    for scores in rng.normal(size=(EXPERIMENTS, seeds)):
        found = estimate(scores.tolist(), kind="iqm")
        held += found.low <= 0.0 <= found.high
    return held / EXPERIMENTS


def main() -> None:
    """Measure, print and write down."""
    rng = np.random.default_rng(0)
    found = {str(seeds): round(coverage(seeds, rng), 3) for seeds in SEEDS}
    for seeds, share in found.items():
        print(f"{seeds:>3} seeds  {share:.1%}")
    content = {
        "command": "python bench/bootstrap_coverage.py",
        "scipy": scipy.__version__,
        "numpy": np.__version__,
        "seed": 0,
        "experiments": EXPERIMENTS,
        "draws": REPETITIONS,
        "confidence": CONFIDENCE,
        "coverage": found,
    }
    OUT.write_text(json.dumps(content, indent=2) + "\n")


if __name__ == "__main__":
    main()
