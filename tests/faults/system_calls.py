"""System calls of a program in order, as traced by strace."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

TRACED = "write,writev,pwrite64,pwritev,fsync,fdatasync,sendto,sendmsg,rename,renameat,renameat2"
_COMMAND = "q_target"
"""A field that only motion commands have, and strace shows as text."""
_CALL = re.compile(r"^(\d+) +(\w+)\((.*)$")
_RESUMED = re.compile(r"^(\d+) +<\.\.\. (\w+) resumed>(.*)$")
_OF_FILE = re.compile(r"^\d+<([^>]*)>")
_RENAMED = re.compile(r'"[^"]*", (?:AT_FDCWD, )?"([^"]*)"')
_UNFINISHED = "<unfinished ...>"


@dataclass(frozen=True)
class Call:
    """One relevant call.

    Attributes:
        kind: ``command`` for a sent command, ``write`` and ``sync`` of a file or folder, or
            ``rename`` to a path.
        path: Relative to the run's folder, ``.`` for the folder itself; empty for a command.
    """

    kind: str
    path: str = ""


def read_calls(trace: Path, run: Path) -> list[Call]:
    """Read a trace, with each call at the moment that matters for safety.

    A command is sent and a file is written when the call begins; a sync or a rename is done when
    the call returns.

    Args:
        trace: Output of ``strace -f -y``.
        run: Folder of a run; calls on other files are left out.
    """
    return list(_read(trace.read_text(errors="replace").splitlines(), str(run)))


def _read(lines: list[str], run: str) -> Iterator[Call]:
    begun: dict[str, Call | None] = {}
    for line in lines:
        resumed = _RESUMED.match(line)
        if resumed is not None:
            call = begun.pop(resumed[1], None)
            if call is not None and line.endswith("= 0"):
                yield call
            continue
        found = _CALL.match(line)
        if found is None:
            continue
        thread, name, rest = found.groups()
        call = _understand(name, rest, run)
        if call is not None and call.kind in ("sync", "rename"):
            if rest.endswith(_UNFINISHED):
                begun[thread] = call
            elif rest.endswith("= 0"):
                yield call
        elif call is not None:
            yield call


def _understand(name: str, rest: str, run: str) -> Call | None:
    if _COMMAND in rest:
        return Call("command")
    renames = name.startswith("rename")
    found = _RENAMED.search(rest) if renames else _OF_FILE.match(rest)
    if found is None or not (found[1] + "/").startswith(run + "/"):
        return None
    path = found[1][len(run) + 1 :] or "."
    if renames:
        return Call("rename", path)
    return Call("sync" if name in ("fsync", "fdatasync") else "write", path)
