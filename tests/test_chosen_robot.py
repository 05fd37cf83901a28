"""A robot by name or by file, and who is to blame for what is in it."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

import iher_robot.chosen_robot
from drivers import InvalidSpec
from iher_robot.chosen_robot import ChosenRobot, choose_robot
from iher_robot.errors import UserError
from tasks import TASKS

SHIPPED = sorted(file.stem for file in Path(__file__).parents[1].glob("configs/robots/*.yaml"))


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    return tmp_path / "mine.yaml"


def test_the_simulated_robot_has_a_default_and_other_drivers_their_own() -> None:
    assert choose_robot("mujoco", None) == choose_robot("mujoco", "fetch")
    assert choose_robot("mujoco", None).name == "fetch"
    assert choose_robot("other", None) == ChosenRobot("other", "", {})
    assert choose_robot("other", "fetch-mocap").options == {"actuation": "mocap"}


def test_a_file_of_ones_own_reaches_the_driver_as_it_is(
    mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine.write_text("object: {mass_kg: 1e-1}\nactuation: mocap\ndelay: 2\n")
    made: list[tuple[object, ...]] = []
    monkeypatch.setattr(
        iher_robot.chosen_robot, "make_env", lambda *names, **options: made.append((names, options))
    )

    choose_robot("other", str(mine)).make_env("push", "rgb_array")

    options = {"object": {"mass_kg": 0.1}, "actuation": "mocap", "delay": 2}
    assert made == [(("push", "other"), {"render_mode": "rgb_array", **options})]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("scene: slide", r"mine\.yaml: scene cannot be set there, the scene is the task's"),
        ("render_mode: human", r"mine\.yaml: render_mode cannot be set there"),
        ("- fetch", r"mine\.yaml: expected lines of 'key: value'"),
    ],
)
def test_what_is_not_the_robots_is_refused(mine: Path, text: str, message: str) -> None:
    mine.write_text(text)
    with pytest.raises(UserError, match=message):
        choose_robot("mujoco", str(mine))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("ftch", "unknown robot 'ftch', valid: .*fetch.*; did you mean 'fetch'"),
        ("nowhere/mine.yml", "no robot file at nowhere/mine.yml"),
        ("robots/fetch", "unknown robot 'robots/fetch': a path must be that of a YAML file"),
        ("", "unknown robot ''"),
    ],
)
def test_a_robot_that_is_not_there_is_named(name: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        choose_robot("mujoco", name)


def test_what_the_driver_finds_wrong_is_told_with_the_file(
    mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise InvalidSpec("object.mass_kg is -1, allowed: above 0")

    monkeypatch.setattr(iher_robot.chosen_robot, "make_env", refuse)
    with pytest.raises(UserError, match=r"^robot .*mine\.yaml: object\.mass_kg is -1, allowed"):
        ChosenRobot("mujoco", str(mine), {}).make_env("push")
    with pytest.raises(InvalidSpec, match=r"^object\.mass_kg"):
        ChosenRobot("mujoco", "", {}).make_env("push")


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_robot_takes_every_task(name: str) -> None:
    for task in TASKS:
        with choose_robot("mujoco", name).make_env(task) as env:
            assert env.task.name == task


@pytest.mark.parametrize(
    "robot",
    [
        choose_robot("mujoco", None),
        choose_robot("mujoco", "fetch-mocap"),
        choose_robot("far away", None),
    ],
)
def test_the_options_of_a_command_name_the_same_robot(robot: ChosenRobot) -> None:
    words = shlex.split(robot.command_options)
    given = dict(zip(words[::2], words[1::2], strict=True))
    assert choose_robot(given.get("--driver", "mujoco"), given.get("--robot")) == robot


def test_titles_name_driver_and_robot_without_folders() -> None:
    titles = [ChosenRobot("mujoco", name, {}).title for name in ("", "fetch", "my/robot.yaml")]
    assert titles == ["mujoco", "mujoco fetch", "mujoco robot"]
