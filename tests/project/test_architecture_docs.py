"""`docs/architecture.md`: every path on it exists, and every package is on it."""

from __future__ import annotations

import re

import pytest

from tests.repository import ROOT

PAGE = (ROOT / "docs" / "architecture.md").read_text()
PATHS = sorted(set(re.findall(r"`([\w./-]+(?:/|\.\w+))`", PAGE)) - {"policy.pt"})
PACKAGES = sorted(
    f"{folder.parent.relative_to(ROOT)}/"
    for name in ("iher_robot", "tasks", "drivers")
    for folder in (ROOT / name).rglob("__init__.py")
)


def test_paths_and_packages_are_found() -> None:
    assert len(PATHS) > 80
    assert {"iher_robot/learning/networks/", "drivers/", "tasks/"} <= set(PACKAGES)


@pytest.mark.parametrize("path", PATHS)
def test_every_path_on_the_page_exists(path: str) -> None:
    found = ROOT / path
    assert found.is_dir() if path.endswith("/") else found.is_file()


@pytest.mark.parametrize("package", PACKAGES)
def test_every_package_is_on_the_page(package: str) -> None:
    assert f"`{package}`" in PAGE


def test_the_picture_has_every_package_of_the_first_level() -> None:
    (picture,) = re.findall(r"```mermaid\n(.*?)```", PAGE, flags=re.DOTALL)
    first_level = {path.rstrip("/").split("/")[1] for path in PACKAGES if path.count("/") == 2}
    first_level = {name for name in first_level if (ROOT / "iher_robot" / name).is_dir()}
    assert set(re.findall(r"<b>(\w+)</b>", picture)) == first_level | {"tasks", "drivers"}
