"""Paths in a settings file are found from its folder, wherever a command runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.remote.certificates import TlsFiles
from iher_robot.config.paths import TLS_PATHS, resolve_paths

KEYS = ("users", *TLS_PATHS)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)
NAMES = st.sampled_from(["users", "ca", "key", "tls", "robot"]) | st.text()


def test_every_file_of_a_tls_section_is_a_path() -> None:
    assert sorted(TLS_PATHS) == sorted(f"tls.{name}" for name in TlsFiles.model_fields)


def test_a_relative_path_is_from_the_folder_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    settings = {"users": "secret/users", "tls": {"ca": "/etc/ca.pem", "key": "../k", "more": "m"}}
    for file in ("mine/host.yaml", tmp_path / "mine/host.yaml"):
        assert resolve_paths(settings, file, KEYS) == {
            "users": str(tmp_path / "mine/secret/users"),
            "tls": {"ca": "/etc/ca.pem", "key": str(tmp_path / "mine/../k"), "more": "m"},
        }


@given(settings=st.dictionaries(NAMES, VALUES | st.dictionaries(NAMES, VALUES)))
def test_nothing_else_changes(settings: dict[str, Any]) -> None:
    resolved = resolve_paths(settings, "/folder/file.yaml", KEYS)
    assert resolve_paths(resolved, "/elsewhere/file.yaml", KEYS) == resolved, "all are absolute"
    assert resolve_paths(settings, "/folder/file.yaml", ()) == settings
    assert resolved.keys() == settings.keys()
    for name, value in settings.items():
        if name == "users" and isinstance(value, str):
            assert resolved[name] == str(Path("/folder", value))
        elif name != "tls":
            assert resolved[name] == value
