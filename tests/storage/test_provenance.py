"""Provenance of a result, which never claims a foreign commit."""

from __future__ import annotations

import importlib.metadata
import json
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import pytest

from iher_robot.errors import UserError
from iher_robot.storage.provenance import (
    collect_provenance,
    commit,
    read_provenance,
    write_provenance,
)


def git(folder: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    command = ["git", "-C", str(folder), *identity, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


@pytest.fixture
def package(tmp_path: Path) -> Path:
    package = tmp_path / "checkout" / "package"
    package.mkdir(parents=True)
    (package / "module.py").write_text("x = 1\n")
    git(package.parent, "init", "-q")
    git(package.parent, "add", ".")
    git(package.parent, "commit", "-q", "-m", "first")
    return package


def test_the_commit_and_whether_the_tree_differs(package: Path) -> None:
    head = git(package, "rev-parse", "HEAD")
    assert commit(package) == {"commit": head, "dirty": False}
    (package / "untracked.txt").touch()
    assert commit(package) == {"commit": head, "dirty": False}
    (package / "module.py").write_text("x = 2\n")
    assert commit(package) == {"commit": head, "dirty": True}


def test_a_package_installed_below_a_foreign_checkout_has_no_commit(package: Path) -> None:
    installed = package.parent / ".venv" / "site-packages" / "iher_robot"
    installed.mkdir(parents=True)
    (installed / "module.py").touch()
    assert commit(installed) == {"commit": "unknown", "dirty": None}


def test_without_git_the_commit_is_unknown(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    assert commit(package) == {"commit": "unknown", "dirty": None}


def test_provenance_is_json_and_names_versions_and_machine() -> None:
    started = datetime(2025, 1, 31, 12, 0, tzinfo=UTC)
    found = collect_provenance(["iher-robot", "train"], 3, started)
    assert json.loads(json.dumps(found)) == found
    assert (found["command"], found["seed"]) == (["iher-robot", "train"], 3)
    assert datetime.fromisoformat(found["started"]) == started
    assert found["versions"]["numpy"] == importlib.metadata.version("numpy")
    assert found["machine"]["cores"] >= 1


def test_a_resumption_is_added_to_the_first_start(tmp_path: Path) -> None:
    path = tmp_path / "provenance.json"
    for number in range(3):
        write_provenance(path, {"seed": number})
    assert read_provenance(path) == {"seed": 0, "resumed": [{"seed": 1}, {"seed": 2}]}
    assert json.loads(path.read_text())["resumed"] == [{"seed": 1}, {"seed": 2}]


@pytest.mark.parametrize("content", ["{", "[]", "3"])
def test_a_damaged_file_is_named(tmp_path: Path, content: str) -> None:
    path = tmp_path / "provenance.json"
    path.write_text(content)
    with pytest.raises(UserError, match=r"provenance\.json"):
        write_provenance(path, {"seed": 1})
    assert path.read_text() == content
