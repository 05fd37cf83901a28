"""Cells of an experiment, one training run each: their identities, settings and expansion."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from iher_robot.config.options import load_config
from iher_robot.config.robot import DEFAULT_DRIVER
from iher_robot.config.run import RunConfig, plain_identity
from iher_robot.errors import UserError
from iher_robot.experiments.manifest import Grid, Manifest
from tasks import TaskError

_ABSENT = object()


@dataclass(frozen=True)
class Identity:
    """What distinguishes a cell from the others.

    Attributes:
        task: Name of the task.
        robot: Driver and robot, as text.
        algo: Name of the algorithm.
        preset: Name of the preset; for a file, its stem.
        variant: Name of the variant, or empty.
        budget: Robot minutes where the grid has several budgets, else None.
        seed: Seed of the run.
    """

    task: str
    robot: str
    algo: str
    preset: str
    variant: str
    budget: float | None
    seed: int

    @property
    def name(self) -> str:
        """Name of the cell's folder."""
        budget = None if self.budget is None else f"{self.budget:g}min"
        parts = (self.task, self.algo, self.preset, self.variant, budget, f"seed{self.seed}")
        return "-".join(part for part in parts if part)

    @property
    def method(self) -> Identity:
        """The identity without the seed: equal for all seeds of a method."""
        return replace(self, seed=0)

    def as_row(self) -> dict[str, Any]:
        """Its attributes by name, as columns of a table."""
        return asdict(self)


@dataclass(frozen=True)
class Cell:
    """A training run of an experiment.

    Attributes:
        identity: What distinguishes it from the others.
        config: Its settings, resolved.
    """

    identity: Identity
    config: RunConfig

    @property
    def name(self) -> str:
        """Name of the cell's folder."""
        return self.identity.name

    @property
    def simulated(self) -> bool:
        """Whether it has its own simulated robot, which no other cell can move."""
        return self.config.driver == DEFAULT_DRIVER


@dataclass(frozen=True)
class _Choice:
    grid: Grid
    task: str
    algo: str
    preset: str
    variant: str
    budget: float | None
    seed: int
    settings: Mapping[str, Any] = field(default_factory=dict)


def expand(manifest: Manifest) -> tuple[Cell, ...]:
    """Expand a manifest into its cells; nothing is written.

    Raises:
        UserError: The settings of a cell, or an end of a search's range, are not allowed; two
            cells have the same name; or two cells would count as seeds of one method although
            other settings differ too.
    """
    cells: dict[str, Cell] = {}
    methods: dict[Identity, Cell] = {}
    for grid in manifest.grids:
        for cell in expand_grid(grid, manifest.origin):
            if cell.name in cells:
                raise UserError(
                    f"{manifest.origin}: two cells are called {cell.name}; give one of them a "
                    "variant with another name"
                )
            cells[cell.name] = cell
            _require_one_method(methods.setdefault(cell.identity.method, cell), cell, manifest)
    if manifest.search is not None:
        for settings in manifest.search.ends():
            for grid in manifest.grids:
                for _ in expand_grid(grid, f"{manifest.origin}, search", settings):
                    pass  # only the check matters
    return tuple(cells.values())


def _require_one_method(first: Cell, cell: Cell, manifest: Manifest) -> None:
    found = differences(first.config, cell.config)
    found.pop("seed", None)
    if found:
        key, (one, other) = next(iter(found.items()))
        raise UserError(
            f"{manifest.origin}: {first.name} and {cell.name} would count as two seeds of one "
            f"method, but {key} is {one!r} in the first and {other!r} in the second; give it a "
            "variant name, under variants, in one of their grids"
        )


def expand_grid(
    grid: Grid, origin: str, settings: Mapping[str, Any] | None = None, variant: str = ""
) -> Iterator[Cell]:
    """Expand a grid into its cells.

    Args:
        grid: The grid.
        origin: Its source, for messages.
        settings: Further settings, which override all others.
        variant: Name of these settings, a prefix of the variants' names.

    Raises:
        UserError: The settings of a cell are not allowed.
    """
    for task, algo, preset, (name, changed), budget, seed in itertools.product(
        grid.tasks,
        grid.algos,
        grid.presets,
        (grid.variants or {"": {}}).items(),
        grid.budgets or (None,),
        grid.seeds,
    ):
        named = "-".join(filter(None, (variant, name)))
        all_settings = {**grid.settings, **changed, **(settings or {})}
        choice = _Choice(grid, task, algo, preset, named, budget, seed, all_settings)
        try:
            yield _make_cell(choice)
        except (UserError, TaskError) as error:
            place = ", ".join(filter(None, (task, algo, preset, named)))
            raise UserError(f"{origin}, {place}: {error}") from error


def _make_cell(choice: _Choice) -> Cell:
    grid = choice.grid
    config = load_config(
        choice.task,
        preset=choice.preset,
        algo=choice.algo,
        overrides=[f"{key}={json.dumps(value)}" for key, value in choice.settings.items()],
        driver=grid.driver,
        robot=grid.robot,
        connect=grid.connect,
        budget_minutes=choice.budget,
        seed=choice.seed,
        device=grid.device,
        until_success=grid.until_success,
    )
    identity = Identity(
        task=config.task,
        robot=config.chosen_robot.title,
        algo=choice.algo,
        preset=Path(choice.preset).stem,
        variant=choice.variant,
        budget=choice.budget if len(grid.budgets) > 1 else None,
        seed=config.seed,
    )
    return Cell(identity, config)


def differences(first: RunConfig, second: RunConfig) -> dict[str, tuple[Any, Any]]:
    """Settings that differ between two runs and can change their results.

    Returns:
        Both values by dotted key, None for a missing one.
    """
    one, two = _flat(plain_identity(first)), _flat(plain_identity(second))
    return {
        key: (one.get(key), two.get(key))
        for key in {**one, **two}
        if one.get(key, _ABSENT) != two.get(key, _ABSENT)
    }


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            found |= _flat(value, f"{prefix}{key}.")
        else:
            found[prefix + key] = value
    return found
