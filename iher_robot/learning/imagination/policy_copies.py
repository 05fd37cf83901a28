"""Earlier policies, which refill the imaginary source (D_pi of Algorithm 1)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any

import torch

from iher_robot.learning.policy import Policy


class PolicyCopies:
    """The newest copies of the policy, each with the cycle after which it was made.

    Args:
        most: Copies to keep.
        device: Where the copies compute.
    """

    def __init__(self, most: int, device: torch.device) -> None:
        self._device = device
        self._copies: deque[tuple[int, dict[str, Any]]] = deque(maxlen=most)

    def add(self, policy: Policy, cycle: int) -> None:
        """Keep a copy of the policy as it is after that cycle."""
        self._copies.append((cycle, policy.snapshot()))

    def older_than(self, cycle: int, matmul_dtype: torch.dtype) -> Iterator[Policy]:
        """Copies from the newest to the oldest, without one made after this cycle.

        Args:
            cycle: Cycles so far; a copy of that cycle equals the current policy.
            matmul_dtype: Type of the policies' matrix products.
        """
        for copied_at, snapshot in reversed(self._copies):
            if copied_at != cycle:
                yield Policy.from_snapshot(snapshot, device=self._device, matmul_dtype=matmul_dtype)

    def state(self) -> list[tuple[int, dict[str, Any]]]:
        """The copies, from the oldest to the newest."""
        return list(self._copies)

    def load_state(self, state: list[tuple[int, dict[str, Any]]]) -> None:
        """Restore what ``state`` returned."""
        self._copies.clear()
        self._copies.extend((cycle, snapshot) for cycle, snapshot in state)
