"""Input normalisers: a running one for the policy, a refitted one for the dynamics."""

from __future__ import annotations

import torch

BLOCK = 16_384
"""Rows that are converted to float64 at once."""


class RunningNormalizer:
    """Mean and standard deviation of all values so far.

    Sums are kept in float64: in float32, positions of about 1 m that spread over millimetres would
    lose their variance.

    Args:
        dim: Length of the vectors.
        clip: Normalised values are clipped to [-clip, clip].
        std_floor: Smallest standard deviation.
        device: Where the statistics live.
    """

    def __init__(self, dim: int, *, clip: float, std_floor: float, device: torch.device) -> None:
        self.clip = clip
        self.std_floor = std_floor
        self._count = torch.zeros((), dtype=torch.float64, device=device)
        self._sum = torch.zeros(dim, dtype=torch.float64, device=device)
        self._sum_of_squares = torch.zeros(dim, dtype=torch.float64, device=device)
        self.mean = torch.zeros(dim, device=device)
        self.std = torch.ones(dim, device=device)

    def update(self, values: torch.Tensor) -> None:
        """Add a batch. ``(batch, dim)``"""
        wide = values.double()
        self._count += len(values)
        self._sum += wide.sum(0)
        self._sum_of_squares += wide.square().sum(0)
        mean = self._sum / self._count
        variance = self._sum_of_squares / self._count - mean.square()
        self.mean = mean.float()
        self.std = variance.clamp_min(self.std_floor**2).sqrt().float()

    def __call__(self, values: torch.Tensor) -> torch.Tensor:
        """Normalise and clip. ``(..., dim)``"""
        return ((values - self.mean) / self.std).clamp(-self.clip, self.clip)

    def state_dict(self) -> dict[str, torch.Tensor]:
        """All statistics, as tensors."""
        return {
            "count": self._count.clone(),
            "sum": self._sum.clone(),
            "sum_of_squares": self._sum_of_squares.clone(),
            "mean": self.mean.clone(),
            "std": self.std.clone(),
        }

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Restore what ``state_dict`` returned."""
        device = self.mean.device
        # Copies, because ``update`` writes to them.
        self._count = state["count"].to(device, copy=True)
        self._sum = state["sum"].to(device, copy=True)
        self._sum_of_squares = state["sum_of_squares"].to(device, copy=True)
        self.mean = state["mean"].to(device)
        self.std = state["std"].to(device)


class FittedNormalizer:
    """Mean and standard deviation of one data set, frozen until the next fit.

    A cached intrinsic reward stays exact only as long as the models' normalisers do not change.

    Args:
        dim: Length of the vectors.
        std_floor: Smallest standard deviation.
        device: Where the statistics live.
    """

    def __init__(self, dim: int, *, std_floor: float, device: torch.device) -> None:
        self.std_floor = std_floor
        self.mean = torch.zeros(dim, device=device)
        self.std = torch.ones(dim, device=device)

    def fit(self, values: torch.Tensor) -> None:
        """Compute the statistics of these values alone. ``(batch, dim)``"""
        # Block by block: all values in float64 would dominate the learner's peak memory.
        blocks, count = values.split(BLOCK), len(values)
        mean = torch.stack([block.double().sum(0) for block in blocks]).sum(0) / count
        squares = torch.stack([(block.double() - mean).square().sum(0) for block in blocks])
        self.mean = mean.float()
        self.std = (squares.sum(0) / count).sqrt().clamp_min(self.std_floor).float()

    def normalize(self, values: torch.Tensor) -> torch.Tensor:
        """To zero mean and unit spread. ``(..., dim)``"""
        return (values - self.mean) / self.std

    def denormalize(self, values: torch.Tensor) -> torch.Tensor:
        """Back to physical units. ``(..., dim)``"""
        return values * self.std + self.mean

    def state_dict(self) -> dict[str, torch.Tensor]:
        """All statistics, as tensors."""
        return {"mean": self.mean.clone(), "std": self.std.clone()}

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Restore what ``state_dict`` returned."""
        self.mean = state["mean"].to(self.mean.device)
        self.std = state["std"].to(self.std.device)
