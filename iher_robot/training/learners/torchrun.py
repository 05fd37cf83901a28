"""Rank of this process under ``torchrun``; read without torch, which takes seconds to load."""

from __future__ import annotations

import os
from dataclasses import dataclass


@dataclass(frozen=True)
class TorchrunRank:
    """Which of the processes of ``torchrun`` this one is.

    Attributes:
        rank: Its number, from 0; that one has the robot.
        world_size: How many there are.
        local_rank: Its number among those on this machine.
    """

    rank: int
    world_size: int
    local_rank: int


def read_torchrun_rank() -> TorchrunRank | None:
    """This process's rank; None where ``torchrun`` did not start it, or it alone."""
    # The first is what torch.distributed.is_torchelastic_launched asks.
    if "TORCHELASTIC_RUN_ID" not in os.environ or os.environ["WORLD_SIZE"] == "1":
        return None
    return TorchrunRank(*(int(os.environ[name]) for name in ("RANK", "WORLD_SIZE", "LOCAL_RANK")))
