from __future__ import annotations

import mujoco
import numpy as np
from gymnasium_robotics.utils import rotations
from hypothesis import given
from hypothesis import strategies as st

from tasks.rotation import quat_to_euler

COMPONENTS = st.floats(min_value=-1.0, max_value=1.0)
QUATERNIONS = st.tuples(COMPONENTS, COMPONENTS, COMPONENTS, COMPONENTS).filter(
    lambda quat: np.linalg.norm(quat) > 0.1
)


@given(QUATERNIONS)
def test_angles_give_back_the_rotation(quat: tuple[float, ...]) -> None:
    unit = np.array(quat) / np.linalg.norm(quat)
    rotation = rotations.euler2mat(quat_to_euler(unit))
    np.testing.assert_allclose(rotation, rotations.quat2mat(unit), atol=1e-7)


def test_angles_equal_the_reference_to_the_bit() -> None:
    rng = np.random.default_rng(0)
    matrix = np.zeros(9)
    for scale in 10.0 ** rng.uniform(-9.0, 2.0, size=2000):  # from nearly upright to anything
        quat = np.array([1.0, 0.0, 0.0, 0.0]) + scale * rng.normal(size=4)
        mujoco.mju_normalize4(quat)
        mujoco.mju_quat2Mat(matrix, quat)
        expected = rotations.mat2euler(matrix.reshape(3, 3))
        assert quat_to_euler(quat).tobytes() == expected.tobytes()


def test_turning_about_z_alone_shows_in_z_alone() -> None:
    for angle in np.linspace(-3.0, 3.0, 7):
        quat = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
        np.testing.assert_allclose(quat_to_euler(quat), (0.0, 0.0, angle), atol=1e-12)


def test_gimbal_lock_is_resolved_as_the_reference_does() -> None:
    half = np.sqrt(0.5)
    for quat in ([half, 0.0, half, 0.0], [half, 0.0, -half, 0.0], [0.5, 0.5, 0.5, -0.5]):
        unit = np.array(quat)
        np.testing.assert_allclose(
            quat_to_euler(unit), rotations.mat2euler(rotations.quat2mat(unit)), atol=1e-9
        )
