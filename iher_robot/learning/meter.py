"""Averages of what an epoch's steps report."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

import torch


class Meter:
    """Running means by name; tensors are summed on their device, so that a GPU need not wait."""

    def __init__(self) -> None:
        self._sums: dict[str, torch.Tensor | float] = defaultdict(float)
        self._counts: dict[str, int] = defaultdict(int)

    def add(self, values: Mapping[str, torch.Tensor | float], weight: int = 1) -> None:
        """Take in one step's values, or means over several.

        Args:
            values: By name.
            weight: Steps that they stand for.
        """
        for name, value in values.items():
            self._sums[name] = self._sums[name] + weight * value
            self._counts[name] += weight

    def means(self) -> dict[str, float]:
        """Mean of each name."""
        return {name: float(total) / self._counts[name] for name, total in self._sums.items()}
