"""A run that begins with the data of earlier ones."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from iher_robot.errors import UserError
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.interface import keep_interface, read_interface
from iher_robot.training.display import TrainingDisplay
from iher_robot.training.train import resume, train
from tests.conftest import WholeRun
from tests.small_runs import (
    EPOCH_MINUTES,
    TINY,
    interruption,
    metrics,
    motion_ticks,
    run,
    stored_ticks,
)


@pytest.fixture(scope="module")
def earlier(whole_run: WholeRun) -> Path:
    return whole_run(2 * EPOCH_MINUTES)


def test_earlier_data_are_learned_from_before_the_robot_moves(
    tmp_path: Path, earlier: Path
) -> None:
    out = tmp_path / "run"
    another = shutil.copytree(earlier, tmp_path / "another")
    run(out, EPOCH_MINUTES, "evaluation.every_epochs=9", seed=5, from_data=[earlier, another])
    rows = metrics(out)
    assert [row["robot_minutes"] for row in rows] == pytest.approx([0.0, 100 / 1500])
    assert [row["real_transitions"] for row in rows] == [400, 500]
    assert [row["episodes"] for row in rows] == [0, 2]
    assert rows[0]["success"] >= 0.0
    assert motion_ticks(out) == stored_ticks(out) == 100, "they cost nothing and are kept apart"
    with EpisodeReader(out / "warm-start") as reader:
        assert [stored.seed for stored in reader][:4] == [stored.seed for stored in reader][4:]


def test_such_a_run_needs_nothing_else_and_resumes_as_if_it_had_not_stopped(
    tmp_path: Path, earlier: Path
) -> None:
    source = shutil.copytree(earlier, tmp_path / "source")
    run(tmp_path / "one", 2 * EPOCH_MINUTES, from_data=[source])
    with interruption(TrainingDisplay, "epoch", call=2):
        run(tmp_path / "two", 2 * EPOCH_MINUTES, from_data=[source])
    shutil.rmtree(source)
    resume(tmp_path / "two", display=False)
    assert metrics(tmp_path / "two") == metrics(tmp_path / "one")


def test_a_copy_that_was_cut_off_is_made_again(tmp_path: Path, earlier: Path) -> None:
    out = tmp_path / "run"
    with interruption(EpisodeStore, "append", call=2):
        run(out, EPOCH_MINUTES, from_data=[earlier])
    assert not (out / "warm-start").exists()
    resume(out, display=False)
    assert metrics(out)[0]["real_transitions"] == 200


def test_the_episode_under_way_of_a_killed_run_is_used_too(tmp_path: Path, earlier: Path) -> None:
    source = shutil.copytree(earlier, tmp_path / "source")
    with EpisodeReader(source / "episodes") as reader:
        first = reader.load(0)
    store = EpisodeStore(source / "episodes")
    store.begin(first.header, first.episode.observations[0], first.episode.desired_goal)
    for tick in first.ticks()[:7]:
        store.record(tick)
    store._index.close()
    store._lock.close()
    run(tmp_path / "run", EPOCH_MINUTES, from_data=[source])
    assert metrics(tmp_path / "run")[0]["real_transitions"] == 207


def test_data_of_another_task_are_refused_before_anything_is_made(
    tmp_path: Path, earlier: Path
) -> None:
    with pytest.raises(UserError, match="have task 'reach', this run needs 'push'"):
        train(task="push", out=tmp_path / "run", from_data=[earlier], overrides=TINY)
    with pytest.raises(UserError, match="have interface_digest"):
        train(task="reach", robot="fetch-mocap", out=tmp_path / "run", from_data=[earlier])
    with pytest.raises(UserError, match=r"names .*run twice"):
        train(task="reach", out=tmp_path / "run", from_data=[earlier, earlier])
    with pytest.raises(UserError, match="there is no interface file"):
        train(task="reach", out=tmp_path / "run", from_data=[tmp_path / "absent"])
    empty = tmp_path / "empty"
    keep_interface(empty, read_interface(earlier / "episodes"))
    EpisodeStore(empty).close()
    with pytest.raises(UserError, match="empty holds no real episode"):
        train(task="reach", out=tmp_path / "run", from_data=[empty])
    assert not (tmp_path / "run").exists()


def test_a_lost_copy_is_named(tmp_path: Path, earlier: Path) -> None:
    out = tmp_path / "run"
    run(out, EPOCH_MINUTES, from_data=[earlier])
    (out / "warm-start" / "episode-000001.npz").write_bytes(b"junk")
    with pytest.raises(UserError, match=r"warm-start/episode-000001\.npz"):
        resume(out, display=False)


def test_an_interface_is_kept_once(tmp_path: Path) -> None:
    interface = {"task": "reach", "layout_digest": "a", "interface_digest": "b"}
    keep_interface(tmp_path, interface)
    keep_interface(tmp_path, interface | {"more": 1})
    assert read_interface(tmp_path) == interface
    with pytest.raises(UserError, match="have layout_digest 'a', this run needs 'c'"):
        keep_interface(tmp_path, interface | {"layout_digest": "c"})
    (tmp_path / "interface.json").write_text("{}")
    with pytest.raises(UserError, match=r"interface\.json is no interface file"):
        keep_interface(tmp_path, interface)
