"""Matrix products: their number per unit of work, and the rate of this machine.

A product of (n, k) and (k, m) counts as 2 n k m operations. Only required products are counted: no
unused gradients, no other operations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch

from bench.speed.precision import Precision
from bench.speed.timing import seconds_of


@dataclass(frozen=True)
class Products:
    """Products of one unit of work.

    Attributes:
        operations: Floating-point operations.
        rows: Rows of the left factor of the product whose rate is measured.
        width: Width of its square right factor, the widest layer of the networks.
    """

    operations: float
    rows: int
    width: int


def forward(rows: int, widths: Sequence[int]) -> float:
    """Operations of a network's products for a number of rows."""
    return sum(2.0 * rows * fan_in * fan_out for fan_in, fan_out in pairwise(widths))


def backward(rows: int, widths: Sequence[int]) -> float:
    """Operations of the gradients of a network's weights.

    Each layer takes one product for its weights, and all but the first one for its input.
    """
    return 2.0 * forward(rows, widths) - forward(rows, widths[:2])


def update(batch: int, inputs: int, actions: int, hidden: Sequence[int]) -> float:
    """Operations of an update of DDPG with one critic.

    Args:
        batch: Transitions.
        inputs: Width of the actor's input; the critic's adds the action.
        actions: Width of an action.
        hidden: Widths of the hidden layers of both.
    """
    actor, critic = (inputs, *hidden, actions), (inputs + actions, *hidden, 1)
    targets = forward(batch, actor) + forward(batch, critic)
    critic_step = forward(batch, critic) + backward(batch, critic)
    through_critic = 2.0 * forward(batch, critic)  # there and back, no weight gradients
    return targets + critic_step + forward(batch, actor) + through_critic + backward(batch, actor)


def dynamics_step(batch: int, members: int, widths: Sequence[int]) -> float:
    """Operations of a gradient step of each member of an ensemble."""
    return members * (forward(batch, widths) + backward(batch, widths))


def imagined_transition(
    policy_widths: Sequence[int], members: int, model_widths: Sequence[int]
) -> float:
    """Operations of the policy's action and of all members' predictions.

    The intrinsic reward is their disagreement and takes no further product.
    """
    return forward(1, policy_widths) + members * forward(1, model_widths)


def rate(
    products: Products, precision: Precision, device: torch.device, seconds: float = 0.2
) -> float:
    """Measure the operations per second of products of that shape."""
    with precision.on_this_process():
        generator = torch.Generator(device).manual_seed(0)
        left, right = (
            torch.randn(rows, products.width, generator=generator, device=device).to(
                precision.products
            )
            for rows in (products.rows, products.width)
        )
        out = left @ right

        def multiply(times: int) -> None:
            for _ in range(times):
                torch.mm(left, right, out=out)

        multiply(5)
        once = seconds_of(lambda: multiply(10), device) / 10
        times = max(10, round(seconds / once))
        once = seconds_of(lambda: multiply(times), device) / times
    return 2.0 * products.rows * products.width**2 / once
