"""Properties of the machine that affect speed."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch

FLAGS = ("avx2", "avx512f", "avx512_bf16", "avx512_fp16", "amx_tile", "amx_bf16")
PACKAGES = ("gymnasium", "stable_baselines3", "sbx-rl", "jax")


def cpu_flags() -> list[str]:
    """The CPU's instruction sets for matrix products; empty where they are not known."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return []
    found = next((line.split() for line in lines if line.startswith("flags")), [])
    return [flag for flag in FLAGS if flag in found]


def has_matrix_units(device: torch.device) -> bool:
    """Whether the device has matrix units for bfloat16."""
    return device.type == "cuda" or "amx_bf16" in cpu_flags()


def versions_of_rivals() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def with_this_machine(provenance: dict[str, Any]) -> dict[str, Any]:
    """Add the properties that affect speed to a provenance."""
    machine = provenance["machine"] | {"cpu_flags": cpu_flags()}
    versions = provenance["versions"] | versions_of_rivals()
    return provenance | {"machine": machine, "versions": versions}
