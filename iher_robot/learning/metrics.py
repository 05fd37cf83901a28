"""Averages of an epoch's metrics."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

import torch


class Meter:
    """Running means by name; tensors are summed on their device, so that a GPU need not wait."""

    def __init__(self) -> None:
        self._sums: dict[str, torch.Tensor | float] = defaultdict(float)
        self._counts: dict[str, int] = defaultdict(int)

    def add(self, values: Mapping[str, torch.Tensor | float]) -> None:
        """Add values.

        Args:
            values: By name: a scalar, or one value a step. ``(steps,)``
        """
        for name, value in values.items():
            if isinstance(value, torch.Tensor) and value.dim() > 0:
                self._sums[name] = self._sums[name] + value.sum()
                self._counts[name] += len(value)
            else:
                self._sums[name] = self._sums[name] + value
                self._counts[name] += 1

    def means(self) -> dict[str, float]:
        """Mean of each name."""
        return {name: float(total) / self._counts[name] for name, total in self._sums.items()}
