"""A file is replaced as a whole or not at all."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path
from typing import BinaryIO

import pytest

from iher_robot.errors import UserError
from iher_robot.storage.files.atomic import read_file, write_atomically


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(b"last good one")
    return path


def test_the_new_content_replaces_the_old(path: Path) -> None:
    write_atomically(path, lambda file: file.write(b"new"))
    assert path.read_bytes() == b"new"
    assert [file.name for file in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("error", [RuntimeError("half-way"), KeyboardInterrupt()])
def test_a_writer_that_fails_half_way_keeps_the_last_good_file(
    path: Path, error: BaseException
) -> None:
    def write(file: BinaryIO) -> None:
        file.write(b"ne")
        raise error

    with pytest.raises(type(error)):
        write_atomically(path, write)
    assert path.read_bytes() == b"last good one"
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_a_full_disk_keeps_the_last_good_file_and_is_named(path: Path) -> None:
    def write(file: BinaryIO) -> None:
        file.write(b"ne")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(UserError, match=r"cannot write .*checkpoint\.pt: No space left"):
        write_atomically(path, write)
    assert path.read_bytes() == b"last good one"
    assert [file.name for file in path.parent.iterdir()] == [path.name]


CRASH = """
import os, sys
from pathlib import Path
from iher_robot.storage.files.atomic import write_atomically

def write(file):
    file.write(b"ne")
    file.flush()
    os._exit(9)

write_atomically(Path(sys.argv[1]), write)
"""


def test_a_crash_while_writing_keeps_the_last_good_file(path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", CRASH, str(path)], check=False)
    assert done.returncode == 9
    assert path.read_bytes() == b"last good one"
    write_atomically(path, lambda file: file.write(b"new"))
    assert path.read_bytes() == b"new"
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_the_content_is_on_disk_before_the_name_and_the_name_after(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[str, bytes]] = []
    fsync = os.fsync

    def record(descriptor: int) -> None:
        seen.append((Path(f"/proc/self/fd/{descriptor}").readlink().name, path.read_bytes()))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", record)
    write_atomically(path, lambda file: file.write(b"new"))
    assert seen == [(".checkpoint.pt.tmp", b"last good one"), (path.parent.name, b"new")]


@pytest.mark.parametrize(
    ("name", "message"),
    [("absent", "no policy file at"), (".", "is a folder"), ("checkpoint.pt/x", "cannot read")],
)
def test_a_file_that_cannot_be_read_is_named(path: Path, name: str, message: str) -> None:
    with pytest.raises(UserError, match=message) as error:
        read_file(path.parent / name, "policy file")
    assert str(path.parent / name) in str(error.value)
