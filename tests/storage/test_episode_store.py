"""Stored episodes are read back exactly, or an error names their file."""

from __future__ import annotations

import dataclasses
import errno
import os
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from iher_robot.errors import UserError
from iher_robot.learning.episode import Episode
from iher_robot.storage.episode import RecordedTick, StoredEpisode
from iher_robot.storage.episode_journal import EpisodeIndex
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.episode_store import CUT_OFF, EpisodeStore
from iher_robot.storage.files.checksum import add_zip_checksum
from iher_robot.storage.files.lock import FileHeld
from iher_robot.storage.files.sqlite import Database


def make_stored(seed: int, length: int = 6, **header: Any) -> StoredEpisode:
    rng = np.random.default_rng(seed)
    values: dict[str, Any] = {"epoch": seed // 2, "policy_source": seed % 2, "account": "motion"}
    return StoredEpisode(
        **(values | {"seed": 7 * seed, "entry": seed + 1} | header),
        index=0,
        ended="done",
        seqs=np.arange(length) + 100 * seed,
        elapsed=np.ones(length, dtype=np.int64),
        episode=Episode(
            observations=rng.normal(size=(length + 1, 5)),
            actions=rng.uniform(-1, 1, size=(length, 4)).astype(np.float32),
            requested_actions=rng.uniform(-1, 1, size=(length, 4)),
            valid=rng.random(length) < 0.8,
            desired_goal=rng.normal(size=3),
        ),
    )


def record(store: EpisodeStore, stored: StoredEpisode, count: int | None = None) -> None:
    """Run an episode's ticks through the journal, without its end."""
    episode = stored.episode
    store.begin(stored.header, episode.observations[0], episode.desired_goal)
    for tick in stored.ticks()[:count]:
        store.record(tick)


def assert_same(stored: StoredEpisode, expected: StoredEpisode, length: int | None = None) -> None:
    """Everything that was stored, or its first ticks."""
    assert stored.header == expected.header
    count = len(expected.episode) if length is None else length
    for name in ("observations", "actions", "requested_actions", "valid", "desired_goal"):
        ticks = {"observations": count + 1, "desired_goal": 3}.get(name, count)
        assert_equal(getattr(stored.episode, name), getattr(expected.episode, name)[:ticks])
    assert_equal(stored.seqs, expected.seqs[:count])
    assert_equal(stored.elapsed, expected.elapsed[:count])


def assert_equal(actual: NDArray[Any], expected: NDArray[Any]) -> None:
    assert actual.dtype == expected.dtype
    assert actual.tobytes() == expected.tobytes()
    assert actual.shape == expected.shape


@pytest.fixture
def store(tmp_path: Path) -> Iterator[EpisodeStore]:
    with EpisodeStore(tmp_path / "episodes") as store:
        for index in range(3):
            store.append(make_stored(index))
        yield store


def test_episodes_are_read_back_exactly_and_in_order(store: EpisodeStore) -> None:
    record(store, make_stored(3, length=1, account="evaluation", epoch=7))
    assert store.seal("stopped") == 3

    with EpisodeReader(store.directory) as reader:
        loaded = list(reader)

    assert [stored.index for stored in loaded] == [0, 1, 2, 3]
    assert [stored.ended for stored in loaded] == ["done", "done", "done", "stopped"]
    for index in range(3):
        assert_same(loaded[index], make_stored(index))
    assert_same(loaded[3], make_stored(3, length=1, account="evaluation", epoch=7))


def test_numpy_alone_reads_an_episode(store: EpisodeStore) -> None:
    with np.load(store.directory / "episode-000001.npz", allow_pickle=False) as file:
        np.testing.assert_array_equal(file["observations"], make_stored(1).episode.observations)


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

    path.write_bytes(add_zip_checksum(path.read_bytes()))
    with pytest.raises(UserError, match=r"episode-000001\.npz is no episode file"):
        store.load(1)

    damaged = bytearray((store.directory / "episode-000002.npz").read_bytes()[:-64])
    damaged[-2:] = b"\0\0"
    damaged[len(damaged) // 2] ^= 1
    path.write_bytes(add_zip_checksum(bytes(damaged)))
    with pytest.raises(UserError, match=r"episode-000001\.npz is no episode file"):
        store.load(1)

    shutil.copy(store.directory / "episode-000002.npz", path)
    with pytest.raises(UserError, match=r"episode-000001\.npz holds episode 2"):
        store.load(1)

    path.unlink()
    with pytest.raises(UserError, match=r"episode-000001\.npz"):
        store.load(1)


def test_another_episode_under_the_same_name_is_refused(store: EpisodeStore) -> None:
    other = dataclasses.replace(make_stored(9), index=1)
    store.path(1).write_bytes(other.pack())
    with pytest.raises(UserError, match=r"episode-000001\.npz is not the file that was stored"):
        store.load(1)


def test_a_gap_is_an_error_that_names_the_missing_file(store: EpisodeStore) -> None:
    store.close()
    (store.directory / "episode-000001.npz").unlink()
    for open_again in (EpisodeStore, EpisodeReader):
        with pytest.raises(UserError, match=r"episode-000001\.npz is missing"):
            open_again(store.directory)


@pytest.mark.parametrize("name", ["episode-000003.npz", "episode-000007.npz"])
def test_an_index_older_than_the_files_is_named(store: EpisodeStore, name: str) -> None:
    store.close()
    shutil.copy(store.path(2), store.directory / name)
    with pytest.raises(UserError, match=r"index\.sqlite .* restore the newest index"):
        EpisodeStore(store.directory)


def test_a_half_written_file_is_no_episode(store: EpisodeStore) -> None:
    store.close()
    (store.directory / ".episode-000003.npz.tmp").write_bytes(b"half")
    (store.directory / "notes.txt").write_text("mine")
    with EpisodeStore(store.directory) as reopened:
        assert len(reopened) == 3
    assert not (store.directory / ".episode-000003.npz.tmp").exists()
    assert (store.directory / "notes.txt").exists()


@pytest.mark.parametrize("count", [0, 1, 4])
def test_ticks_of_a_cut_off_episode_are_recovered(store: EpisodeStore, count: int) -> None:
    record(store, make_stored(3), count)
    crash(store)
    with EpisodeStore(store.directory) as again:
        assert len(again) == 3 + (count > 0)
        assert again.recovered == (3 if count else None)
        if count:
            assert_same(again.load(3), make_stored(3), count)
            assert again.load(3).ended == CUT_OFF
        again.append(make_stored(4))
    with EpisodeStore(store.directory) as once_more:
        assert once_more.recovered is None
        assert_same(once_more.load(len(once_more) - 1), make_stored(4))


def test_a_sealed_episode_missing_from_the_index_is_recovered(
    store: EpisodeStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(store, make_stored(3))
    monkeypatch.setattr(EpisodeIndex, "add", full)
    with pytest.raises(OSError, match="No space"):
        store.seal("done")
    monkeypatch.undo()
    crash(store)
    with EpisodeStore(store.directory) as again:
        assert_same(again.load(3), make_stored(3))
        assert again.load(3).ended == "done"


def test_a_reader_works_beside_a_writer(store: EpisodeStore) -> None:
    record(store, make_stored(3), 2)
    with EpisodeReader(store.directory) as reader:
        assert len(list(reader)) == 3
        assert reader.running is not None
        assert_same(reader.running.stored("so far"), make_stored(3), 2)
        store.seal("done")
        assert len(reader) == 3
    with EpisodeReader(store.directory) as reader:
        assert len(list(reader)) == 4


def test_a_tick_missing_from_the_journal_is_kept_if_its_episode_was_sealed(
    store: EpisodeStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(store, make_stored(3), 4)
    with monkeypatch.context() as patch:
        patch.setattr(Database, "execute", full)
        with pytest.raises(OSError, match="No space"):
            store.record(make_stored(3).ticks()[4])
        with pytest.raises(OSError, match="No space"):
            store.seal("lost")
    crash(store)
    with EpisodeStore(store.directory) as again:
        assert_same(again.load(3), make_stored(3), 5)
        assert again.load(3).ended == "lost"


def test_a_reader_sees_a_consistent_snapshot(store: EpisodeStore) -> None:
    stop, problems = threading.Event(), []

    def read() -> None:
        try:
            while not stop.is_set():
                with EpisodeReader(store.directory) as reader:
                    assert reader.running is None or reader.running.index == len(reader)
        except UserError as error:
            problems.append(error)

    thread = threading.Thread(target=read)
    thread.start()
    for _ in range(60):
        record(store, make_stored(3, length=2))
        store.seal("done")
    stop.set()
    thread.join(30.0)
    assert problems == []


def test_a_second_writer_is_refused(store: EpisodeStore) -> None:
    with pytest.raises(FileHeld, match="in use by another run"):
        EpisodeStore(store.directory)


def test_an_index_that_lost_entries_is_named(store: EpisodeStore) -> None:
    files = [store.directory / f"index.sqlite{suffix}" for suffix in ("", "-wal")]
    record(store, make_stored(3), 2)
    old = [file.read_bytes() for file in files]
    store.record(make_tick())
    crash(store)
    for file, content in zip(files, old, strict=True):
        file.write_bytes(content)
    with pytest.raises(UserError, match=r"index\.sqlite lost a part"):
        EpisodeStore(store.directory)


def make_tick() -> RecordedTick:
    return RecordedTick(np.zeros(5), np.zeros(4, np.float32), np.zeros(4), True, 1, 1)


def crash(store: EpisodeStore) -> None:
    """Close the store as a dying process does, without sealing."""
    store._index.close()
    store._lock.close()


def full(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_leaves_the_store_unchanged(
    store: EpisodeStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(store, make_stored(3))
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(UserError, match=r"episode-000003\.npz: No space left"):
            store.seal("done")

    assert len(store) == 3
    assert store.seal("done") == 3, "the journal still has it"
    assert_same(store.load(3), make_stored(3))


def test_the_file_and_its_name_reach_the_disk_before_append_returns(
    store: EpisodeStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[str] = []
    fsync = os.fsync

    def note(descriptor: int) -> None:
        synced.append(Path(f"/proc/self/fd/{descriptor}").readlink().name)
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", note)
    store.append(make_stored(3))
    assert synced == [".episode-000003.npz.tmp", "episodes"]


def test_objects_are_not_stored(store: EpisodeStore) -> None:
    stored = make_stored(3)
    objects = stored.episode.observations.astype(object)
    pickled = dataclasses.replace(
        stored, episode=dataclasses.replace(stored.episode, observations=objects)
    )
    with pytest.raises(ValueError, match="pickle"):
        store.append(pickled)
    with pytest.raises(ValueError, match="pickle"):
        store.begin(stored.header, objects[0], stored.episode.desired_goal)
    assert len(store) == 3


@pytest.mark.parametrize("index", [-1, 3])
def test_an_index_out_of_range_is_an_error(store: EpisodeStore, index: int) -> None:
    with pytest.raises(IndexError, match=f"episode {index} of 3"):
        store.load(index)


def test_a_folder_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match=r"file/episodes"):
        EpisodeStore(tmp_path / "file" / "episodes")
