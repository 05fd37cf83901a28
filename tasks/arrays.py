"""Functions and types for numpy arrays and torch tensors alike."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import torch  # for annotations only: the tasks work without torch

FloatArray = NDArray[np.floating]

ArrayT = TypeVar("ArrayT", NDArray[np.floating], "torch.Tensor")
"""An array or a tensor; one call takes and returns only one of them."""


def copied(array: ArrayT) -> ArrayT:
    """Return a copy."""
    if isinstance(array, np.ndarray):
        return array.copy()
    return array.clone()


def square_root(array: ArrayT) -> ArrayT:
    """Return the square root, correctly rounded: ``** 0.5`` can differ in the last bit."""
    if isinstance(array, np.ndarray | np.floating):  # a sum over the only axis is a scalar
        return np.asarray(np.sqrt(array))
    return array.sqrt()
