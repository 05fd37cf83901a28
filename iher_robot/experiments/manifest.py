"""Manifest of an experiment: grids of tasks, algorithms, settings, budgets and seeds."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from iher_robot.config.layers import Layer, experiment_layer, is_yaml_file
from iher_robot.config.section import Section, parse_section
from iher_robot.errors import UserError
from iher_robot.experiments.search_space import Search, parse_search
from iher_robot.learning.config import OR_OFF

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._]*(-[A-Za-z0-9._]+)*")

# Settings with their own key in a grid: they distinguish cells, or hold for the whole grid.
_GRID_KEYS = {
    "task": "tasks",
    "algo": "algos",
    "preset": "presets",
    "budget_minutes": "budgets",
    "seed": "seeds",
    "driver": "driver",
    "robot": "robot",
    "robot_options": "robot",
    "until_success": "until_success",
    "device": "device",
}


class Grid(Section):
    """A grid: every combination of the listed values is a cell."""

    tasks: tuple[str, ...] = Field(min_length=1)
    """Tasks to learn."""
    algos: tuple[str, ...] = Field(default=("iher",), min_length=1)
    """Algorithms: iher, her, her-matched."""
    presets: tuple[str, ...] = Field(default=("default",), min_length=1)
    """Names of presets, or paths of YAML files."""
    variants: dict[str, dict[str, Any]] = Field(default={})
    """Settings by name of the variant, dotted keys as with ``--set``; empty means one variant
    without a name."""
    budgets: tuple[Annotated[float, Field(gt=0, allow_inf_nan=False)], ...] = ()
    """Robot minutes; empty for the preset's."""
    seeds: tuple[Annotated[int, Field(ge=0)], ...] = Field(default=(0,), min_length=1)
    """Seeds of the runs."""
    settings: dict[str, Any] = Field(default={})
    """Settings of all cells of the grid; those of a variant override them."""
    driver: str | None = None
    """Name of the robot driver; null for the default of ``iher-robot train``."""
    robot: str | None = None
    """A robot's name or the path of a YAML file; null for the driver's default."""
    connect: tuple[str, ...] = ()
    """Endpoints of a robot on the network."""
    until_success: Annotated[float | None, OR_OFF] = Field(default=None, gt=0, le=1)
    """Stop when two evaluations in a row reach this rate; ``off`` spends every budget."""
    device: Literal["auto", "cpu", "cuda"] = "cpu"
    """Device of replay, models and policy."""


class _Head(Section):
    title: str = Field(min_length=1)
    """Title of the report."""
    description: str = ""
    """Question of the experiment, for the report."""
    grids: tuple[Any, ...] = Field(min_length=1)
    """The grids."""
    search: dict[str, Any] | None = None
    """A search for settings, see docs/experiments.md."""


@dataclass(frozen=True)
class Manifest:
    """A checked manifest.

    Attributes:
        origin: Its source, for messages.
        title: Title of the report.
        description: Question of the experiment.
        grids: The grids.
        search: The search, which runs the grid at each of its points; None without one.
    """

    origin: str
    title: str
    description: str
    grids: tuple[Grid, ...]
    search: Search | None


def read_manifest(name: str) -> Manifest:
    """Read a manifest.

    Args:
        name: Name of a shipped experiment, or the path of a YAML file. Paths in the file are
            relative to its folder.

    Raises:
        UserError: It does not exist, or something in it is not allowed.
    """
    layer = experiment_layer(name)
    head = parse_section(_Head, layer.values, layer.origin)
    folder = Path(name).parent if is_yaml_file(name) else Path()
    grids = []
    for number, values in enumerate(head.grids, start=1):
        origin = f"{layer.origin}, grid {number}" if len(head.grids) > 1 else layer.origin
        grids.append(_checked(parse_section(Grid, values, origin), origin, folder))
    search = None
    if head.search is not None:
        if len(grids) > 1:
            raise UserError(f"{layer.origin}: a search has one grid, and there are {len(grids)}")
        search = parse_search(Layer(f"{layer.origin}, search", head.search))
        _refuse_grid_keys(search.parameters, f"{layer.origin}, search")
    return Manifest(layer.origin, head.title, head.description, tuple(grids), search)


def _checked(grid: Grid, origin: str, folder: Path) -> Grid:
    lists: Mapping[str, tuple[Any, ...]] = {
        "tasks": grid.tasks,
        "algos": grid.algos,
        "presets": grid.presets,
        "budgets": grid.budgets,
        "seeds": grid.seeds,
    }
    for key, values in lists.items():
        twice = next((value for value in values if values.count(value) > 1), None)
        if twice is not None:
            raise UserError(f"{origin}: {key} lists {twice!r} twice; leave one out")
    _refuse_grid_keys(grid.settings, f"{origin}, settings")
    for name, changed in grid.variants.items():
        _refuse_grid_keys(changed, f"{origin}, variant {name}")
        if not _NAME.fullmatch(name):
            raise UserError(
                f"{origin}: a variant has the name {name!r}, allowed: letters, digits, dots and "
                "underscores, with hyphens between them"
            )
    return grid.model_copy(
        update={
            "presets": tuple(_from_folder(preset, folder) for preset in grid.presets),
            "robot": None if grid.robot is None else _from_folder(grid.robot, folder),
        }
    )


def _refuse_grid_keys(settings: Iterable[str], origin: str) -> None:
    for key in settings:
        own = _GRID_KEYS.get(key.strip())
        if own is not None:
            raise UserError(f"{origin}: {key} cannot be set there, use the grid's key {own}")


def _from_folder(name: str, folder: Path) -> str:
    return str((folder / name).absolute()) if is_yaml_file(name) else name
