"""A simulated robot behind a host, over loopback."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import pytest

from drivers import RobotDriver
from iher_robot.testing import DriverContract
from tests.served.served_robot import PATIENT, ServedRobot

pytestmark = pytest.mark.real_time


class TestServedFetch(DriverContract):
    real_time = True
    several = False
    kinds = ("joint",)
    overshoot, speed_error = 0.02, 0.01  # those of the robot behind it
    served: ClassVar[ServedRobot]

    @pytest.fixture(scope="class", autouse=True)
    @classmethod
    def _host(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        memory: Path = tmp_path_factory.mktemp("memory")
        with ServedRobot(memory, *PATIENT) as cls.served:
            yield

    def make_driver(self) -> RobotDriver:
        return self.served.driver()
