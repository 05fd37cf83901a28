from __future__ import annotations

import sys
from importlib.metadata import EntryPoint
from types import ModuleType

import pytest

import drivers.registry
from drivers import UnknownDriver, driver_targets, make_driver
from tests.drivers.fake_robot import FakeRobot


def bring(monkeypatch: pytest.MonkeyPatch, *entries: tuple[str, str]) -> None:
    found = [EntryPoint(name, value, drivers.registry.GROUP) for name, value in entries]
    monkeypatch.setattr(drivers.registry, "entry_points", lambda group: found)


def make_fake(*, scene: str, **options: object) -> FakeRobot:
    assert scene == "push"
    return FakeRobot()


def test_the_built_in_driver_is_there_without_an_installation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bring(monkeypatch)
    assert make_driver("mujoco", scene="reach").spec.name == "fetch-mujoco-joint-reach"


def test_a_driver_of_another_package_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    package = ModuleType("foreign_robots")
    vars(package)["make_fake"] = make_fake
    monkeypatch.setitem(sys.modules, "foreign_robots", package)
    bring(monkeypatch, ("fake", "foreign_robots:make_fake"))
    assert isinstance(make_driver("fake", scene="push"), FakeRobot)


def test_the_metadata_may_name_the_built_in_driver_too(monkeypatch: pytest.MonkeyPatch) -> None:
    before = driver_targets()
    bring(monkeypatch, ("mujoco", "drivers.mujoco:make_fetch"))
    assert driver_targets() == before
    assert before["mujoco"] == "drivers.mujoco:make_fetch"


def test_two_packages_cannot_claim_one_name(monkeypatch: pytest.MonkeyPatch) -> None:
    bring(monkeypatch, ("mujoco", "foreign:Driver"))
    with pytest.raises(UnknownDriver, match=r"'mujoco' is claimed by .* and by foreign:Driver"):
        make_driver("mujoco", scene="push")


def test_an_error_inside_a_driver_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    bring(monkeypatch, ("broken", "no_such_module_at_all:Driver"))
    with pytest.raises(ModuleNotFoundError, match="no_such_module_at_all"):
        make_driver("broken", scene="push")


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(UnknownDriver, match=r"unknown driver 'mujco'.*did you mean 'mujoco'"):
        make_driver("mujco", scene="push")
