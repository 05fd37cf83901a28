"""Exports hold exactly the stored data, or are not written at all."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from iher_robot.datasets.api import export_minari, export_parquet
from iher_robot.datasets.minari import ROOT_VARIABLE
from iher_robot.env.goal_env import make_env
from iher_robot.errors import UserError
from iher_robot.storage.accounts import Account
from iher_robot.storage.episode import StoredEpisode
from iher_robot.storage.interface import keep_interface
from tests.repository import ROOT
from tests.run_folders import interface, make_run, make_stored, record_episode

minari = pytest.importorskip("minari", reason="comes with the data extra")
pytest.importorskip("h5py", reason="comes with the data extra")
pq = pytest.importorskip("pyarrow.parquet", reason="comes with the data extra")

VALID = st.lists(st.booleans(), min_size=1, max_size=7).map(tuple)
ACCOUNT: st.SearchStrategy[Account] = st.sampled_from(["motion", "evaluation"])
# At least one tick is valid: Minari has no empty datasets.
EPISODES = st.lists(st.tuples(VALID, ACCOUNT, st.booleans()), max_size=4).map(
    lambda drawn: [
        make_stored(index, valid=valid, account=account, success=success, epoch=index // 2)
        for index, (valid, account, success) in enumerate([((True,), "motion", False), *drawn])
    ]
)
FEW = settings(deadline=None, max_examples=20)


def load(root: Path, dataset: str) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(ROOT_VARIABLE, str(root))
        return minari.load_dataset(dataset)


def rows(path: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = pq.read_table(path).to_pylist()
    return found


@FEW
@given(episodes=EPISODES)
def test_parquet_holds_every_tick_exactly(
    tmp_path_factory: pytest.TempPathFactory, episodes: list[StoredEpisode]
) -> None:
    folder = tmp_path_factory.mktemp("export")
    stored = make_run(folder / "run", episodes)
    result = export_parquet([folder / "run"], out=folder / "ticks.parquet")
    table = pq.read_table(folder / "ticks.parquet")

    def column(name: str) -> Any:
        return np.array(table[name].to_pylist())

    def expected(of: Callable[[StoredEpisode], Any]) -> Any:
        return np.concatenate([of(one) for one in stored])

    def of_each(of: Callable[[StoredEpisode], Any]) -> Any:
        return expected(lambda one: np.array([of(one)] * len(one.episode)))

    assert result.ticks == table.num_rows == sum(len(one.episode) for one in stored)
    assert result.invalid_ticks == (~column("valid")).sum()
    for name, values in {
        "observation": expected(lambda one: one.episode.observations[:-1]),
        "next_observation": expected(lambda one: one.episode.observations[1:]),
        "action_applied": expected(lambda one: one.episode.actions),
        "action_requested": expected(lambda one: one.episode.requested_actions),
        "achieved_goal": expected(lambda one: one.episode.observations[1:, :3]),
        "desired_goal": of_each(lambda one: one.episode.desired_goal),
        "valid": expected(lambda one: one.episode.valid),
        "seq": expected(lambda one: one.seqs),
        "elapsed": expected(lambda one: one.elapsed),
        "tick": expected(lambda one: np.arange(len(one.episode))),
        **{
            name: of_each(lambda one, name=name: getattr(one, name))  # type: ignore[misc]
            for name in ("epoch", "account", "seed", "ended")
        },
        "told_source": of_each(lambda one: one.policy_source),
        "episode": of_each(lambda one: one.index),
        "run": of_each(lambda one: "run"),
    }.items():
        np.testing.assert_array_equal(column(name), values, err_msg=name)
    reached = np.linalg.norm(column("achieved_goal") - column("desired_goal"), axis=1) < 0.05
    np.testing.assert_array_equal(column("success"), reached)
    np.testing.assert_array_equal(column("reward"), np.where(reached, 0.0, -1.0))


@FEW
@given(episodes=EPISODES)
def test_minari_holds_every_valid_tick_exactly_and_no_transition_spans_another(
    tmp_path_factory: pytest.TempPathFactory, episodes: list[StoredEpisode]
) -> None:
    folder = tmp_path_factory.mktemp("export")
    stored = make_run(folder / "run", episodes)
    result = export_minari([folder / "run"], dataset="test/reach-v0", root=folder / "datasets")
    dataset = load(folder / "datasets", "test/reach-v0")
    # Episodes of Minari, as the learner cuts them.
    cut = [(one, segment) for one in stored for segment in one.episode.segments()]
    metadata = list(dataset.storage.get_episode_metadata(range(len(cut))))

    assert dataset.total_episodes == result.episodes == len(cut)
    assert (
        dataset.total_steps == result.ticks == sum(int(one.episode.valid.sum()) for one in stored)
    )
    assert result.left_out_ticks == sum(int((~one.episode.valid).sum()) for one in stored)
    for number, (one, segment) in enumerate(cut):
        found, meta = dataset[number], metadata[number]
        np.testing.assert_array_equal(found.observations["observation"], segment.observations)
        np.testing.assert_array_equal(
            found.observations["achieved_goal"], segment.observations[:, :3]
        )
        assert (found.observations["desired_goal"] == segment.desired_goal).all()
        np.testing.assert_array_equal(found.actions, segment.actions)
        assert found.actions.dtype == dataset.action_space.dtype
        np.testing.assert_array_equal(
            found.infos["action_requested"][1:], segment.requested_actions
        )
        assert np.isnan(found.infos["action_requested"][0]).all()
        assert not found.terminations.any()
        np.testing.assert_array_equal(np.flatnonzero(found.truncations), [len(segment) - 1])
        np.testing.assert_array_equal(found.rewards, found.infos["is_success"][1:] - 1.0)
        # Which ticks of the stored episode they are.
        ticks = found.infos["tick"]
        np.testing.assert_array_equal(one.episode.observations[ticks], segment.observations)
        np.testing.assert_array_equal(found.infos["seq"][1:], one.seqs[ticks[1:] - 1])
        assert (np.diff(found.infos["seq"]) == 1).all()
        assert (meta["run"], meta["stored_episode"]) == ("run", one.index)
        assert (meta["account"], meta["epoch"]) == (one.account, one.epoch)
        assert (meta["told_source"], meta["ended"]) == (one.policy_source, one.ended)
        assert meta.get("seed") == (one.seed if ticks[0] == 0 else None)


IN_A_NEW_PROCESS = """
import json, sys, minari
dataset = minari.load_dataset("push-v3")
env = dataset.recover_environment()
spaces = (dataset.observation_space, dataset.action_space)
same = spaces == (env.observation_space, env.action_space)
metadata = next(iter(dataset.storage.get_episode_metadata([0])))
start, _ = env.reset(seed=metadata["seed"])
recorded = {name: values[0].tolist() for name, values in dataset[0].observations.items()}
print(json.dumps([same, recorded == {name: values.tolist() for name, values in start.items()},
    env.unwrapped.robot_spec.interface_digest, env.spec.max_episode_steps,
    dataset.recover_environment(eval_env=True).spec.id]))
"""


def test_a_new_process_loads_the_dataset_and_its_environment(tmp_path: Path) -> None:
    with make_env("push", actuation="mocap") as env:
        make_run(tmp_path / "run", [record_episode(env, seed=3, ticks=5)], task="push")
    export_minari([tmp_path / "run"], dataset="push-v3", root=tmp_path / "datasets")

    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", IN_A_NEW_PROCESS],
        env={**os.environ, ROOT_VARIABLE: str(tmp_path / "datasets")},
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )

    assert done.returncode == 0, done.stderr
    digest = interface("push", "fetch-mocap")["interface_digest"]
    assert json.loads(done.stdout) == [True, True, digest, 50, "iher_robot/Push-v0"]


def test_metadata_explain_the_numbers_and_their_provenance(tmp_path: Path) -> None:
    make_run(tmp_path / "run", [make_stored(0)], seed=5)
    export_minari([tmp_path / "run"], dataset="reach-v0", root=tmp_path)
    export_parquet([tmp_path / "run"], out=tmp_path / "reach.parquet")
    of_minari = load(tmp_path, "reach-v0").storage.metadata
    of_parquet = json.loads(pq.read_schema(tmp_path / "reach.parquet").metadata[b"iher_robot"])
    known = interface("reach", "fetch-mocap")

    assert of_minari["iher_robot"] == of_parquet
    assert of_parquet["layout"] == known["layout"]
    assert of_parquet["layout_digest"] == known["layout_digest"]
    assert of_parquet["units"]["gripper_vel"] == "m/tick"
    assert (of_parquet["goal"], of_parquet["threshold_m"]) == ("gripper_pos", 0.05)
    (of_run,) = of_parquet["runs"].values()
    assert (of_run["seed"], of_run["algo"], of_run["driver"]) == (5, "iher", "mujoco")
    assert of_run["interface_digest"] == known["interface_digest"]
    assert of_run["action"]["position_scale_m"] == known["spec"]["action"]["position_scale_m"]
    assert of_run["provenance"]["commit"] == "c0ffee"
    assert of_minari["algorithm_name"] == "iher (preset default)"
    assert "c0ffee" in of_minari["code_permalink"]


def test_several_runs_and_one_account(tmp_path: Path) -> None:
    one, two = tmp_path / "a" / "run", tmp_path / "b" / "run"
    three = tmp_path / "three"
    make_run(one, [make_stored(0), make_stored(1, account="evaluation")])
    make_run(two, [make_stored(2, account="evaluation")])
    make_run(three, [make_stored(3)])
    out, runs = tmp_path / "out.parquet", [one, two, three]

    def exported(account: str) -> list[tuple[str, int]]:
        export_parquet(runs, out=out, account=account, overwrite=True)
        return [(row["run"], row["episode"]) for row in rows(out) if row["tick"] == 0]

    # Runs whose folders have the same name are named by their paths.
    assert exported("all") == [(str(one), 0), (str(one), 1), (str(two), 0), ("three", 0)]
    assert exported("evaluation") == [(str(one), 1), (str(two), 0)]
    result = export_minari(runs, dataset="reach-v0", root=tmp_path, account="motion")
    assert result.episodes == 2


def visible(folder: Path) -> list[Path]:
    """All paths below a folder, except SQLite's temporary files."""
    return [path for path in sorted(folder.rglob("*")) if path.suffix[-4:] not in ("-shm", "-wal")]


def fail(tmp_path: Path, runs: Sequence[Path], *parts: str, account: str = "all") -> None:
    """Check that both exports refuse with this message and leave nothing."""
    before = visible(tmp_path)
    exports: list[Callable[[], object]] = [
        lambda: export_parquet(runs, out=tmp_path / "out.parquet", account=account),
        lambda: export_minari(runs, dataset="a/b-v0", root=tmp_path / "new", account=account),
    ]
    for export in exports:
        with pytest.raises(UserError) as refused:
            export()
        for part in parts:
            assert part in str(refused.value)
    assert visible(tmp_path) == before


def test_runs_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    reach, push, again = tmp_path / "reach", tmp_path / "push", tmp_path / "again"
    make_run(reach, [make_stored(0)])
    make_run(push, [make_stored(0, task="push")], task="push")
    make_run(again, [make_stored(1)])
    path = again / "episodes" / "interface.json"
    path.unlink()
    other = interface("reach", "fetch-mocap")
    action = {**other["spec"]["action"], "position_scale_m": 0.01}
    keep_interface(path.parent, {**other, "spec": {**other["spec"], "action": action}})
    make_run(tmp_path / "empty")
    fail(tmp_path, [reach, push], "of task 'reach'", "of 'push'", "separately")
    fail(tmp_path, [reach, again], "different things", "0.05", "0.01")
    fail(tmp_path, [reach, tmp_path / "." / "reach"], "given 2 times")
    fail(tmp_path, [tmp_path / "empty"], "no episode")
    fail(tmp_path, [reach], "no episode of account 'evaluation'", account="evaluation")
    fail(tmp_path, [reach], "unknown account 'motoin'", "'motion'", account="motoin")
    fail(tmp_path, [reach, tmp_path / "absent"], "no run at")


def test_a_damaged_run_leaves_earlier_exports_and_nothing_half_written(tmp_path: Path) -> None:
    run, out, root = tmp_path / "run", tmp_path / "kept.parquet", tmp_path / "datasets"
    make_run(run, [make_stored(seed) for seed in range(3)])
    export_parquet([run], out=out)
    export_minari([run], dataset="a/b-v0", root=root)
    file, data = out.read_bytes(), load(root, "a/b-v0")[2].actions
    (run / "episodes" / "episode-000002.npz").write_bytes(b"damaged")

    with pytest.raises(UserError, match=r"episode-000002\.npz"):
        export_parquet([run], out=out, overwrite=True)
    with pytest.raises(UserError, match=r"episode-000002\.npz"):
        export_minari([run], dataset="a/b-v0", root=root, overwrite=True)

    assert out.read_bytes() == file
    np.testing.assert_array_equal(load(root, "a/b-v0")[2].actions, data)
    assert [path.name for path in (root / "a").iterdir()] == ["b-v0"]
    assert not list(tmp_path.glob(".*"))
    fail(tmp_path, [run], "episode-000002.npz")


def test_an_existing_export_is_replaced_only_with_overwrite(tmp_path: Path) -> None:
    first, second, out = tmp_path / "first", tmp_path / "second", tmp_path / "out.parquet"
    make_run(first, [make_stored(0)])
    make_run(second, [make_stored(1), make_stored(2)])
    export_parquet([first], out=out)
    export_minari([first], dataset="b-v0", root=tmp_path)

    with pytest.raises(UserError, match=r"out\.parquet already exists; .*--overwrite"):
        export_parquet([second], out=out)
    with pytest.raises(UserError, match=r"b-v0 already exists; .*--overwrite"):
        export_minari([second], dataset="b-v0", root=tmp_path)
    assert {row["run"] for row in rows(out)} == {"first"}
    assert load(tmp_path, "b-v0").total_episodes == 1

    export_parquet([second], out=out, overwrite=True)
    export_minari([second], dataset="b-v0", root=tmp_path, overwrite=True)
    assert {row["run"] for row in rows(out)} == {"second"}
    assert load(tmp_path, "b-v0").total_episodes == 2


def test_a_folder_that_is_no_dataset_is_never_replaced(tmp_path: Path) -> None:
    make_run(tmp_path / "run", [make_stored(0)])
    (tmp_path / "b-v0").mkdir()
    (tmp_path / "b-v0" / "thesis.tex").touch()

    with pytest.raises(UserError, match="b-v0 exists and is no dataset"):
        export_minari([tmp_path / "run"], dataset="b-v0", root=tmp_path, overwrite=True)
    assert (tmp_path / "b-v0" / "thesis.tex").exists()


def test_no_valid_tick_is_no_dataset(tmp_path: Path) -> None:
    make_run(tmp_path / "run", [make_stored(0, valid=(False, False))])

    with pytest.raises(UserError, match="no tick of these episodes is valid"):
        export_minari([tmp_path / "run"], dataset="b-v0", root=tmp_path / "new")
    assert not (tmp_path / "new").exists()
    assert export_parquet([tmp_path / "run"], out=tmp_path / "o.parquet").invalid_ticks == 2


@pytest.mark.parametrize(
    "name", ["", "push", "push-v", "push v0", "../push-v0", "/push-v0", "ü-v0"]
)
def test_a_name_that_minari_would_not_load_is_refused(tmp_path: Path, name: str) -> None:
    make_run(tmp_path / "run", [make_stored(0)])
    with pytest.raises(UserError, match=r"--dataset is .*, such as push-v0"):
        export_minari([tmp_path / "run"], dataset=name, root=tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_real_robot_is_not_recovered_from_a_dataset(tmp_path: Path) -> None:
    make_run(tmp_path / "run", [make_stored(0)], robot="fetch-mocap")
    config = tmp_path / "run" / "config.yaml"
    config.write_text(config.read_text().replace("driver: mujoco", "driver: zenoh"))
    export_minari([tmp_path / "run"], dataset="b-v0", root=tmp_path)
    dataset = load(tmp_path, "b-v0")

    with pytest.raises(ValueError, match="env_spec is None"):
        dataset.recover_environment()
    with dataset.recover_environment(eval_env=True) as env:
        assert env.unwrapped.robot_spec.name.startswith("fetch-mujoco")


def test_a_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_run(tmp_path / "run", [make_stored(0)])
    for name in ("minari", "pyarrow"):
        monkeypatch.setitem(sys.modules, name, None)
    fail_parts = ("the extra 'data'", "pip install 'iher-robot[data]'")

    fail(tmp_path, [tmp_path / "run"], *fail_parts)
