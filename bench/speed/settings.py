"""What one run of the measurements is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import torch

from bench.speed.precision import Precision

Size = TypeVar("Size")


@dataclass(frozen=True)
class Settings:
    """Of one run.

    Attributes:
        rounds: In each of them each contender is measured once.
        threads: Of torch, and of JAX.
        device: Where learners compute.
        precisions: Those that are measured.
        quick: Everything small: shows that it runs, and no speed.
    """

    rounds: int
    threads: int
    device: torch.device
    precisions: tuple[Precision, ...]
    quick: bool

    def sized(self, full: Size, quick: Size) -> Size:
        """A size, by whether the run is quick."""
        return quick if self.quick else full
