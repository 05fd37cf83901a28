"""In which precision matrices are multiplied."""

from __future__ import annotations

import torch

from iher_robot.learning.config import Precision


def products_of(precision: Precision, device: torch.device) -> torch.dtype:
    """Type of the products between hidden layers.

    Args:
        precision: As in ``LearnerConfig.matmul_precision``.
        device: Where they are computed.
    """
    if precision == "bfloat16" or (precision == "auto" and multiplies_bfloat16(device)):
        return torch.bfloat16
    return torch.float32


def set_float32_products(precision: Precision, device: torch.device) -> None:
    """Set how this process multiplies what stays float32.

    Args:
        precision: As in ``LearnerConfig.matmul_precision``.
        device: Where the learner computes.
    """
    if products_of(precision, device) == torch.bfloat16:
        torch.set_float32_matmul_precision("highest")  # the first and the last layer stay exact
    else:
        torch.set_float32_matmul_precision("medium" if precision == "auto" else precision)


def multiplies_bfloat16(device: torch.device) -> bool:
    """Whether the hardware has instructions for it, and so does it faster than float32."""
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    has = torch.cpu.get_capabilities()
    return bool(has.get("avx512_bf16") or has.get("amx_bf16"))
