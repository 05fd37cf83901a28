"""Interface of real data: task, observation layout and robot, in one file next to them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from iher_robot.errors import UserError
from iher_robot.storage.files.atomic import read_file, write_atomically
from iher_robot.storage.files.checksum import add_checksum, load_checked

_NAME = "interface.json"
_MUST_AGREE = ("task", "layout_digest", "interface_digest")


def keep_interface(directory: Path, interface: Mapping[str, Any]) -> None:
    """Write the interface file of a data folder, or check the one that is there.

    Args:
        directory: Folder of the data; created if it does not exist.
        interface: From ``GoalRobotEnv.policy_interface``.

    Raises:
        UserError: The data are of another task or robot, or the file is damaged.
    """
    path = directory / _NAME
    if path.exists():
        require_same_interface(directory, interface)
        return
    try:
        directory.mkdir(exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot use episode folder {directory}: {error.strerror}") from error
    text = json.dumps(add_checksum(interface), indent=1) + "\n"
    write_atomically(path, lambda file: file.write(text.encode()))


def read_interface(directory: Path) -> dict[str, Any]:
    """Read the interface file of a data folder.

    Raises:
        UserError: It is missing or damaged.
    """
    path = directory / _NAME
    return load_checked(read_file(path, "interface file"), path, "interface file")


def require_same_interface(directory: Path, interface: Mapping[str, Any]) -> None:
    """Check that data fit a run.

    Args:
        directory: Folder of the data.
        interface: Interface of the run that is about to use them.

    Raises:
        UserError: Task, observation layout or robot interface differ.
    """
    found = read_interface(directory)
    for name in _MUST_AGREE:
        if found.get(name) != interface[name]:
            raise UserError(
                f"the data in {directory} have {name} {found.get(name)!r}, this run needs "
                f"{interface[name]!r}; use data of the same task and of a robot with the same "
                "interface"
            )
