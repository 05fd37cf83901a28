"""Device and global torch settings of a process."""

from __future__ import annotations

import torch

from iher_robot.config.run import RunConfig
from iher_robot.errors import UserError
from iher_robot.learning.networks.precision import set_float32_precision


def prepare_torch(config: RunConfig) -> None:
    """Apply the settings that torch holds for the whole process."""
    torch.set_num_threads(config.threads)
    set_float32_precision(config.learner.matmul_precision, pick_device(config.device))


def pick_device(name: str) -> torch.device:
    """Choose the device; ``auto`` takes the GPU if there is one.

    Args:
        name: ``auto``, ``cpu`` or ``cuda``.

    Raises:
        UserError: ``cuda`` was requested, but there is no GPU.
    """
    available = torch.cuda.is_available()
    if name == "cuda" and not available:
        raise UserError("device is 'cuda', but torch finds no GPU here; use auto or cpu")
    return torch.device("cuda" if available and name != "cpu" else "cpu")
