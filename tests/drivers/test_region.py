"""The allowed region of a robot: depths and their gradients."""

from __future__ import annotations

import dataclasses

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from drivers import Box
from drivers.region import Region
from tests.drivers.fake_robot import fake_spec

BOXES = (Box((0.0, 0.0, 0.0), (0.5, 0.3, 0.2)), Box((0.6, -0.4, 0.1), (0.9, 0.4, 0.3)))
RADII = np.array([0.05, 0.0])
# Centimetres, a few millimetres off every face.
POINTS = st.lists(st.integers(-50, 150), min_size=9, max_size=9)
STEP_M = 1e-6


def region(boxes: tuple[Box, ...]) -> Region:
    return Region(dataclasses.replace(fake_spec().limits, keep_out=boxes))


@given(POINTS)
def test_a_gradient_is_the_difference_that_a_small_step_makes(numbers: list[int]) -> None:
    points = np.reshape(numbers, (3, 3)) / 100.0 + 0.0037
    made = region(BOXES)
    owners, gradients = made.gradients(points)

    def depths(moved: np.ndarray) -> np.ndarray:
        return np.concatenate(list(made.depths(moved, RADII).values()))

    assert gradients.shape == (len(depths(points)), 3) == (6 + 2 * 3, 3)
    np.testing.assert_allclose(np.linalg.norm(gradients, axis=1), 1.0)
    for point in range(3):
        for axis in range(3):
            step = np.zeros((3, 3))
            step[point, axis] = STEP_M
            change = (depths(points + step) - depths(points - step)) / (2 * STEP_M)
            middle = (depths(points + step) + depths(points - step)) / 2 - depths(points)
            assume(np.abs(middle).max() < 1e-9)  # half-way between two faces there is none
            expected = np.where(owners == point, gradients[:, axis], 0.0)
            np.testing.assert_allclose(change, expected, atol=1e-4)


def test_without_boxes_there_are_the_sides_of_the_workspace() -> None:
    owners, gradients = region(()).gradients(np.zeros((3, 3)))
    np.testing.assert_array_equal(owners, np.zeros(6))
    np.testing.assert_array_equal(gradients, np.vstack([-np.eye(3), np.eye(3)]))
