"""Layers, types and messages of the settings."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from iher_robot.config import layers as config_source
from iher_robot.config.options import load_config
from iher_robot.config.run import RunConfig, dump_config, read_config
from iher_robot.errors import UserError
from iher_robot.learning.config import DDPGConfig
from tests.repository import ROOT

Files = Callable[[str, str], None]


@pytest.fixture
def configs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Files:
    """A configs folder with empty files for Push; call it to write one."""
    root = tmp_path / "configs"

    def write(name: str, text: str) -> None:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)

    for name in ("presets/default/push.yaml", "presets/paper/push.yaml", "algorithms/iher.yaml"):
        write(name, "")
    write("robots/fetch.yaml", "actuation: mocap")
    monkeypatch.setattr(config_source, "_configs_root", lambda: root)
    return write


def load(*overrides: str) -> RunConfig:
    return load_config("push", overrides=overrides)


def test_each_layer_wins_over_the_one_before(configs: Files) -> None:
    configs(
        "presets/default/push.yaml",
        "learner:\n  ddpg: {gamma: 0.9, tau: 0.1, actor_lr: 0.01}\nseed: 3\n",
    )
    configs("algorithms/iher.yaml", "learner: {ddpg: {gamma: 0.8, tau: 0.2}}")

    config = load("learner.ddpg.gamma=0.7")

    ddpg = config.learner.ddpg
    assert (ddpg.gamma, ddpg.tau, ddpg.actor_lr) == (0.7, 0.2, 0.01)
    assert ddpg.critic_lr == RunConfig().learner.ddpg.critic_lr
    assert config.seed == 3


def test_the_last_override_of_a_key_wins_and_a_section_may_be_given_whole(configs: Files) -> None:
    config = load("seed=1", "seed=2", "learner.ddpg={gamma: 0.5}", "learner.ddpg.tau=0.5")
    assert (config.seed, config.learner.ddpg.gamma, config.learner.ddpg.tau) == (2, 0.5, 0.5)


@pytest.mark.parametrize(
    ("override", "read", "expected"),
    [
        # What YAML 1.1 reads otherwise: text, False, 8, 90.
        ("learner.ddpg.actor_lr=1e-3", lambda c: c.learner.ddpg.actor_lr, 1e-3),
        ("learner.ddpg.clip_target=off", lambda c: c.learner.ddpg.clip_target, "off"),
        ("until_success=off", lambda c: c.until_success, None),
        ("until_success=0.9", lambda c: c.until_success, 0.9),
        ("until_success=null", lambda c: c.until_success, None),
        ("learner.ddpg.hidden=[64, 32]", lambda c: c.learner.ddpg.hidden, (64, 32)),
        ("learner.imagination.enabled=false", lambda c: c.learner.imagination.enabled, False),
        ("budget_minutes=40", lambda c: c.budget_minutes, 40.0),
    ],
)
def test_values_are_read_as_their_keys_type(
    configs: Files, override: str, read: Callable[[RunConfig], object], expected: object
) -> None:
    value = read(load(override))
    assert value == expected
    assert type(value) is type(expected)


@pytest.mark.parametrize(
    ("override", "fragments"),
    [
        ("learner.ddpg.gamma=1.5", ["learner.ddpg.gamma is 1.5", "0.0 <= gamma < 1.0"]),
        ("learner.ddpg.gamma=true", ["learner.ddpg.gamma is True", "number"]),
        ("learner.ddpg.gamma='0.9'", ["learner.ddpg.gamma is '0.9'", "number"]),
        ("learner.replay.capacity=.nan", ["learner.replay.capacity is nan", "integer"]),
        ("learner.replay.capacity=2.5", ["learner.replay.capacity is 2.5", "integer"]),
        ("learner.exploration.noise_std=.inf", ["noise_std is inf", "finite"]),
        ("learner.ddpg.hidden=[64, x]", ["learner.ddpg.hidden is 'x'", "list", "integer"]),
        ("learner.ddpg.clip_target=sometimes", ["'sometimes'", "her, intrinsic, off"]),
        ("learner.imagination.enabled=off", ["'off'", "true or false"]),
        ("learner.ddpg=3", ["learner.ddpg is 3", "section", "gamma"]),
        ("budget_minutes=0", ["budget_minutes is 0", "0 < budget_minutes"]),
        ("budget_minutes=.nan", ["budget_minutes is nan", "finite"]),
        ("budget_minutes=.inf", ["budget_minutes is inf", "finite"]),
        ("budget_minutes=1:30", ["budget_minutes is '1:30'", "number"]),
        ("until_success=1.1", ["until_success is 1.1", "until_success <= 1", "off"]),
        ("until_success=false", ["until_success is False"]),
        ("evaluation.episodes=0", ["evaluation.episodes is 0", "1 <= episodes"]),
        ("evaluation.robot_episodes=0", ["robot_episodes is 0", "1 <= robot_episodes"]),
        ("patience_minutes=-1", ["patience_minutes is -1", "0 <= patience_minutes"]),
        ("patience_minutes=.inf", ["patience_minutes is inf", "finite"]),
        ("device=gpu", ["device is 'gpu'", "auto, cpu, cuda"]),
        ("learner.ddpg.gama=0.9", ["'learner.ddpg.gama'", "mean 'learner.ddpg.gamma'"]),
        ("gamma=0.9", ["unknown key 'gamma'", "mean 'learner.ddpg.gamma'"]),
        ("ddpg.gamma=0.9", ["unknown key 'ddpg'", "mean 'learner.ddpg'"]),
        ("learner.ddpg.gamma.x=0.9", ["learner.ddpg.gamma", "number"]),
        ("task=reach", ["--task"]),
        ("robot=fetch", ["--robot"]),
        ("robot_options={actuation: joint}", ["--robot"]),
        ("robot_options.actuation=joint", ["--robot"]),
        ("seed", ["--set seed", "key=value"]),
        ("=3", ["key=value"]),
        ("learner..gamma=3", ["key=value"]),
        ("seed=[1", ["--set seed=[1", "not valid YAML"]),
        ("seed=" + "[" * 5000, ["not valid YAML"]),
        ("learner.ddpg={gamma: 0.9, gamma: 0.8}", ["gamma", "duplicate"]),
        ("learner.ddpg.hidden=&a [*a]", ["--set learner.ddpg.hidden"]),
        ("learner.ddpg={[1]: 2}", ["--set learner.ddpg"]),
        ("seed=!!python/object/apply:os.getcwd []", ["not valid YAML"]),
    ],
)
def test_bad_overrides_are_named_with_what_is_allowed(
    configs: Files, override: str, fragments: list[str]
) -> None:
    with pytest.raises(UserError) as error:
        load(override)
    message = str(error.value)
    assert "\n" not in message
    for fragment in fragments:
        assert fragment in message


def test_a_bad_value_in_a_file_names_the_file(configs: Files) -> None:
    configs("presets/default/push.yaml", "learner: {ddpg: {tau: 2}}")
    with pytest.raises(
        UserError, match=r"configs/presets/default/push.yaml: learner.ddpg.tau is 2"
    ):
        load()


@pytest.mark.parametrize("text", ["a: [", "\t- x", "- 1\n- 2", "just text", "seed: 1\nseed: 2"])
def test_a_file_that_is_no_mapping_names_the_file(configs: Files, text: str) -> None:
    configs("algorithms/iher.yaml", text)
    with pytest.raises(UserError, match=r"configs/algorithms/iher\.yaml"):
        load()


@pytest.mark.parametrize(
    ("preset", "algo", "message"),
    [
        ("papr", "iher", "unknown preset 'papr', valid: default, paper; did you mean 'paper'"),
        ("default", "ihr", "unknown algorithm 'ihr', valid: iher; did you mean 'iher'"),
        ("../presets/default", "iher", "unknown preset"),
        ("default", "../algorithms/iher", "unknown algorithm"),
        ("nowhere/mine.yaml", "iher", "no preset file at nowhere/mine.yaml"),
    ],
)
def test_unknown_names_list_the_valid_ones(
    configs: Files, preset: str, algo: str, message: str
) -> None:
    with pytest.raises(UserError, match=message):
        load_config("push", preset=preset, algo=algo)


def test_a_preset_without_the_task_says_which_tasks_it_has(configs: Files) -> None:
    with pytest.raises(UserError, match=r"preset 'default' 'slide', valid: push"):
        load_config("slide")


def test_a_preset_may_be_a_users_file(configs: Files, tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("seed: 11")
    config = load_config("push", preset=str(mine))
    assert (config.seed, config.preset) == (11, str(mine))


def test_a_users_file_that_is_not_text_is_named(configs: Files, tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_bytes(b"\xff\xfe\x00seed")
    with pytest.raises(UserError, match=r"mine\.yaml"):
        load_config("push", preset=str(mine))


def test_settings_cannot_be_changed(configs: Files) -> None:
    config = load()
    with pytest.raises(ValidationError):
        config.seed = 3  # type: ignore[misc]


@settings(deadline=None, max_examples=50)
@given(
    gamma=st.floats(0, 1, exclude_max=True),
    seed=st.integers(0, 2**63 - 1),
    budget=st.floats(0, 1e6, exclude_min=True),
    hidden=st.lists(st.integers(1, 4096), max_size=4),
    until=st.none() | st.floats(0, 1, exclude_min=True),
    driver=st.text(),
    preset=st.text(min_size=1).map(lambda stem: f"{stem}x.yaml"),
)
@example(gamma=1e-05, seed=0, budget=1e6, hidden=[], until=None, driver="\x85", preset="\x85.yaml")
@example(gamma=0.5, seed=0, budget=5e-324, hidden=[1], until=1.0, driver="1e3", preset="paper")
def test_dumped_settings_read_back_exactly(
    tmp_path_factory: pytest.TempPathFactory,
    *,
    gamma: float,
    seed: int,
    budget: float,
    hidden: list[int],
    until: float | None,
    driver: str,
    preset: str,
) -> None:
    default = RunConfig()
    ddpg = default.learner.ddpg.model_copy(update={"gamma": gamma, "hidden": tuple(hidden)})
    config = default.model_copy(
        update={
            "learner": default.learner.model_copy(update={"ddpg": ddpg}),
            "seed": seed,
            "budget_minutes": budget,
            "until_success": until,
            "driver": driver,
            "preset": preset,
        }
    )
    path = tmp_path_factory.mktemp("config") / "config.yaml"
    path.write_text(dump_config(config), encoding="utf-8")
    assert read_config(path) == config


def test_the_dump_holds_every_key(configs: Files) -> None:
    values = yaml.safe_load(dump_config(load()))
    assert set(values) == set(RunConfig.model_fields)
    assert set(values["learner"]["ddpg"]) == set(DDPGConfig.model_fields)


@pytest.mark.parametrize("text", ["seed: -1", "sed: 1", "seed: [", "x"])
def test_a_damaged_config_file_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "config.yaml"
    path.write_text(text)
    with pytest.raises(UserError, match=r"config\.yaml"):
        read_config(path)


def test_a_config_file_must_have_every_key(tmp_path: Path) -> None:
    path = tmp_path / "config.yaml"
    lines = dump_config(RunConfig()).splitlines(keepends=True)
    for kept in range(len(lines)):
        path.write_text("".join(lines[:kept]))
        with pytest.raises(UserError, match=r"config\.yaml"):
            read_config(path)
    path.write_text("")
    with pytest.raises(UserError, match=r"config\.yaml has no task: it is damaged"):
        read_config(path)
    path.write_text("".join(line for line in lines if "gamma:" not in line))
    with pytest.raises(UserError, match=r"config\.yaml has no learner\.ddpg\.gamma: "):
        read_config(path)


@pytest.mark.parametrize("change", [{"algo": "hr"}, {"preset": "papr"}])
def test_a_config_file_must_name_existing_things(tmp_path: Path, change: dict[str, str]) -> None:
    path = tmp_path / "config.yaml"
    path.write_text(dump_config(RunConfig().model_copy(update=change)))
    with pytest.raises(UserError, match=r"config\.yaml: unknown (algorithm|preset) .*did you mean"):
        read_config(path)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("budget_minutes", 0.0, "--budget-minutes is 0.0, allowed: a finite number, above 0"),
        ("budget_minutes", np.float32("inf"), "--budget-minutes is inf, allowed: "),
        ("seed", -1, "--seed is -1, allowed: an integer, 0 or more"),
        ("device", "warp", "--device is 'warp', allowed: one of auto, cpu, cuda"),
        ("until_success", 0.0, "--until-success is 0.0, allowed: off or a finite number, above 0"),
        ("driver", 3, "--driver is 3, allowed: text"),
    ],
)
def test_a_bad_value_of_an_option_names_the_option(
    configs: Files, key: str, value: Any, message: str
) -> None:
    with pytest.raises(UserError, match=f"^{re.escape(message)}"):
        load_config("push", **{key: value})


def test_options_win_over_files_and_overrides_over_options(configs: Files) -> None:
    configs("presets/default/push.yaml", "seed: 3\ndriver: other\nuntil_success: 0.5")
    options: dict[str, Any] = {"seed": np.int64(4), "driver": "[1e3", "until_success": None}
    config = load_config("push", **options)
    assert (config.seed, config.driver, config.until_success) == (4, "[1e3", None)
    assert load_config("push", overrides=["seed=5"], **options).seed == 5


def test_the_robots_options_are_kept_as_they_were_read(configs: Files, tmp_path: Path) -> None:
    configs("robots/worn.yaml", "object: {mass_kg: 3e0, names: [a, 1]}\ndelay: null")
    kept = tmp_path / "config.yaml"
    kept.write_text(dump_config(load_config("push", robot="worn")))

    configs("robots/worn.yaml", "delay: 5")

    config = read_config(kept)
    assert config.robot == "worn"
    assert config.robot_options == {"object": {"mass_kg": 3.0, "names": ["a", 1]}, "delay": None}
    assert load_config("push").robot_options == {"actuation": "mocap"}


def test_a_robots_file_may_name_the_driver_unless_another_layer_does(
    configs: Files, tmp_path: Path
) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("driver: zenoh\nrobot: arm\n")

    config = load_config("push", robot=str(mine), connect=["tcp/a:1"])

    assert (config.driver, config.robot) == ("zenoh", str(mine))
    assert config.robot_options == {"robot": "arm", "connect": ["tcp/a:1"]}
    assert config.chosen_robot.command_options.endswith(" --connect tcp/a:1")
    for driver in ["driver=mujoco"], ["driver=other"]:
        with pytest.raises(UserError, match=r"mine\.yaml: driver is 'zenoh', but"):
            load_config("push", overrides=driver, robot=str(mine))
    load_config("push", overrides=["driver=zenoh"], robot=str(mine))


def test_the_default_robot_is_that_of_the_driver_wherever_it_was_named(configs: Files) -> None:
    configs("presets/default/push.yaml", "driver: other")
    config = load()
    assert (config.driver, config.robot, config.robot_options) == ("other", "", {})
    assert load("driver=mujoco").robot == "fetch"


def test_a_robot_of_infinite_mass_is_refused_by_name(configs: Files) -> None:
    configs("robots/heavy.yaml", "object: {mass_kg: .inf}")
    with pytest.raises(UserError, match=r"robot heavy: robot_options is .*inf.*finite numbers"):
        load_config("push", robot="heavy")


def shipped() -> list[tuple[str, str]]:
    presets = ROOT / "configs" / "presets"
    return sorted((file.parent.name, file.stem) for file in presets.glob("*/*.yaml"))


@pytest.mark.parametrize(("preset", "task"), shipped())
def test_every_shipped_preset_loads_with_every_algorithm(preset: str, task: str) -> None:
    algorithms = ROOT / "configs" / "algorithms"
    names = [file.stem for file in algorithms.glob("*.yaml")]
    assert names
    for algo in names:
        config = load_config(task, preset=preset, algo=algo)
        assert (config.task, config.preset, config.algo) == (task, preset, algo)
