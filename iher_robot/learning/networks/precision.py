"""Precision of matrix products."""

from __future__ import annotations

import torch

from iher_robot.learning.config import Precision


def pick_matmul_dtype(precision: Precision, device: torch.device) -> torch.dtype:
    """Type of the matrix products between hidden layers.

    Args:
        precision: As in ``LearnerConfig.matmul_precision``.
        device: Where the networks compute.
    """
    if precision == "bfloat16" or (precision == "auto" and has_bfloat16(device)):
        return torch.bfloat16
    return torch.float32


def set_float32_precision(precision: Precision, device: torch.device) -> None:
    """Set the precision of this process's float32 matrix products.

    Args:
        precision: As in ``LearnerConfig.matmul_precision``.
        device: Where the learner computes.
    """
    if pick_matmul_dtype(precision, device) == torch.bfloat16:
        torch.set_float32_matmul_precision("highest")  # the first and the last layer stay exact
    else:
        torch.set_float32_matmul_precision("medium" if precision == "auto" else precision)


def has_bfloat16(device: torch.device) -> bool:
    """Whether the hardware has bfloat16 instructions, which are faster than float32 ones."""
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    has = torch.cpu.get_capabilities()
    return bool(has.get("avx512_bf16") or has.get("amx_bf16"))
