"""Check that `drivers` and `tasks` are not shadowed by other packages of these names."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

_SITE = Path(__file__).resolve().parent.parent


def require_own_packages(*names: str) -> None:
    """Check that top-level packages resolve to the folder that holds `iher_robot`.

    Args:
        names: Packages that are installed with `iher_robot`, in the same folder.

    Raises:
        ImportError: A package is missing or resolves elsewhere; the message names the path.
    """
    for name in names:
        found = _location(name)
        if found == _SITE / name:
            continue
        if found is None:
            raise ImportError(
                f"iher_robot needs its package {name!r} at {_SITE / name}, which is missing: "
                "install iher-robot again",
                name=name,
            )
        raise ImportError(
            f"iher_robot needs its own package {name!r} at {_SITE / name}, but {found} comes "
            f"first on the import path and shadows it: rename {found}, or run Python from "
            "another folder, or with -P, which leaves the current folder off the path",
            name=name,
            path=str(found),
        )


def _location(name: str) -> Path | None:
    """Folder of the package, or file of the module, that `import name` gives."""
    loaded = sys.modules.get(name)
    spec = importlib.util.find_spec(name) if loaded is None else loaded.__spec__
    if spec is None:
        return None
    if spec.submodule_search_locations:
        return Path(next(iter(spec.submodule_search_locations))).resolve()
    return Path(spec.origin).resolve() if spec.origin else None
