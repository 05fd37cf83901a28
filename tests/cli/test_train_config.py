"""``iher-robot train --config``: all settings of a run from one file."""

from __future__ import annotations

from pathlib import Path

import pytest

from iher_robot.cli.app import main
from iher_robot.config.options import load_config
from iher_robot.config.run import dump_config, read_config
from tests.small_runs import EPOCH_MINUTES, TINY, metrics

TINY_RUN = ["--task", "reach", "--preset", "paper", "--seed", "4", "--device", "cpu"]
TINY_RUN += ["--budget-minutes", str(2 * EPOCH_MINUTES), "--until-success", "off"]
for setting in TINY:
    TINY_RUN += ["--set", setting]


def train(*options: str) -> object:
    with pytest.raises(SystemExit) as stopped:
        main(["train", "--quiet", *options])
    return stopped.value.code


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "config.yaml"
    path.write_text(dump_config(load_config("reach", budget_minutes=0.04)))
    return path


def assert_refused(capsys: pytest.CaptureFixture[str], said: str, *options: str) -> None:
    out = Path("out")

    assert train("--out", str(out), *options) == 2

    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("iher-robot: ")
    assert printed.err.count("\n") == 1, printed.err
    assert said in printed.err
    assert not out.exists()


def test_the_config_of_a_run_gives_the_same_run_to_the_last_digit(tmp_path: Path) -> None:
    first, again = tmp_path / "first", tmp_path / "again"

    assert train("--out", str(first), *TINY_RUN) == 0
    assert train("--out", str(again), "--config", str(first / "config.yaml")) == 0

    assert len(metrics(first)) >= 2
    assert metrics(again) == metrics(first)
    assert read_config(again / "config.yaml") == read_config(first / "config.yaml")


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("--seed", "0"), "--seed"),
        (("--task", "reach"), "--task"),
        (("--set", "seed=3"), "--set"),
        (("--preset", "paper", "--algo", "her", "--sync"), "--preset, --algo, --async"),
        (("--resume", "run"), "--out, --config"),
    ],
)
def test_other_settings_beside_a_config_are_refused(
    config: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    options: tuple[str, ...],
    named: str,
) -> None:
    monkeypatch.chdir(config.parent)
    assert_refused(capsys, f"leave out {named}", "--config", str(config), *options)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "there is no config file"),
        ("", "has no task"),
        ("task: [reach\n", "is not valid YAML"),
        ("- reach\n", "expected lines of 'key: value', not list"),
        ("task: reach\n", "it is damaged, or from another version of iher-robot"),
    ],
)
def test_a_missing_or_damaged_config_is_one_sentence(
    config: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    text: str | None,
    said: str,
) -> None:
    monkeypatch.chdir(config.parent)
    if text is None:
        config.unlink()
    else:
        config.write_text(text)
    assert_refused(capsys, said, "--config", str(config))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("task: reach\n", "task: juggle\n", "'juggle', valid: pick_and_place"),
        ("task: reach\n", "task: reach\nspeed: 3\n", "unknown key 'speed'"),
        ("budget_minutes: 0.04\n", "budget_minutes: -1\n", "budget_minutes is -1"),
        ("preset: default\n", "preset: defalt\n", "unknown preset 'defalt'"),
    ],
)
def test_a_bad_value_in_a_config_is_one_sentence(
    config: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    old: str,
    new: str,
    said: str,
) -> None:
    monkeypatch.chdir(config.parent)
    text = config.read_text()
    assert old in text
    config.write_text(text.replace(old, new))
    assert_refused(capsys, said, "--config", str(config))


def test_a_config_that_lost_its_end_is_one_sentence(
    config: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(config.parent)
    lines = config.read_text().splitlines(keepends=True)
    config.write_text("".join(lines[: len(lines) // 2]))
    assert_refused(capsys, f"{config} has no ", "--config", str(config))
