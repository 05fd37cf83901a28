"""A damaged file is an error that names it, or reads as before."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from iher_robot.config.run import read_config
from iher_robot.errors import UserError
from iher_robot.evaluation.policy_file import load_policy
from iher_robot.host.persistence import RobotMemory, RobotTotal
from iher_robot.storage.checkpoint import load_checkpoint
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.interface import keep_interface, read_interface
from iher_robot.storage.ledger import Ledger
from iher_robot.storage.provenance import read_provenance
from iher_robot.storage.run_directory import RunDirectory
from iher_robot.storage.run_result import read_result
from tests.conftest import WholeRun
from tests.in_place import as_if_left_there
from tests.small_runs import EPOCH_MINUTES
from tests.storage.test_episode_store import make_stored, record

MUTATIONS = int(os.environ.get("IHER_ROBOT_MUTATIONS", "60"))
"""Mutations of each kind of file; ``make faults`` runs 1,000."""
Mutation = Callable[[bytes, np.random.Generator], bytes]


def flip_a_bit(content: bytes, rng: np.random.Generator) -> bytes:
    place = int(rng.integers(len(content)))
    return (
        content[:place] + bytes([content[place] ^ 1 << int(rng.integers(8))]) + content[place + 1 :]
    )


def replace_a_byte(content: bytes, rng: np.random.Generator) -> bytes:
    place = int(rng.integers(len(content)))
    return content[:place] + rng.bytes(1) + content[place + 1 :]


def cut_off(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: int(rng.integers(len(content)))]


def zero_a_block(content: bytes, rng: np.random.Generator) -> bytes:
    place, size = int(rng.integers(len(content))), int(rng.choice([4, 64, 512, 4096]))
    zeroed = content[place : place + size]
    return content[:place] + bytes(len(zeroed)) + content[place + size :]


def leave_a_block_out(content: bytes, rng: np.random.Generator) -> bytes:
    place, size = int(rng.integers(len(content))), int(rng.choice([1, 64, 4096]))
    return content[:place] + content[place + size :]


def swap_two_blocks(content: bytes, rng: np.random.Generator) -> bytes:
    first, second = sorted(int(place) for place in rng.integers(len(content), size=2))
    size = min(int(rng.choice([1, 64, 4096])), second - first)
    one, other = content[first : first + size], content[second : second + size]
    if len(other) < size:
        return content
    return content[:first] + other + content[first + size : second] + one + content[second + size :]


def append_rubbish(content: bytes, rng: np.random.Generator) -> bytes:
    return content + rng.bytes(int(rng.integers(1, 100)))


MUTATORS: tuple[Mutation, ...] = (
    flip_a_bit,
    flip_a_bit,
    replace_a_byte,
    cut_off,
    zero_a_block,
    leave_a_block_out,
    swap_two_blocks,
    append_rubbish,
)


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory, whole_run: WholeRun) -> Path:
    """Files of a finished run and of killed processes."""
    folder = tmp_path_factory.mktemp("left")
    shutil.copytree(whole_run(EPOCH_MINUTES), folder / "run")
    killed = folder / "killed"
    killed.mkdir()
    ledger = Ledger(killed / "ledger.sqlite")
    for ticks in (50, 49):
        with ledger.reserve("motion", 50) as entry:
            entry.settle(ticks)
    ledger.grant(10)
    with ledger.reserve("motion", 50) as entry:
        entry.begin(7)
    store = EpisodeStore(killed / "episodes")
    for index in range(2):
        store.append(make_stored(index))
    record(store, make_stored(2), 4)
    keep_interface(killed / "episodes", {"task": "reach", "layout_digest": "a", "n": [1.5, 2]})
    total = RobotTotal(killed, "fetch")
    for _ in range(20):
        total.tick("motion")
    RobotMemory(killed).reserve_ticks(7)
    copied = folder / "as-killed"
    shutil.copytree(killed, copied)  # while they run: the state in which a kill would leave it
    for each in (total, store, ledger):
        each.close()
    return folder


def read_ledger(folder: Path) -> Any:
    with Ledger(folder / "ledger.sqlite") as ledger:
        return ledger.spent_ticks("motion"), ledger.granted_ticks, ledger.last_entry


def read_total(folder: Path) -> Any:
    with RobotTotal(folder, "fetch") as total:
        return total.spent()


def read_store(folder: Path) -> Any:
    with EpisodeStore(folder / "episodes") as store:
        return [stored.pack() for stored in store]


def read_episodes(folder: Path) -> Any:
    with EpisodeReader(folder / "episodes") as reader:
        running = reader.running
        so_far = None if running is None else running.stored("").pack()
        return [stored.pack() for stored in reader], so_far


def as_text(content: Any) -> str:
    return repr(content)


READERS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "as-killed/ledger.sqlite": ("ledger.sqlite", read_ledger),
    "as-killed/ledger.sqlite-wal": ("ledger.sqlite", read_ledger),
    "killed/ledger.sqlite": ("ledger.sqlite", read_ledger),
    "as-killed/total.sqlite-wal": ("total.sqlite", read_total),
    "as-killed/robot.json": ("robot.json", lambda folder: RobotMemory(folder).ticks),
    "as-killed/episodes/index.sqlite": ("index.sqlite", read_store),
    "as-killed/episodes/index.sqlite-wal": ("index.sqlite", read_store),
    "killed/episodes/index.sqlite": ("index.sqlite", read_episodes),
    "as-killed/episodes/episode-000001.npz": ("episode-000001.npz", read_store),
    "as-killed/episodes/interface.json": (
        "interface.json",
        lambda folder: read_interface(folder / "episodes"),
    ),
    "run/config.yaml": (
        "config.yaml",
        lambda folder: read_config(RunDirectory.open(folder).config_path),
    ),
    "run/provenance.json": (
        "provenance.json",
        lambda folder: read_provenance(folder / "provenance.json"),
    ),
    "run/result.json": ("result.json", lambda folder: read_result(folder / "result.json")),
    "run/checkpoint.pt": (
        "checkpoint.pt",
        lambda folder: as_text(load_checkpoint(folder / "checkpoint.pt")),
    ),
    "run/policy.pt": ("policy.pt", lambda folder: as_text(load_policy(folder / "policy.pt"))),
}


@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_named_or_reads_as_before(tmp_path: Path, left: Path, name: str) -> None:
    named, read = READERS[name]
    source = left / name.partition("/")[0]
    place = Path(name.partition("/")[2])
    content = (source / place).read_bytes()
    expected = read(copy_of(source, tmp_path / "whole"))
    rng = np.random.default_rng(0)
    refused = 0
    for number in range(MUTATIONS):
        mutate = MUTATORS[number % len(MUTATORS)]
        folder = copy_of(source, tmp_path / "mutated")
        (folder / place).write_bytes(mutate(content, rng))
        found, message = outcome(partial(read, folder))
        assert named in message if message else found == expected, (number, mutate, message)
        refused += bool(message)
    assert refused, "damage shows"


def outcome(read: Callable[[], Any]) -> tuple[Any, str]:
    """The content, or the message of the error."""
    try:
        return read(), ""
    except UserError as error:
        return None, str(error)


def test_damaged_metrics_are_named_or_end_earlier(tmp_path: Path) -> None:
    """A crash may cut off the last line; the checkpoint has all of them."""
    directory = RunDirectory(tmp_path)
    rows = [{"epoch": epoch, "success": epoch / 7, "loss": 0.1 * epoch} for epoch in range(1, 9)]
    directory.replace_metrics(rows)
    content = directory.metrics_path.read_bytes()
    rng = np.random.default_rng(0)
    for number in range(MUTATIONS):
        mutate = MUTATORS[number % len(MUTATORS)]
        directory.metrics_path.write_bytes(mutate(content, rng))
        found, message = outcome(directory.read_metrics)
        if message:
            assert "metrics.jsonl" in message
        else:
            assert found == rows[: len(found)], (number, mutate)


def copy_of(source: Path, target: Path) -> Path:
    """Copy a folder without files that no test here reads."""
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(source, target, ignore=shutil.ignore_patterns("tensorboard", "*.png"))
    return as_if_left_there(target)
