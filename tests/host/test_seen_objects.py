"""Object poses that a host takes from another publisher."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers import InvalidRequest, SimulatedClock
from drivers.remote.messages import ObjectMessage
from iher_robot.host.persistence import RobotMemory
from iher_robot.host.served_robot import ServedRobot
from tests.drivers.fake_robot import FakeRobot


def pose(n: int, **changes: object) -> ObjectMessage:
    content: dict[str, object] = {"n": n, "age_s": 0.0, "frame": "world"}
    content |= {"pos": np.array([0.6, 0.5, 0.4]), "quat": np.array([1.0, 0.0, 0.0, 0.0])}
    content |= {"linvel": np.zeros(3), "angvel": np.zeros(3)}
    return ObjectMessage.model_validate(content | changes)


@pytest.mark.parametrize("field", ["pos", "quat", "linvel", "angvel"])
def test_a_pose_that_is_not_finite_is_refused_and_the_last_one_stays(
    tmp_path: Path, field: str
) -> None:
    clock = SimulatedClock(10**9)
    memory = RobotMemory(tmp_path)
    robot = ServedRobot(lambda _: FakeRobot(), "push", memory, ("object0",), clock)
    robot.open()
    robot.take_pose("object0", pose(1))
    broken = getattr(pose(2), field).copy()
    broken[-1] = np.nan
    with pytest.raises(InvalidRequest, match=field):
        robot.take_pose("object0", pose(2, **{field: broken}))
    assert np.array_equal(robot.state().objects["object0"].pos, pose(1).pos)
    robot.close()
