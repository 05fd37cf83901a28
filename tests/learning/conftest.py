"""One thread: the networks here are too small for more to help."""

from __future__ import annotations

import torch

torch.set_num_threads(1)
