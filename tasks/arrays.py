"""Arrays of numpy and tensors of torch, which the goal models take alike."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import torch  # the tasks work without it: only annotations name it

FloatArray = NDArray[np.floating]

ArrayT = TypeVar("ArrayT", NDArray[np.floating], "torch.Tensor")
"""Either kind, the same throughout one call."""


def copied(array: ArrayT) -> ArrayT:
    """Return a new array of the same kind and values."""
    if isinstance(array, np.ndarray):
        return array.copy()
    return array.clone()


def square_root(array: ArrayT) -> ArrayT:
    """Return the square root, correctly rounded: ``** 0.5`` can differ in the last bit."""
    if isinstance(array, np.ndarray | np.floating):  # a sum over the only axis is no array
        return np.asarray(np.sqrt(array))
    return array.sqrt()
