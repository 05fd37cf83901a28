"""Room between the arm and what it must keep out of, as a limit of the inverse kinematics."""

from __future__ import annotations

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from drivers import Kinematics, RobotSpec
from drivers.region import Region

Array = NDArray[np.float64]

APPROACH_GAIN = 0.45
"""Share of the room to a limit that a tick may use up: enough is left to brake in."""

_NEAR_M = 0.1  # three ticks at full speed
_RETREAT_M = 0.003  # a tick


class ClearanceLimit(mink.Limit):
    """Slows what comes near a keep-out box, and the end effector near the workspace's sides.

    Only the part of a motion that leads towards the nearest face, edge or corner is limited, so
    that an arm slides along what a filter that scales whole motions would stop it at. Close to a
    face its motion is a line to first order only, hence the margin; what bends into the margin
    all the same is led out again, for at the face itself the filter would stop most motions.

    For each depth ``d`` of the region, with its gradient ``n`` and Jacobian ``J``:
    ``n J dq <= gain * (-d - margin)``. Compare `mink.CollisionAvoidanceLimit`.
    """

    def __init__(
        self, spec: RobotSpec, kinematics: Kinematics, margin_m: float, retreats: bool
    ) -> None:
        """Set the limit up.

        Args:
            spec: The robot.
            kinematics: Its kinematic model, with the guarded parts.
            margin_m: Distance to keep, m.
            retreats: Whether what is inside the margin must move out; it can be more than the
                other limits let it. Otherwise it comes no closer, and resting is a solution.
        """
        self._region = Region(spec.limits)
        self._sites = kinematics.guarded_sites
        self._radii = kinematics.guard_radii
        self._margin_m = margin_m
        self._fastest_retreat_m = _RETREAT_M if retreats else 0.0

    def compute_qp_inequalities(
        self,
        configuration: mink.Configuration,
        dt: float,  # noqa: ARG002 - the gain is a share per tick, however long
    ) -> mink.Constraint:
        """Return the inequalities of what is near, on the displacement of a tick.

        Args:
            configuration: The arm, of the kinematic model.
            dt: Length of a tick, s.
        """
        model, data = configuration.model, configuration.data
        points = data.site_xpos[self._sites]
        room = -np.concatenate(list(self._region.depths(points, self._radii).values()))
        owners, gradients = self._region.gradients(points)
        near = np.flatnonzero(room < _NEAR_M)
        if not near.size:
            return mink.Constraint()
        jacobians = {point: np.empty((3, model.nv)) for point in set(owners[near].tolist())}
        for point, jacobian in jacobians.items():
            mujoco.mj_jacSite(model, data, jacobian, None, self._sites[point])
        approach = np.array([gradients[row] @ jacobians[owners[row]] for row in near])
        most = np.maximum(APPROACH_GAIN * (room[near] - self._margin_m), -self._fastest_retreat_m)
        return mink.Constraint(approach, most)
