"""The command line of ``iher-robot data``: what it prints, and its exit codes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from iher_robot.cli.app import main
from tests.run_folders import make_run, make_stored

Run = Callable[[str], tuple[object, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """Run the command line beside a folder ``runs`` with one run."""
    monkeypatch.chdir(tmp_path)
    make_run(Path("runs/[one]"), [make_stored(0, success=True), make_stored(1)], seed=7)

    def invoke(words: str) -> tuple[object, str, str]:
        with pytest.raises(SystemExit) as stopped:
            main(["data", *words.split()])
        printed = capsys.readouterr()
        return stopped.value.code, printed.out, printed.err

    return invoke


def damage(path: str) -> None:
    file = Path(path)
    file.write_bytes(file.read_bytes()[:-1] + b"?")


def row(text: str, name: str) -> list[str]:
    """The cells of a table's row, split at blanks."""
    return next(line.split()[1:] for line in text.splitlines() if line.split()[:1] == [name])


def test_a_list_of_runs(run: Run) -> None:
    code, out, _ = run("ls")

    assert code == 0
    cells = "reach mujoco fetch-mocap iher, default 7 2 motion 0.01 min 50%".split()
    assert row(out, "runs/[one]")[: len(cells)] == cells


def test_a_damaged_run_is_a_row_and_a_sentence(run: Run) -> None:
    damage("runs/[one]/episodes/episode-000001.npz")
    code, out, err = run("ls")

    assert (code, err) == (0, "")
    assert row(out, "runs/[one]")[0] == "damaged"
    assert "runs/[one] is damaged: runs/[one]/episodes/episode-000001.npz" in out


@pytest.mark.parametrize("words", ["ls empty", "ls"])
def test_no_run_is_one_sentence(run: Run, words: str) -> None:
    Path("runs").rename("elsewhere")
    Path("empty").mkdir()
    where = words.partition(" ")[2] or "runs"

    assert run(words) == (0, f"there is no run in {where}; iher-robot train creates one\n", "")


def test_what_the_data_are(run: Run) -> None:
    code, out, _ = run("show runs/[one]")
    assert code == 0
    assert row(out, "motion") == "1 2 12 0 2 -5.5 50%".split()
    assert "reach on mujoco fetch-mocap" in out

    code, out, _ = run("show runs/[one] 1")
    assert code == 0
    assert [row(out, str(tick))[1] for tick in range(6)] == ["yes"] * 6


def test_verify_exits_with_1_if_something_is_damaged(run: Run) -> None:
    assert run("verify runs/[one]") == (0, "2 episodes, 12 ticks: no problems\n", "")

    damage("runs/[one]/episodes/episode-000001.npz")
    code, out, err = run("verify runs/[one]")
    problem, total = out.splitlines()
    assert (code, err) == (1, "")
    assert "runs/[one]/episodes/episode-000001.npz" in problem
    assert total == "1 episode, 6 ticks: 1 problem"


def test_exports_say_what_they_wrote(run: Run) -> None:
    pytest.importorskip("minari", reason="comes with the data extra")
    code, out, _ = run("export runs/[one] --format parquet --out out.parquet")
    assert (code, out) == (0, "2 episodes, 12 ticks (0 of them not valid): out.parquet\n")
    assert Path("out.parquet").stat().st_size

    code, out, _ = run("export runs/[one] --format minari --dataset a/b-v0 --root data")
    assert code == 0
    assert "minari.load_dataset('a/b-v0')" in out
    assert f"MINARI_DATASETS_PATH={Path('data').absolute()}" in out
    assert Path("data/a/b-v0/data/main_data.hdf5").stat().st_size


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ("ls absent", ["folder absent", "No such file"]),
        ("ls runs/[one]/config.yaml", ["config.yaml", "Not a directory"]),
        ("show absent", ["no run at absent"]),
        ("show runs", ["no run at runs"]),
        ("show runs/[one] 2", ["episode is 2", "0 to 1"]),
        ("show runs/[one] two", ["EPISODE", "integer"]),
        ("verify", ["RUN"]),
        ("verify runs/[one] absent", ["no run at absent"]),
        ("export runs/[one]", ["--format"]),
        ("export runs/[one] --format hdf5", ["'hdf5'", "minari, parquet"]),
        ("export runs/[one] --format minari", ["needs --dataset"]),
        ("export runs/[one] --format minari --dataset b", ["--dataset is 'b'", "push-v0"]),
        ("export runs/[one] --format minari --dataset b-v0 --out o", ["--out is 'o'", "minari"]),
        ("export runs/[one] --format parquet", ["needs --out"]),
        ("export runs/[one] --format parquet --out o --root r", ["--root is 'r'", "parquet"]),
        ("export runs/[one] --format parquet --out runs", ["--out is runs", "folder"]),
        ("export runs/[one] --format parquet --out no/o", ["no folder no"]),
        ("export runs/[one] --format parquet --out o --account reset", ["'reset'", "evaluation"]),
        ("export runs/[one] absent --format parquet --out o", ["no run at absent"]),
        ("verfy runs/[one]", ["verfy", "verify"]),
    ],
)
def test_bad_input_gets_one_sentence(run: Run, words: str, parts: list[str]) -> None:
    before = sorted(Path().rglob("*"))
    code, out, err = run(words)

    assert (code, out) == (2, "")
    assert err.startswith("iher-robot: ")
    assert err.count("\n") == 1
    for part in parts:
        assert part in err
    assert {path for path in Path().rglob("*") if path.suffix[-4:] not in ("-shm", "-wal")} == {
        *before
    }


def test_no_command_prints_the_help(run: Run) -> None:
    code, out, _ = run("")
    assert code == 0
    assert all(command in out for command in ("ls", "show", "verify", "export"))
