"""Manifests: their cells, and one sentence for each error."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest

from iher_robot.config.layers import experiment_names
from iher_robot.config.options import load_config
from iher_robot.config.yaml import format_yaml
from iher_robot.errors import UserError
from iher_robot.experiments.grid import Cell, differences, expand
from iher_robot.experiments.manifest import read_manifest
from iher_robot.experiments.report import findings

GRID = {"tasks": ["reach"]}


def write(folder: Path, *grids: dict[str, Any], **head: Any) -> str:
    path = folder / "m.yaml"
    path.write_text(format_yaml({"title": "t", "grids": list(grids)} | head))
    return str(path)


def cells_of(folder: Path, *grids: dict[str, Any], **head: Any) -> tuple[Cell, ...]:
    return expand(read_manifest(write(folder, *grids, **head)))


def test_a_grid_is_every_combination(tmp_path: Path) -> None:
    grid = {
        "tasks": ["reach", "pick-and-place"],
        "algos": ["iher", "her"],
        "presets": ["default", "paper"],
        "variants": {"plain": {}, "sharp": {"learner.ddpg.gamma": 0.9}},
        "budgets": [1, 2.5],
        "seeds": [0, 7],
    }

    cells = cells_of(tmp_path, grid)

    assert [cell.name for cell in cells] == [
        f"{task}-{algo}-{preset}-{variant}-{budget}min-seed{seed}"
        for task, algo, preset, variant, budget, seed in itertools.product(
            *(["reach", "pick_and_place"], ["iher", "her"], ["default", "paper"]),
            *(["plain", "sharp"], ["1", "2.5"], [0, 7]),
        )
    ]
    last = cells[-1].config
    assert (last.budget_minutes, last.seed, last.learner.ddpg.gamma) == (2.5, 7, 0.9)
    assert (last.until_success, last.device) == (None, "cpu")


def test_a_variant_overrides_its_grid(tmp_path: Path) -> None:
    variants = {"a": {}, "b": {"learner.ddpg.gamma": 0.9}}
    grid = GRID | {"settings": {"learner.ddpg.gamma": 0.5}, "variants": variants}

    assert [c.config.learner.ddpg.gamma for c in cells_of(tmp_path, grid)] == [0.5, 0.9]


def test_a_cell_has_the_settings_of_its_grid(tmp_path: Path) -> None:
    robot = tmp_path / "mine.yaml"
    robot.write_text("actuation: mocap\n")
    settings = {"learner.ddpg.hidden": [8, 8], "learner.ddpg.policy_average": None}
    grid = GRID | {"robot": "mine.yaml", "settings": settings, "until_success": 0.9, "seeds": [3]}
    (cell,) = cells_of(tmp_path, grid | {"budgets": [0.1]})

    assert cell.config == load_config(
        GRID["tasks"][0],
        overrides=["learner.ddpg.hidden=[8, 8]", "learner.ddpg.policy_average=null"],
        robot=str(robot),
        budget_minutes=0.1,
        seed=3,
        device="cpu",
        until_success=0.9,
    )
    assert cell.config.learner.ddpg.hidden == (8, 8)
    assert cell.name.endswith("seed3")
    assert cell.config.robot == str(robot), "paths are relative to the manifest's folder"


@pytest.mark.parametrize("name", experiment_names())
def test_every_shipped_experiment_expands(name: str) -> None:
    cells = expand(read_manifest(name))

    assert cells
    for cell in cells:
        assert cell.simulated
        assert cell.identity.robot == "mujoco fetch-mocap"


def test_the_shipped_experiments_are_as_named() -> None:
    names = {"fig-benchmark", "fig-ablation", "fig-ensemble", "default-vs-paper"}
    assert names | {"reach", "push", "smoke", "open-points"} == set(experiment_names())
    ablation = {cell.identity.variant: cell.config.learner for cell in expand_named("fig-ablation")}
    assert [
        (c.ddpg.source_input, c.imagination.regenerate, c.intrinsic.enabled)
        for c in ablation.values()
    ] == [(True, True, True), (False, True, True), (True, False, True), (True, True, False)]
    ensembles = {
        (cell.config.learner.dynamics.members, cell.config.learner.imagination.regenerate)
        for cell in expand_named("fig-ensemble")
    }
    assert ensembles == set(itertools.product((1, 3, 5), (True, False)))


def test_each_open_point_is_changed_alone() -> None:
    chosen, *others = (cell for cell in expand_named("open-points") if not cell.identity.seed)

    changed = [[*differences(chosen.config, other.config)] for other in others]

    assert len(changed) == 7
    assert all(len(keys) == 1 and keys[0].startswith("learner.") for keys in changed), changed


def expand_named(name: str) -> tuple[Cell, ...]:
    return expand(read_manifest(name))


@pytest.mark.parametrize(
    ("grid", "said"),
    [
        ({}, "tasks is missing: Tasks to learn."),
        ({"tasks": []}, "tasks is []"),
        ({"tasks": "reach"}, "tasks is 'reach', allowed: a list"),
        (GRID | {"seed": [1]}, "unknown key 'seed'"),
        (GRID | {"seeds": [1, 1]}, "seeds lists 1 twice"),
        (GRID | {"seeds": [-1]}, "seeds is -1"),
        (GRID | {"seeds": [True]}, "seeds is True"),
        (GRID | {"budgets": [0]}, "budgets is 0"),
        (GRID | {"until_success": 2}, "until_success is 2"),
        (GRID | {"variants": {"a/b": {}}}, "a variant has the name 'a/b'"),
        (GRID | {"variants": {"a": {"learner.ddpg.gama": 1}}}, "did you mean 'learner.ddpg.gamma'"),
        (GRID | {"settings": {"learner.ddpg.gamma": 2}}, "gamma is 2"),
        (
            GRID | {"settings": {"task": "push"}},
            "task cannot be set there, use the grid's key tasks",
        ),
        (GRID | {"settings": {"seed": 3}}, "seed cannot be set there, use the grid's key seeds"),
        (GRID | {"settings": {"until_success": 1.0}}, "use the grid's key until_success"),
        (
            GRID | {"variants": {"long": {"budget_minutes": 9}}},
            "variant long: budget_minutes cannot be set there, use the grid's key budgets",
        ),
        (GRID | {"presets": ["papre"]}, "unknown preset 'papre'"),
        (GRID | {"algos": ["hre"]}, "unknown algorithm 'hre'"),
        ({"tasks": ["raech"]}, "unknown task 'raech'"),
        (GRID | {"robot": "nobody"}, "unknown robot 'nobody'"),
    ],
)
def test_an_error_in_a_grid_is_one_sentence(
    tmp_path: Path, grid: dict[str, Any], said: str
) -> None:
    with pytest.raises(UserError) as caught:
        cells_of(tmp_path, grid)

    assert said in str(caught.value)
    assert "m.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_errors_outside_the_grids(tmp_path: Path) -> None:
    def said(*grids: dict[str, Any], **head: Any) -> str:
        with pytest.raises(UserError) as caught:
            cells_of(tmp_path, *grids, **head)
        return str(caught.value)

    assert "grids is []" in said()
    assert "unknown key 'titel'" in said(GRID, titel="x")
    assert "grid 2: unknown key 'task'" in said(GRID, {"task": ["reach"]})
    assert "two cells are called reach-iher-default-seed0" in said(GRID, GRID)
    with pytest.raises(UserError, match=r"unknown experiment 'smok'.*did you mean 'smoke'"):
        read_manifest("smok")
    with pytest.raises(UserError, match=r"no experiment file at .*there\.yaml"):
        read_manifest(str(tmp_path / "there.yaml"))


METHOD = {"tasks": ["reach"], "presets": ["paper"]}


@pytest.mark.parametrize(
    ("first", "second", "key"),
    [
        ({"budgets": [60]}, {"budgets": [6]}, "budget_minutes is 60.0 in the first and 6.0 in the"),
        ({}, {"settings": {"learner.ddpg.gamma": 0.5}}, "learner.ddpg.gamma is 0.98 in the first"),
        ({"until_success": 0.9}, {}, "until_success is 0.9 in the first and None in the second"),
        ({"presets": ["a/p.yaml"]}, {"presets": ["b/p.yaml"]}, "preset is "),
        ({"robot": "a/p.yaml"}, {"robot": "b/p.yaml"}, "robot is "),
    ],
)
def test_seeds_of_a_method_must_have_equal_settings(
    tmp_path: Path, first: dict[str, Any], second: dict[str, Any], key: str
) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "p.yaml").write_text("{}")
    more = {"seeds": [1, 2]}

    with pytest.raises(UserError) as caught:
        cells_of(tmp_path, METHOD | first, METHOD | second | more)

    assert f"method, but {key}" in str(caught.value)
    assert "give it a variant name" in str(caught.value)
    named = {"variants": {"other": second.pop("settings", {})}}
    assert len(cells_of(tmp_path, METHOD | first, METHOD | second | more | named)) == 3


def test_seeds_of_one_method_may_be_in_several_grids(tmp_path: Path) -> None:
    more = {"seeds": [1], "settings": {"simulators": 2}}  # which changes no number
    cells = cells_of(tmp_path, METHOD, METHOD | more)

    assert len({cell.identity.method for cell in cells}) == 1
    # The report groups by the same columns.
    assert {*findings._METHOD_KEY, "task", "seed"} == cells[0].identity.as_row().keys()


SEARCH = {"parameters": {"learner.ddpg.gamma": {"low": 0.9, "high": 0.99}}, "trials": 3}


@pytest.mark.parametrize(
    ("search", "said"),
    [
        (SEARCH, "objective is missing"),
        (SEARCH | {"objective": "speed"}, "objective is 'speed', allowed: one of"),
        ({"low": 1.0}, "give low and high, or choices"),
        ({"low": 1.0, "high": 1.0}, "allowed: low < high"),
        ({"low": 0.0, "high": 1.0, "log": True}, "allowed with log: 0 < low"),
        ({"low": 0.5, "high": 2.0, "integer": True}, "allowed: whole numbers"),
        ({"choices": [1], "low": 0.5}, "choices exclude low"),
        ({"choices": [[1]]}, "choices are text, numbers"),
    ],
)
def test_errors_in_a_search(tmp_path: Path, search: dict[str, Any], said: str) -> None:
    if "parameters" not in search:
        parameters = {"learner.ddpg.gamma": search}
        search = SEARCH | {"objective": "success-at-budget", "parameters": parameters}
    with pytest.raises(UserError) as caught:
        cells_of(tmp_path, GRID, search=search)
    assert said in str(caught.value)


def test_a_search_has_one_grid(tmp_path: Path) -> None:
    search = SEARCH | {"objective": "success-at-budget"}
    with pytest.raises(UserError, match="a search has one grid, and there are 2"):
        cells_of(tmp_path, GRID, {"tasks": ["push"]}, search=search)
