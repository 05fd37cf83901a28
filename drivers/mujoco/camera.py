"""Simulated camera that measures the object's pose with rate, delay and noise."""

from __future__ import annotations

from collections import deque

import mujoco
import numpy as np

from drivers.mujoco.robot import SensorParameters
from drivers.spec import ObjectSource
from drivers.state import ObjectPose

_SECOND_NS = 1_000_000_000


class ObjectCamera:
    """Measures the object's pose at its own rate, and reports it after a delay."""

    def __init__(
        self, model: mujoco.MjModel, source: ObjectSource, parameters: SensorParameters
    ) -> None:
        """Look up the object.

        Args:
            model: The compiled scene.
            source: The camera in the robot's description.
            parameters: Rate, delay and noise.
        """
        self._model = model
        self._source = source
        self._parameters = parameters
        rate_hz = parameters.object_rate_hz
        self._between_ns = 0 if rate_hz is None else round(_SECOND_NS / rate_hz)
        self._delay_ns = round(parameters.object_delay_s * _SECOND_NS)
        self._site = model.site("object0").id
        self._body = model.body("object0").id
        self._jacp = np.zeros((3, model.nv))
        self._jacr = np.zeros((3, model.nv))
        self._poses: deque[ObjectPose] = deque()
        self._due_ns = 0

    def begin(self) -> None:
        """Drop all measurements; the next one is reported without delay."""
        self._poses.clear()

    def see(self, data: mujoco.MjData, now_ns: int, rng: np.random.Generator) -> ObjectPose:
        """Measure if a measurement is due, and return the newest one whose delay has passed.

        Args:
            data: The simulation, at the end of a control tick.
            now_ns: Time on the robot's clock.
            rng: Source of the noise.
        """
        if not self._poses:
            self._due_ns = now_ns
        if now_ns >= self._due_ns:
            self._due_ns += max(self._between_ns, 1)
            self._poses.append(self._picture(data, now_ns, rng))
        while len(self._poses) > 1 and self._poses[1].stamp_ns + self._delay_ns <= now_ns:
            self._poses.popleft()
        return self._poses[0]

    def _picture(self, data: mujoco.MjData, stamp_ns: int, rng: np.random.Generator) -> ObjectPose:
        mujoco.mj_jacSite(self._model, data, self._jacp, self._jacr, self._site)
        pos = data.site_xpos[self._site].copy()
        quat = data.xquat[self._body].copy()
        if self._parameters.object_noise_m > 0.0:
            pos += rng.normal(0.0, self._parameters.object_noise_m, 3)
        if self._parameters.object_turn_noise > 0.0:
            turn = rng.normal(0.0, self._parameters.object_turn_noise, 3)
            mujoco.mju_quatIntegrate(quat, turn, 1.0)
        return ObjectPose(
            pos=pos,
            quat=quat,
            linvel=self._jacp @ data.qvel,
            angvel=self._jacr @ data.qvel,
            stamp_ns=stamp_ns,
            source=self._source.source,
            frame=self._source.frame,
        )
