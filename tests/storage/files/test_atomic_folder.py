"""A folder is replaced as a whole, or stays as it was."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from iher_robot.errors import UserError
from iher_robot.storage.files.atomic import write_folder


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_a_folder_is_created_and_replaced(tmp_path: Path) -> None:
    for number in ("1", "2"):
        with write_folder(tmp_path / "a" / "b") as new:
            (new / "inner").mkdir()
            (new / "inner" / number).touch()
            assert not (tmp_path / "a" / "b" / "inner" / number).exists()
        assert names(tmp_path) == ["a", "a/b", "a/b/inner", f"a/b/inner/{number}"]
    assert (tmp_path / "a" / "b").stat().st_mode == (tmp_path / "a").stat().st_mode


def write(folder: Path, name: str, error: BaseException | None = None) -> None:
    with write_folder(folder) as new:
        (new / name).touch()
        if error is not None:
            raise error


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(errno.ENOSPC, "disk is full")])
def test_a_failure_leaves_the_old_content(
    tmp_path: Path, there: bool, error: BaseException
) -> None:
    if there:
        write(tmp_path / "a" / "b", "kept")
    before = names(tmp_path)

    with pytest.raises((KeyboardInterrupt, UserError)):
        write(tmp_path / "a" / "b", "half", error)

    assert names(tmp_path) == before


def test_a_folder_that_cannot_be_renamed_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "b", "kept")
    rename = Path.rename

    def refuse(self: Path, target: Path) -> Path:
        if self.name == "new":
            raise OSError(errno.EACCES, "Permission denied")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(UserError, match=r"cannot write .*b: Permission denied"):
        write(tmp_path / "b", "other")

    assert names(tmp_path) == ["b", "b/kept"]
