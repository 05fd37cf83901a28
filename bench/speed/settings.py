"""Settings of a benchmark run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import torch

from bench.speed.precision import Precision

Size = TypeVar("Size")


@dataclass(frozen=True)
class Settings:
    """Settings of a benchmark run.

    Attributes:
        rounds: Number of rounds; each measures each contender once.
        threads: Threads of torch and of JAX.
        device: Device of the learners.
        precisions: Precisions to measure.
        quick: Small sizes, which check that it runs; speeds are not valid.
    """

    rounds: int
    threads: int
    device: torch.device
    precisions: tuple[Precision, ...]
    quick: bool

    def sized(self, full: Size, quick: Size) -> Size:
        """The full or the quick size."""
        return quick if self.quick else full
