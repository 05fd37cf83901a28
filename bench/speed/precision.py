"""Precisions of matrix products, for all contenders that use torch."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Precision:
    """How matrix products are computed.

    Attributes:
        name: As on the command line.
        matmul: As in ``torch.set_float32_matmul_precision``; for the whole process.
        products: Type of the factors.
        overrides: Settings of our learner with this precision.
    """

    name: str
    matmul: str
    products: torch.dtype
    overrides: tuple[str, ...]

    @contextmanager
    def on_this_process(self) -> Iterator[None]:
        """Set the precision of torch's float32 products in this process."""
        before = torch.get_float32_matmul_precision()
        torch.set_float32_matmul_precision(self.matmul)
        try:
            yield
        finally:
            torch.set_float32_matmul_precision(before)

    @contextmanager
    def around_others(self, device: torch.device) -> Iterator[None]:
        """Set the precision for code without such a setting, by autocast."""
        autocast = torch.autocast(
            device.type, self.products, enabled=self.products != torch.float32
        )
        with self.on_this_process(), autocast:
            yield


PRECISIONS = {
    each.name: each
    for each in (
        Precision("fp32", "highest", torch.float32, ("learner.matmul_precision=highest",)),
        # May use less: bfloat16 where the CPU has units for it, TF32 on a GPU.
        Precision("medium", "medium", torch.float32, ("learner.matmul_precision=medium",)),
        Precision("bf16", "highest", torch.bfloat16, ("learner.matmul_precision=bfloat16",)),
    )
}
