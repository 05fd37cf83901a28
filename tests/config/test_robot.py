"""Choice of a robot by name or by file, and its errors."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from drivers import InvalidSpec
from iher_robot.config import robot as robot_module
from iher_robot.config.robot import ChosenRobot, choose_robot
from iher_robot.errors import UserError
from tasks import TASKS
from tests.repository import ROOT

SHIPPED = sorted(file.stem for file in ROOT.glob("configs/robots/*.yaml"))


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    return tmp_path / "mine.yaml"


def test_the_simulated_robot_has_a_default_and_other_drivers_their_own() -> None:
    assert choose_robot("mujoco", None) == choose_robot("mujoco", "fetch")
    assert choose_robot("mujoco", None).name == "fetch"
    assert choose_robot("other", None) == ChosenRobot("other", "", {})
    assert choose_robot("other", "fetch-mocap").options == {"actuation": "mocap"}


def test_a_users_file_reaches_the_driver_unchanged(
    mine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine.write_text("object: {mass_kg: 1e-1}\nactuation: mocap\ndelay: 2\n")
    made: list[tuple[object, ...]] = []
    monkeypatch.setattr(
        robot_module, "make_env", lambda *names, **options: made.append((names, options))
    )

    choose_robot("other", str(mine)).make_env("push", "rgb_array")

    options = {"object": {"mass_kg": 0.1}, "actuation": "mocap", "delay": 2}
    expected = {"render_mode": "rgb_array", "ask_human": None, **options}
    assert made == [(("push", "other"), expected)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("scene: slide", r"mine\.yaml: scene cannot be set there, the scene is the task's"),
        ("render_mode: human", r"mine\.yaml: render_mode cannot be set there"),
        ("- fetch", r"mine\.yaml: expected lines of 'key: value'"),
    ],
)
def test_keys_that_are_not_the_robots_are_refused(mine: Path, text: str, message: str) -> None:
    mine.write_text(text)
    with pytest.raises(UserError, match=message):
        choose_robot("mujoco", str(mine))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("ftch", "unknown robot 'ftch', valid: .*fetch.*; did you mean 'fetch'"),
        ("nowhere/mine.yml", "no robot file at nowhere/mine.yml"),
        ("robots/fetch", "unknown robot 'robots/fetch': the path of a YAML file must end in"),
        ("", "unknown robot ''"),
    ],
)
def test_an_unknown_robot_is_named(name: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        choose_robot("mujoco", name)


def test_an_error_of_the_driver_names_the_file(mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise InvalidSpec("object.mass_kg is -1, allowed: above 0")

    monkeypatch.setattr(robot_module, "make_env", refuse)
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
        choose_robot("zenoh", None),
        choose_robot("zenoh", "arm-2"),
        choose_robot("zenoh", None, ["tcp/10.0.0.7:7447", "tls/arm:7447"]),
    ],
)
def test_the_options_of_a_command_name_the_same_robot(robot: ChosenRobot) -> None:
    assert from_words(robot.command_options) == robot


def from_words(command_options: str) -> ChosenRobot:
    words = shlex.split(command_options)
    given = list(zip(words[::2], words[1::2], strict=True))
    connect = [value for name, value in given if name == "--connect"]
    return choose_robot(dict(given).get("--driver"), dict(given).get("--robot"), connect)


@pytest.mark.parametrize(
    "text",
    [
        "actuation: mocap",
        "driver: mujoco\nactuation: mocap",
        "driver: other\ndelay: 2",
        "driver: zenoh\nrobot: arm\nconnect: [tcp/a:1]\ntls: {ca: ca.pem}\n",
    ],
)
def test_the_options_of_a_command_name_the_same_file(mine: Path, text: str) -> None:
    mine.write_text(text)
    for connect in [], ["tcp/b:2"]:
        if connect and "zenoh" not in text:
            continue
        robot = choose_robot(None, str(mine), connect)
        assert from_words(robot.command_options) == robot


def test_a_robot_on_the_network_is_chosen_by_its_name_there() -> None:
    assert choose_robot("zenoh", None) == ChosenRobot("zenoh", "fetch", {"robot": "fetch"})
    arm = choose_robot("zenoh", "arm-2", ["tcp/a:1"])
    assert arm.options == {"robot": "arm-2", "connect": ["tcp/a:1"]}
    assert arm.title == "zenoh arm-2"


def test_a_file_may_name_its_driver_which_is_no_option(mine: Path) -> None:
    mine.write_text("driver: other\ndelay: 2\n")
    for driver in (None, "other"):
        assert choose_robot(driver, str(mine)) == ChosenRobot("other", str(mine), {"delay": 2})
    with pytest.raises(UserError, match=r"mine\.yaml: driver is 'other', but 'mujoco' was"):
        choose_robot("mujoco", str(mine))

    mine.write_text("delay: 2\n")
    assert choose_robot(None, str(mine)).driver == "mujoco"
    assert choose_robot(None, str(mine), default_driver="zenoh").driver == "zenoh"
    mine.write_text("driver: 3\n")
    with pytest.raises(UserError, match=r"driver is 3, allowed: the name of a driver"):
        choose_robot(None, str(mine))


def test_paths_in_a_file_are_relative_to_it(mine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine.write_text(
        "driver: zenoh\nuser: me\npassword_file: secret/mine.txt\n"
        "tls: {ca: /etc/ca.pem, key: ../me.key, certificate: 3}\n"
    )
    monkeypatch.chdir(mine.parent)
    for name in (str(mine), mine.name):  # independent of the working folder
        options = choose_robot(None, name).options
        assert options["password_file"] == str(mine.parent / "secret/mine.txt")
        assert options["tls"]["ca"] == "/etc/ca.pem"
        assert Path(options["tls"]["key"]).resolve() == mine.parent.parent / "me.key"
        assert options["tls"]["certificate"] == 3  # the driver checks it
        assert options["user"] == "me"

    mine.write_text("password_file: mine.txt\n")
    assert choose_robot("other", str(mine)).options == {"password_file": "mine.txt"}


def test_endpoints_are_for_a_robot_on_the_network(mine: Path) -> None:
    mine.write_text("driver: zenoh\nconnect: [tcp/a:1]\n")
    assert choose_robot(None, str(mine)).options["connect"] == ["tcp/a:1"]
    assert choose_robot(None, str(mine), ["tcp/b:2"]).options["connect"] == ["tcp/b:2"]
    for driver in (None, "mujoco", "other"):
        with pytest.raises(
            UserError, match=r"--connect is 'tcp/b:2', but driver .* --driver zenoh"
        ):
            choose_robot(driver, None, ["tcp/b:2"])


def test_titles_name_driver_and_robot_without_folders() -> None:
    titles = [ChosenRobot("mujoco", name, {}).title for name in ("", "fetch", "my/robot.yaml")]
    assert titles == ["mujoco", "mujoco fetch", "mujoco robot"]
