"""Section ``search`` of a manifest: the search space, the objective and the number of trials."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import Field

from iher_robot.config.layers import Layer
from iher_robot.config.section import Section, parse_section
from iher_robot.errors import UserError

Objective = Literal["minutes-to-success", "success-at-budget"]


class Parameter(Section):
    """Values of a setting: a range, or choices."""

    low: float | None = None
    """Smallest value."""
    high: float | None = None
    """Largest value."""
    log: bool = False
    """Draw on a logarithmic scale."""
    integer: bool = False
    """Draw integers."""
    choices: tuple[Any, ...] = ()
    """Values to choose from, instead of a range."""

    @property
    def ends(self) -> tuple[Any, ...]:
        """Both ends of the range, or every choice."""
        if self.choices:
            return self.choices
        assert self.low is not None and self.high is not None  # noqa: PT018
        return (int(self.low), int(self.high)) if self.integer else (self.low, self.high)


class _Head(Section):
    parameters: dict[str, Any] = Field(min_length=1)
    """Ranges or choices by dotted key, such as ``learner.ddpg.gamma: {low: 0.9, high: 0.99}``."""
    objective: Objective
    """Fewest robot minutes to a success rate, or the highest success rate at the budget."""
    success: float = Field(default=0.9, gt=0, le=1)
    """Success rate of ``minutes-to-success``."""
    trials: int = Field(ge=1)
    """Number of trials; each runs every cell of the grid."""
    seed: int = Field(default=0, ge=0, lt=2**32)
    """Seed of the sampler."""


@dataclass(frozen=True)
class Search:
    """A search for settings.

    Attributes:
        parameters: Ranges or choices by dotted key.
        objective: Objective.
        success: Success rate of ``minutes-to-success``.
        trials: Number of trials.
        seed: Seed of the sampler.
    """

    parameters: dict[str, Parameter]
    objective: Objective
    success: float
    trials: int
    seed: int

    def ends(self) -> Iterator[dict[str, Any]]:
        """Settings with each end of a range and each choice, the other parameters at their first.

        Settings can depend on each other: leaving the others out would refuse valid ones.
        """
        first = {key: parameter.ends[0] for key, parameter in self.parameters.items()}
        for key, parameter in self.parameters.items():
            for value in parameter.ends:
                yield first | {key: value}


def parse_search(layer: Layer) -> Search:
    """Check the section.

    Raises:
        UserError: Something in it is not allowed.
    """
    head = parse_section(_Head, layer.values, layer.origin)
    parameters = {
        key: _checked(parse_section(Parameter, values, f"{layer.origin}, {key}"), layer, key)
        for key, values in head.parameters.items()
    }
    return Search(parameters, head.objective, head.success, head.trials, head.seed)


def _checked(parameter: Parameter, layer: Layer, key: str) -> Parameter:
    origin = f"{layer.origin}, {key}"
    low, high = parameter.low, parameter.high
    if parameter.choices:
        if low is not None or high is not None or parameter.log or parameter.integer:
            raise UserError(f"{origin}: choices exclude low, high, log and integer; leave them out")
        if not all(isinstance(c, str | int | float | bool) or c is None for c in parameter.choices):
            raise UserError(f"{origin}: choices are text, numbers, true, false or null")
        return parameter
    if low is None or high is None:
        raise UserError(f"{origin}: give low and high, or choices")
    if not low < high:
        raise UserError(f"{origin}: low is {low:g}, allowed: low < high, which is {high:g}")
    if parameter.log and low <= 0:
        raise UserError(f"{origin}: low is {low:g}, allowed with log: 0 < low")
    if parameter.integer and not (low.is_integer() and high.is_integer()):
        raise UserError(f"{origin}: low is {low:g} and high {high:g}, allowed: whole numbers")
    return parameter
