"""A checksum finds every change of a JSON object or a ZIP archive."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from iher_robot.errors import UserError
from iher_robot.storage.files.checksum import (
    add_checksum,
    add_zip_checksum,
    check_zip,
    dump_checked,
    load_checked,
)

VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    # A lone surrogate is no text: no JSON reader has to keep it.
    | st.text(st.characters(exclude_categories=["Cs"])),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("abc"), inner, max_size=3),
    max_leaves=6,
)
OBJECTS = st.dictionaries(st.text("abc", min_size=1), VALUES, max_size=4)


@given(content=OBJECTS)
def test_an_object_comes_back_however_it_is_laid_out(content: dict[str, Any]) -> None:
    line = dump_checked(content)
    assert b"\n" not in line
    pretty = json.dumps(add_checksum(content), indent=2).encode()
    for text in (line, pretty):
        assert load_checked(text, "a.json", "result file") == content


@given(content=OBJECTS, data=st.data())
def test_a_changed_byte_of_an_object_is_found(content: dict[str, Any], data: st.DataObject) -> None:
    line = bytearray(dump_checked(content))
    place = data.draw(st.integers(0, len(line) - 1))
    line[place] ^= data.draw(st.integers(1, 255))
    try:
        found = load_checked(bytes(line), "a.json", "result file")
    except UserError:
        return
    assert found == content, "only spaces or the spelling of a value may differ"


def archive() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        file.writestr("member", "content")
    return buffer.getvalue()


def test_an_archive_stays_readable_and_takes_one_checksum() -> None:
    checked = add_zip_checksum(archive())
    check_zip(checked, Path("a.npz"), "episode file")
    with zipfile.ZipFile(io.BytesIO(checked)) as file:
        assert file.read("member") == b"content"
    with pytest.raises(ValueError, match="without a comment"):
        add_zip_checksum(checked)


@given(data=st.data())
def test_a_changed_or_missing_byte_of_an_archive_is_found(data: st.DataObject) -> None:
    checked = add_zip_checksum(archive())
    place = data.draw(st.integers(0, len(checked) - 1))
    changed = bytearray(checked)
    changed[place] ^= data.draw(st.integers(1, 255))
    for wrong in (bytes(changed), checked[:place], archive(), b""):
        with pytest.raises(UserError, match=r"a\.npz is no episode file of iher-robot"):
            check_zip(wrong, Path("a.npz"), "episode file")
