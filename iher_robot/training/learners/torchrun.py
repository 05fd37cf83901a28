"""What ``torchrun`` tells a process; read without torch, which takes seconds to load."""

from __future__ import annotations

import os
from dataclasses import dataclass


@dataclass(frozen=True)
class Place:
    """Which of the processes of ``torchrun`` this one is.

    Attributes:
        rank: Its number, from 0; that one has the robot.
        count: How many there are.
        local_rank: Its number among those on this machine.
    """

    rank: int
    count: int
    local_rank: int


def read_place() -> Place | None:
    """This process's place; None where ``torchrun`` did not start it, or it alone."""
    # The first is what torch.distributed.is_torchelastic_launched asks.
    if "TORCHELASTIC_RUN_ID" not in os.environ or os.environ["WORLD_SIZE"] == "1":
        return None
    return Place(*(int(os.environ[name]) for name in ("RANK", "WORLD_SIZE", "LOCAL_RANK")))
