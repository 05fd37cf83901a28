"""Conversion of quaternions to the Euler angles of the Fetch environments."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_GIMBAL = 4.0 * float(np.finfo(np.float64).eps)


def quat_to_euler(quat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert a unit quaternion to the Euler angles of the Fetch environments.

    Args:
        quat: wxyz. ``(4,)``

    Returns:
        Angles about x, y and z, rad. ``(3,)``

    Source: ``mju_quat2Mat`` of MuJoCo, then ``mat2euler`` of
    `gymnasium_robotics/utils/rotations.py`, in their order of operations.
    """
    w, x, y, z = quat.tolist()
    ww, xx, yy, zz = w * w, x * x, y * y, z * z
    m00 = ww + xx - yy - zz
    m11 = ww - xx + yy - zz
    m22 = ww - xx - yy + zz
    m01, m10 = 2.0 * (x * y - w * z), 2.0 * (x * y + w * z)
    m02 = 2.0 * (x * z + w * y)
    m12 = 2.0 * (y * z - w * x)
    # Not ** 0.5, which can differ in the last bit.
    cosine = math.sqrt(m22 * m22 + m12 * m12)
    if cosine > _GIMBAL:
        # One call of numpy's arctan2: math.atan2 can differ from it in the last bit.
        return -np.arctan2([m12, -m02, m01], [m22, cosine, m00])
    euler = -np.arctan2([0.0, -m02, -m10], [1.0, cosine, m11])
    euler[0] = 0.0
    return euler
