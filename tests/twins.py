"""Two simulators, of which the second runs the mirrored or shifted motion of the first."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np
from numpy.typing import NDArray

from drivers.mujoco import MujocoDriver
from iher_robot.env.goal_env import GoalRobotEnv, make_env
from tasks.symmetry import PlaneMap
from tasks.tabletop import OBJECT

Array = NDArray[np.float64]

SETTLE_TICKS = 15
"""Ticks in which the second gripper moves by the shift."""


def simulation(env: GoalRobotEnv) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Model and state of a simulator, to look at."""
    assert isinstance(env.driver, MujocoDriver)
    return env.driver._model, env.driver._data


def object_state(env: GoalRobotEnv) -> tuple[Array, Array]:
    """Pose and velocity of the object's free joint. ``(7,)``, ``(6,)``"""
    model, data = simulation(env)
    joint = model.joint(f"{OBJECT}:joint")
    place, speed = joint.qposadr[0], joint.dofadr[0]
    return data.qpos[place : place + 7].copy(), data.qvel[speed : speed + 6].copy()


def put_object(env: GoalRobotEnv, pose: Array, velocity: Array) -> Array:
    """Set pose and velocity of the object; the robot stays. Returns the observation."""
    assert isinstance(env.driver, MujocoDriver)
    model, data = env.driver._model, env.driver.snapshot()
    joint = model.joint(f"{OBJECT}:joint")
    place, speed = joint.qposadr[0], joint.dofadr[0]
    data.qpos[place : place + 7], data.qvel[speed : speed + 6] = pose, velocity
    mujoco.mj_forward(model, data)
    env.driver.restore(data)
    env._state = env.driver.read()
    return np.asarray(env.task.observation(env._state))


def touched(env: GoalRobotEnv) -> bool:
    """Whether a part of the robot touches the object."""
    model, data = simulation(env)
    thing, robot = model.body(OBJECT).id, model.body("robot0:gripper_link").rootid[0]
    bodies = model.geom_bodyid[data.contact.geom]  # (contacts, 2)
    of_thing, of_robot = bodies == thing, model.body_rootid[bodies] == robot
    return bool((of_thing.any(-1) & of_robot.any(-1)).any())


class Twins:
    """Twins that start as images of each other.

    Attributes:
        map: The map from the first to the second, one row.
        errors: Observation of the second minus the image of the first one's. ``(obs_dim,)``
    """

    def __init__(self, first: GoalRobotEnv, second: GoalRobotEnv) -> None:
        self.first, self.second = first, second
        symmetry = first.task.symmetry(rough=True)
        assert symmetry is not None
        self.symmetry = symmetry
        self.home = np.array(first.task.home)

    def start(self, place: Array, sign: Array, shift: Array, *, diagonal: bool = False) -> Array:
        """Start with the object at a position, and the second gripper at the image.

        Args:
            place: Position of the object relative to home in the plane, m. ``(2,)``
            sign: 1 or -1 per axis, mirrored about home. ``(3,)``
            shift: Added afterwards, m. ``(3,)``
            diagonal: Whether x and y are exchanged before.

        Returns:
            The first one's observation.
        """
        self.first.reset(seed=0)
        self.second.reset(seed=0)
        pose, velocity = object_state(self.first)
        pose[:2] = self.home[:2] + place
        put_object(self.first, pose, velocity)
        away = pose.copy()
        order = [1, 0, 2] if diagonal else [0, 1, 2]
        away[:2] = self.home[:2] + sign[:2] * place[order[:2]] + shift[:2]
        put_object(self.second, away, velocity)
        offset = self.home - sign * self.home[order]
        if shift.any():
            offset = offset + self._moved_apart(shift)
            pose, velocity = object_state(self.first)
        exchanged = np.full((1, 1), float(diagonal))
        self.map = PlaneMap(self.symmetry, exchanged, sign[None], (offset * [1.0, 1.0, 0.0])[None])
        return self.match_object()

    def _moved_apart(self, shift: Array) -> Array:
        """Move the second gripper; returns its offset, m."""
        still = np.zeros(4, np.float32)
        one = self.first.step(still)[0]["observation"]
        other = self.second.step(still)[0]["observation"]
        for _ in range(SETTLE_TICKS):
            error = one[:3] + shift - other[:3]
            action = np.append(np.clip(error / 0.05, -1.0, 1.0), 0.0).astype(np.float32)
            one = self.first.step(still)[0]["observation"]
            other = self.second.step(action)[0]["observation"]
        for _ in range(2):
            one = self.first.step(still)[0]["observation"]
            other = self.second.step(still)[0]["observation"]
        moved: Array = other[:3] - one[:3]
        return moved

    def match_object(self) -> Array:
        """Make the second object the exact image of the first; returns the first observation."""
        pose, velocity = object_state(self.first)
        space = np.diag(self.map.sign[0])
        if self.map.diagonal[0, 0]:
            space = space[:, [1, 0, 2]]
        axial = np.linalg.det(space) * space
        image = np.concatenate([self.map.goal(pose[None, :3])[0], pose[3:4], axial @ pose[4:]])
        spun = np.concatenate([space @ velocity[:3], axial @ velocity[3:]])
        one = put_object(self.first, pose, velocity)
        self._compare(one, put_object(self.second, image, spun))
        return one

    def step(self, action: Array, *, steer: bool = False) -> Array:
        """Step both; returns the first one's observation.

        Args:
            action: The first one's. ``(4,)``
            steer: Whether the second gripper is steered back to the image.
        """
        image = self.map.action(action[None])[0]
        if steer:
            image[:3] -= self.errors[:3] / 0.033
        one = self.first.step(action)[0]["observation"]
        self._compare(one, self.second.step(image)[0]["observation"])
        return np.asarray(one)

    def _compare(self, one: Array, other: Array) -> None:
        self.errors = other - self.map.observation(one[None])[0]

    @property
    def within(self) -> bool:
        """Whether both are within the area where the symmetry holds."""
        for env in (self.first, self.second):
            assert env._state is not None
            observation = env.task.observation(env._state)[None]
            centre = self.symmetry.choose(np.full((1, 5), 0.75), observation, observation)
            if not centre.offset.any():  # outside, every map is the identity
                return False
        return True


@contextmanager
def twins(task: str, actuation: str) -> Iterator[Twins]:
    with make_env(task, actuation=actuation) as one, make_env(task, actuation=actuation) as other:
        yield Twins(one, other)
