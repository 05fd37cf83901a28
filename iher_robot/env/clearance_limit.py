"""Clearance limit of the inverse kinematics: distance to keep-out boxes and workspace sides."""

from __future__ import annotations

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from drivers import Kinematics, RobotSpec
from drivers.region import Region

Array = NDArray[np.float64]

APPROACH_GAIN = 0.45
"""Share of the remaining distance that a tick may use; the rest is left for braking."""

_NEAR_M = 0.1  # three ticks at full speed
_RETREAT_M = 0.003  # a tick


class ClearanceLimit(mink.Limit):
    """Slows points near a keep-out box, and the end effector near the workspace's sides.

    Only the component of a motion towards the nearest face, edge or corner is limited, so that
    the arm slides along it; a filter that scales whole motions would stop it. The motion is
    linear to first order only, hence the margin. A point that enters the margin is moved out
    again: at the face itself the filter would stop most motions.

    For each depth ``d`` of the region, with its gradient ``n`` and Jacobian ``J``:
    ``n J dq <= gain * (-d - margin)``. Compare `mink.CollisionAvoidanceLimit`.
    """

    def __init__(
        self, spec: RobotSpec, kinematics: Kinematics, margin_m: float, retreats: bool
    ) -> None:
        """Create the limit.

        Args:
            spec: The robot.
            kinematics: Its kinematic model, with the guarded points.
            margin_m: Distance to keep, m.
            retreats: Whether points inside the margin must move out; this can conflict with the
                other limits. Otherwise they come no closer, and zero motion is a solution.
        """
        self._region = Region(spec.limits)
        self._sites = kinematics.guarded_sites
        self._radii = kinematics.guard_radii
        self._margin_m = margin_m
        self._fastest_retreat_m = _RETREAT_M if retreats else 0.0

    def compute_qp_inequalities(
        self,
        configuration: mink.Configuration,
        dt: float,  # noqa: ARG002 - the gain is a share per tick of any length
    ) -> mink.Constraint:
        """Return the inequalities of the near points, on the displacement of a tick.

        Args:
            configuration: The arm, of the kinematic model.
            dt: Duration of a tick, s.
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
