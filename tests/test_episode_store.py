"""Stored episodes come back exactly, or an error names their file."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from iher_robot import durable_file
from iher_robot.episode_store import EpisodeStore, StoredEpisode
from iher_robot.errors import UserError
from iher_robot.learning.episode import Episode


def make_episode(seed: int, length: int = 6) -> Episode:
    rng = np.random.default_rng(seed)
    return Episode(
        observations=rng.normal(size=(length + 1, 5)),
        actions=rng.uniform(-1, 1, size=(length, 4)).astype(np.float32),
        requested_actions=rng.uniform(-1, 1, size=(length, 4)),
        valid=rng.random(length) < 0.8,
        desired_goal=rng.normal(size=3),
    )


def assert_same(stored: StoredEpisode, episode: Episode) -> None:
    for name in ("observations", "actions", "requested_actions", "valid", "desired_goal"):
        actual, expected = getattr(stored.episode, name), getattr(episode, name)
        assert actual.dtype == expected.dtype
        assert actual.tobytes() == expected.tobytes()
        assert actual.shape == expected.shape


@pytest.fixture
def store(tmp_path: Path) -> EpisodeStore:
    store = EpisodeStore(tmp_path / "episodes")
    for index in range(3):
        store.append(make_episode(index), epoch=index // 2, told_source=index % 2)
    return store


def test_episodes_come_back_exactly_and_in_order(store: EpisodeStore) -> None:
    reopened = EpisodeStore(store.directory)
    assert reopened.append(make_episode(3, length=1), epoch=7, told_source=0, account="reset") == 3

    loaded = list(reopened)

    assert [stored.index for stored in loaded] == [0, 1, 2, 3]
    assert [stored.epoch for stored in loaded] == [0, 0, 1, 7]
    assert [stored.told_source for stored in loaded] == [0, 1, 0, 0]
    assert [stored.account for stored in loaded] == ["motion", "motion", "motion", "reset"]
    for index, stored in enumerate(loaded):
        assert_same(stored, make_episode(index, length=1 if index == 3 else 6))


def test_any_program_with_numpy_reads_an_episode(store: EpisodeStore) -> None:
    with np.load(store.directory / "episode-000001.npz", allow_pickle=False) as file:
        np.testing.assert_array_equal(file["observations"], make_episode(1).observations)


def test_a_mutated_file_is_an_error_that_names_it(store: EpisodeStore) -> None:
    path = store.directory / "episode-000001.npz"
    content = path.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(300):
        place, flip = int(rng.integers(len(content))), int(rng.integers(1, 256))
        mutated = bytearray(content)
        mutated[place] ^= flip
        path.write_bytes(mutated)
        with pytest.raises(UserError, match=r"episode-000001\.npz"):
            store.load(1)


def test_a_truncated_file_is_an_error_that_names_it(store: EpisodeStore) -> None:
    path = store.directory / "episode-000001.npz"
    content = path.read_bytes()
    for length in (0, 1, 63, 64, 65, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:length])
        with pytest.raises(UserError, match=r"episode-000001\.npz"):
            store.load(1)


def test_foreign_files_are_errors_that_name_them(store: EpisodeStore) -> None:
    path = store.directory / "episode-000001.npz"
    np.savez(path, observations=np.zeros(3))
    with pytest.raises(UserError, match=r"episode-000001\.npz is no episode file"):
        store.load(1)

    path.write_bytes(durable_file.seal_zip(path.read_bytes()))
    with pytest.raises(UserError, match=r"episode-000001\.npz is no episode file"):
        store.load(1)

    damaged = bytearray((store.directory / "episode-000002.npz").read_bytes()[:-64])
    damaged[-2:] = b"\0\0"
    damaged[len(damaged) // 2] ^= 1
    path.write_bytes(durable_file.seal_zip(bytes(damaged)))
    with pytest.raises(UserError, match=r"episode-000001\.npz is no episode file"):
        store.load(1)

    shutil.copy(store.directory / "episode-000002.npz", path)
    with pytest.raises(UserError, match=r"episode-000001\.npz holds episode 2"):
        store.load(1)

    path.unlink()
    with pytest.raises(UserError, match=r"episode-000001\.npz"):
        store.load(1)


def test_a_gap_is_an_error_that_names_the_missing_file(store: EpisodeStore) -> None:
    (store.directory / "episode-000001.npz").unlink()
    with pytest.raises(UserError, match=r"episode-000001\.npz is missing"):
        EpisodeStore(store.directory)


def test_what_a_crash_left_half_written_is_no_episode(store: EpisodeStore) -> None:
    (store.directory / ".episode-000003.npz.tmp").write_bytes(b"half")
    (store.directory / "notes.txt").write_text("mine")
    reopened = EpisodeStore(store.directory)
    assert len(reopened) == 3
    assert sorted(path.name for path in store.directory.iterdir()) == [
        *(f"episode-00000{index}.npz" for index in range(3)),
        "notes.txt",
    ]


def test_a_full_disk_leaves_the_store_as_it_was(
    store: EpisodeStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(UserError, match=r"episode-000003\.npz: No space left"):
            store.append(make_episode(3), epoch=2, told_source=0)

    assert len(store) == 3
    assert store.append(make_episode(4), epoch=2, told_source=0) == 3
    assert_same(EpisodeStore(store.directory).load(3), make_episode(4))


def test_the_file_and_its_name_reach_the_disk_before_append_returns(
    store: EpisodeStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[str] = []
    fsync = os.fsync

    def record(descriptor: int) -> None:
        synced.append(Path(f"/proc/self/fd/{descriptor}").readlink().name)
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", record)
    store.append(make_episode(3), epoch=2, told_source=0)
    assert synced == [".episode-000003.npz.tmp", "episodes"]


def test_objects_are_not_stored(store: EpisodeStore) -> None:
    episode = make_episode(3)
    pickled = Episode(
        observations=episode.observations.astype(object),
        actions=episode.actions,
        requested_actions=episode.requested_actions,
        valid=episode.valid,
        desired_goal=episode.desired_goal,
    )
    with pytest.raises(ValueError, match="pickle"):
        store.append(pickled, epoch=0, told_source=0)
    assert len(EpisodeStore(store.directory)) == 3


@pytest.mark.parametrize("index", [-1, 3])
def test_an_index_outside_the_store(store: EpisodeStore, index: int) -> None:
    with pytest.raises(IndexError, match=f"episode {index} of 3"):
        store.load(index)


def test_a_folder_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=r"file/episodes"):
        EpisodeStore(tmp_path / "file" / "episodes")
