"""Warm start: real episodes of earlier runs, copied into a new run's folder."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from iher_robot.errors import UserError
from iher_robot.storage.episode import StoredEpisode
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.episode_store import CUT_OFF, EpisodeStore
from iher_robot.storage.files.atomic import sync_directory
from iher_robot.storage.interface import require_same_interface


def check_sources(sources: Sequence[str], interface: Mapping[str, Any]) -> None:
    """Check that data can be used before anything is made.

    Args:
        sources: Run folders, or folders of episodes.
        interface: Of the run that is about to use them.

    Raises:
        UserError: They are missing, damaged, or of another task or robot.
    """
    for source in sources:
        directory = _episodes(source)
        require_same_interface(directory, interface)
        if next(_all_of(directory), None) is None:
            raise UserError(f"{source} holds no real episode to start from")


def copy_sources(sources: Sequence[str], target: Path) -> None:
    """Copy all their episodes into one store; a crash leaves all of it or nothing.

    Args:
        sources: Run folders, or folders of episodes.
        target: The store's folder; left alone if it exists.

    Raises:
        UserError: An episode is damaged, or the system refuses.
    """
    if target.exists() or not sources:
        return
    unfinished = target.with_name(f".{target.name}.tmp")
    shutil.rmtree(unfinished, ignore_errors=True)
    with EpisodeStore(unfinished) as store:
        for source in sources:
            for stored in _all_of(_episodes(source)):
                store.append(stored)
    unfinished.rename(target)
    sync_directory(target.parent)


def _all_of(directory: Path) -> Iterator[StoredEpisode]:
    """Every episode, and what is recorded of the one under way."""
    with EpisodeReader(directory) as reader:
        yield from reader
        if reader.running is not None and reader.running.ticks:
            yield reader.running.stored(CUT_OFF)


def _episodes(source: str) -> Path:
    inner = Path(source) / "episodes"
    return inner if inner.is_dir() else Path(source)
