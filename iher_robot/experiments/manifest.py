"""What an experiment runs: grids of tasks, algorithms, settings, budgets and seeds."""

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

# Settings that a manifest has a key of its own for, by which cells are told apart.
_KEYS_OF_THEIR_OWN = {
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
    """Every combination of what is listed is a cell."""

    tasks: tuple[str, ...] = Field(min_length=1)
    """Tasks to be learned."""
    algos: tuple[str, ...] = Field(default=("iher",), min_length=1)
    """Algorithms: iher, her, her-matched."""
    presets: tuple[str, ...] = Field(default=("default",), min_length=1)
    """Names of presets, or paths of YAML files."""
    variants: dict[str, dict[str, Any]] = Field(default={})
    """Settings by the name of the variant, dotted keys as with ``--set``; none is one variant
    without a name."""
    budgets: tuple[Annotated[float, Field(gt=0, allow_inf_nan=False)], ...] = ()
    """Robot minutes; the preset's where empty."""
    seeds: tuple[Annotated[int, Field(ge=0)], ...] = Field(default=(0,), min_length=1)
    """Seeds of the runs."""
    settings: dict[str, Any] = Field(default={})
    """Settings of all cells of the grid; where a variant has the same one, the variant's counts."""
    driver: str | None = None
    """What moves; as ``iher-robot train`` chooses where it is off."""
    robot: str | None = None
    """A robot's name or the path of a YAML file; the driver's default where it is off."""
    connect: tuple[str, ...] = ()
    """Where to reach a robot on the network."""
    until_success: Annotated[float | None, OR_OFF] = Field(default=None, gt=0, le=1)
    """Stop when two evaluations in a row reach this rate; ``off`` spends every budget."""
    device: Literal["auto", "cpu", "cuda"] = "cpu"
    """Where replay, models and policy live."""


class _Head(Section):
    title: str = Field(min_length=1)
    """What the report is called."""
    description: str = ""
    """What the experiment asks, for the report."""
    grids: tuple[Any, ...] = Field(min_length=1)
    """The grids."""
    search: dict[str, Any] | None = None
    """A search for settings, see docs/experiments.md."""


@dataclass(frozen=True)
class Manifest:
    """What an experiment runs.

    Attributes:
        origin: Where it was read, for messages.
        title: What the report is called.
        description: What the experiment asks.
        grids: The grids.
        search: The search for settings that runs the grid at each of its points, if it is one.
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
            from its own folder.

    Raises:
        UserError: There is none, or something in it is not allowed.
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
        _require_no_key_of_its_own(search.parameters, f"{layer.origin}, search")
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
            raise UserError(f"{origin}: {key} names {twice!r} twice; leave one out")
    _require_no_key_of_its_own(grid.settings, f"{origin}, settings")
    for name, changed in grid.variants.items():
        _require_no_key_of_its_own(changed, f"{origin}, variant {name}")
        if not _NAME.fullmatch(name):
            raise UserError(
                f"{origin}: a variant is called {name!r}, allowed: letters, digits, dots and "
                "underscores, with hyphens between them"
            )
    return grid.model_copy(
        update={
            "presets": tuple(_from_folder(preset, folder) for preset in grid.presets),
            "robot": None if grid.robot is None else _from_folder(grid.robot, folder),
        }
    )


def _require_no_key_of_its_own(settings: Iterable[str], origin: str) -> None:
    for key in settings:
        own = _KEYS_OF_THEIR_OWN.get(key.strip())
        if own is not None:
            raise UserError(f"{origin}: {key} cannot be set there, use the grid's key {own}")


def _from_folder(name: str, folder: Path) -> str:
    return str((folder / name).absolute()) if is_yaml_file(name) else name
