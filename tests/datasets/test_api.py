"""``iher-robot data`` on intact runs, damaged runs, and runs in progress."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from iher_robot.datasets import verify as run_check
from iher_robot.datasets.api import ls, show, show_episode, verify
from iher_robot.datasets.run_reader import examine_store
from iher_robot.errors import UserError
from iher_robot.storage.episode import RecordedTick, StoredEpisode
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.files.checksum import add_zip_checksum
from iher_robot.storage.ledger import Ledger
from iher_robot.storage.run_directory import RunDirectory
from tests.run_folders import PERIOD_S, make_run, make_stored

EPISODES = [
    make_stored(0),
    make_stored(1, success=True, valid=(True, False, True, True)),
    make_stored(2, success=True, ended="the robot was stopped"),
    make_stored(3, account="evaluation", epoch=2, success=True, valid=(True,) * 3),
]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    make_run(tmp_path / "runs" / "first", EPISODES, seed=7)
    return tmp_path / "runs" / "first"


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def minutes(*episodes: StoredEpisode) -> str:
    return f"{sum(int(one.elapsed.sum()) for one in episodes) * PERIOD_S / 60.0:.2f} min"


def test_a_run_in_one_line(run: Path) -> None:
    (line,) = ls([run.parent])

    assert (line.path, line.problem) == (run, "")
    assert (line.task, line.robot, line.algo, line.preset, line.seed) == (
        *("reach", "mujoco fetch-mocap", "iher", "default"),
        7,
    )
    # An episode that was cut short did not succeed, even at the goal.
    assert (line.episodes, line.successes) == (4, 2)
    motion, evaluation = minutes(*EPISODES[:3]), minutes(EPISODES[3])
    assert line.robot_time == f"motion {motion}, evaluation {evaluation}"


def test_runs_are_found_in_folders_and_as_folders(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_run(run.parent / "second")
    (run.parent / "logs").mkdir()
    (run.parent / "log.txt").touch()
    second = run.parent / "second"

    assert [line.path for line in ls([run.parent])] == [run, second]
    assert [line.path for line in ls([second, run.parent])] == [second, run]
    monkeypatch.chdir(run.parent.parent)
    assert [line.path.name for line in ls()] == ["first", "second"]
    monkeypatch.chdir(run)
    assert ls() == ()
    assert [line.episodes for line in ls([Path()])] == [4]
    with pytest.raises(UserError, match="folder absent: No such file"):
        ls([Path("absent")])


def test_the_groups_add_up(run: Path) -> None:
    groups = show(run).groups

    assert [(group.account, group.epoch) for group in groups] == [("motion", 1), ("evaluation", 2)]
    for group, members in zip(groups, (EPISODES[:3], EPISODES[3:]), strict=True):
        episodes = [one.episode for one in members]
        assert group.episodes == len(members)
        assert group.ticks == sum(map(len, episodes))
        assert group.invalid_ticks == sum((~one.valid).sum() for one in episodes)
        assert group.clipped_ticks == sum(
            (one.valid & (one.actions != one.requested_actions).any(1)).sum() for one in episodes
        )
        # Only the last tick of a successful episode is at the goal.
        at_goal = sum(one.ended == "done" or "stopped" in one.ended for one in members[-2:])
        assert group.mean_return == pytest.approx((at_goal - group.ticks) / len(members))
    assert [group.successes for group in groups] == [1, 1]


def test_a_report_explains_the_numbers(run: Path) -> None:
    report = show(run)

    assert report.title == "reach on mujoco fetch-mocap, iher, default, seed 7"
    assert "10 numbers: gripper_pos 3 (m), fingers_pos 2 (m)" in report.facts["observation"]
    assert "gripper_vel 3 (m/tick)" in report.facts["observation"]
    assert report.facts["goal"] == "gripper_pos within 0.05 m"
    assert report.facts["provenance"].startswith("commit c0ffee and changes, started 2026-01-02")


def test_an_episode_tick_by_tick(run: Path) -> None:
    report = show_episode(run, 1)
    episode = EPISODES[1].episode

    np.testing.assert_array_equal(report.achieved, episode.observations[1:, :3])
    expected = np.linalg.norm(episode.observations[1:, :3] - episode.desired_goal, axis=1)
    np.testing.assert_allclose(report.distance, expected)
    assert report.distance[-1] == 0.0
    assert f"seed {EPISODES[1].seed}, done" in report.title
    for index in (-1, 4):
        with pytest.raises(UserError, match=rf"episode is {index}, allowed in .*first: 0 to 3"):
            show_episode(run, index)


def test_an_intact_run_has_no_problems(run: Path) -> None:
    make_run(run.parent / "second", [make_stored(9, valid=(True,))])

    assert verify([run]).summary() == "4 episodes, 19 ticks: no problems"
    assert verify([run, run.parent / "second"]).summary() == "5 episodes, 20 ticks: no problems"
    assert verify([run.parent / "second"]).summary() == "1 episode, 1 tick: no problems"


def test_reading_changes_nothing(run: Path) -> None:
    before = contents(run)
    ls([run])
    show(run)
    show_episode(run, 0)
    verify([run])

    after = contents(run)
    assert {path: after[path] for path in before} == before


def flip(path: Path, place: int) -> None:
    content = bytearray(path.read_bytes())
    content[place] ^= 0x10
    path.write_bytes(content)


def test_every_changed_byte_of_an_episode_is_found(run: Path) -> None:
    path = run / "episodes" / "episode-000002.npz"
    content = path.read_bytes()
    for place in np.random.default_rng(0).integers(len(content), size=40):
        flip(path, int(place))
        found = verify([run])
        assert len(found.problems) == 1
        assert str(path) in found.problems[0]
        assert found.summary().endswith("3 episodes, 13 ticks: 1 problem")
        path.write_bytes(content)


def forge_episode(run: Path) -> None:
    """An intact file that is not the one that was stored."""
    path = run / "episodes" / "episode-000002.npz"
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    arrays["valid"] = ~arrays["valid"]
    np.savez(path, allow_pickle=False, **arrays)
    path.write_bytes(add_zip_checksum(path.read_bytes()))


def swap_episodes(run: Path) -> None:
    folder = run / "episodes"
    shutil.copy(folder / "episode-000000.npz", folder / "episode-000001.npz")


def lose_episode(run: Path) -> None:
    (run / "episodes" / "episode-000001.npz").unlink()


def damage_index(run: Path) -> None:
    (run / "episodes" / "index.sqlite").write_bytes(b"no index" * 512)


def damage_ledger(run: Path) -> None:
    (run / "ledger.sqlite").write_bytes(b"no ledger" * 512)


def renew_ledger(run: Path) -> None:
    for path in run.glob("ledger.*"):
        path.unlink()
    with Ledger(run / "ledger.sqlite") as ledger, ledger.reserve("motion", 3) as entry:
        entry.settle(3)


def lose_ledger(run: Path) -> None:
    for path in run.glob("ledger.*"):
        path.unlink()


def change_config(run: Path) -> None:
    path = run / "config.yaml"
    path.write_bytes(path.read_bytes().replace(b"seed: 7", b"seed: 8"))


def lose_config(run: Path) -> None:
    (run / "config.yaml").unlink()


def change_provenance(run: Path) -> None:
    path = run / "provenance.json"
    path.write_bytes(path.read_bytes().replace(b"c0ffee", b"decade"))


def change_interface(run: Path) -> None:
    path = run / "episodes" / "interface.json"
    path.write_bytes(path.read_bytes().replace(b"reach", b"beach"))


def foreign_checkpoint(run: Path) -> None:
    (run / "checkpoint.pt").write_bytes(b"no checkpoint")


def foreign_policy(run: Path) -> None:
    (run / "policy.pt").write_bytes(b"no policy")


def metrics_of_more(run: Path) -> None:
    RunDirectory(run).append_metrics({"epoch": 1, "episodes": 5})


@pytest.mark.parametrize(
    ("damage", "file", "whole"),
    [
        (forge_episode, "episode-000002.npz is not the file that was stored", 3),
        (swap_episodes, "episode-000001.npz", 3),
        (lose_episode, "episode-000001.npz is missing", 3),
        (damage_index, "index.sqlite", 4),
        (damage_ledger, "ledger.sqlite", 4),
        (renew_ledger, "ledger.sqlite counts 3 ticks of motion, but 1", 4),
        (lose_ledger, "ledger.sqlite", 4),
        (change_config, "config.yaml", 4),
        (lose_config, "config.yaml", 4),
        (change_provenance, "provenance.json", 4),
        (change_interface, "interface.json", 4),
        (foreign_checkpoint, "checkpoint.pt", 4),
        (foreign_policy, "policy.pt", 4),
        (metrics_of_more, "metrics.jsonl reports 5 episodes of motion, but 3 are stored", 4),
    ],
)
def test_damage_is_found_and_names_the_file(
    run: Path, damage: Callable[[Path], None], file: str, whole: int
) -> None:
    damage(run)
    found = verify([run])

    assert found.problems
    assert any(file in problem for problem in found.problems)
    assert all(str(run) in problem and "\n" not in problem for problem in found.problems)
    assert found.episodes == whole
    assert len(found.problems) == len(set(found.problems))


@pytest.mark.parametrize("damage", [lose_episode, damage_index, lose_config, lose_ledger])
def test_a_damaged_run_is_listed_as_damaged(run: Path, damage: Callable[[Path], None]) -> None:
    make_run(run.parent / "second", EPISODES)
    damage(run)
    first, second = ls([run.parent])

    assert str(run) in first.problem
    assert (second.problem, second.episodes) == ("", 4)


def test_episodes_of_another_task_are_found(run: Path, tmp_path: Path) -> None:
    make_run(tmp_path / "push", [make_stored(0, task="push")], task="push")
    shutil.rmtree(run / "episodes")
    shutil.copytree(tmp_path / "push" / "episodes", run / "episodes")
    problems = " ".join(verify([run]).problems)

    assert "episode 0 of" in problems
    assert "of task 'push'" in problems
    assert "(25,)" in ls([run])[0].problem


def test_a_run_in_progress_can_be_read(run: Path) -> None:
    tick = EPISODES[0].episode
    recorded = RecordedTick(
        tick.observations[1], tick.actions[0], tick.requested_actions[0], True, 8, 1
    )
    with (
        Ledger(run / "ledger.sqlite") as ledger,
        EpisodeStore(run / "episodes") as store,
        ledger.reserve("motion", 50) as entry,
    ):
        store.begin(EPISODES[0].header, tick.observations[0], tick.desired_goal)
        entry.begin(1)
        store.record(recorded)
        before = ls([run])[0]
        assert verify([run]).summary() == "4 episodes, 19 ticks: no problems"
        store.seal("done")
        after = ls([run])[0]
        assert verify([run]).summary() == "5 episodes, 20 ticks: no problems"
        entry.settle(1)

    assert (before.problem, before.episodes) == ("", 4)
    assert (after.problem, after.episodes) == ("", 5)
    assert after.last_change >= before.last_change


def test_an_episode_reported_during_the_check_is_no_damage(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def then_goes_on(folder: Path) -> Iterator[StoredEpisode | UserError]:
        yield from examine_store(folder)
        RunDirectory(run).append_metrics({"epoch": 9, "episodes": 4})

    RunDirectory(run).append_metrics({"epoch": 8, "episodes": 3})
    monkeypatch.setattr(run_check, "examine_store", then_goes_on)
    assert verify([run]).problems == ()
    monkeypatch.undo()
    assert len(verify([run]).problems) == 1


def test_nothing_is_checked_if_one_folder_is_no_run(run: Path) -> None:
    damage_index(run)
    with pytest.raises(UserError, match=r"there is no run at .*absent"):
        verify([run, run / "absent"])
