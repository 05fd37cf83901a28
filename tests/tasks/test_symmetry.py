"""Symmetries of tasks: invariants, the area in which they hold, and geometry of the maps."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from gymnasium_robotics.utils import rotations
from hypothesis import given
from hypothesis import strategies as st

from tasks import TASKS, GoalTask, InvalidFrame, TaskFrame, make_task
from tasks.push import Push
from tasks.rotation import quat_to_euler
from tasks.symmetry import Kind, PlaneMap, PlaneSymmetry
from tasks.tabletop import OBJECT_KINDS, OBJECT_LAYOUT
from tests.drivers.fake_robot import fake_spec

SEEDS = st.integers(min_value=0, max_value=2**32 - 1)
NAMES = st.sampled_from(list(TASKS))
ROWS = 200
ROUNDING = 1e-12


def task(name: str, **frame: Any) -> GoalTask:
    return make_task(name, TaskFrame(**(vars(TASKS[name].default_frame) | frame))).bind(fake_spec())


def declared(name: str) -> PlaneSymmetry:
    symmetry = task(name).symmetry(rough=True)
    assert symmetry is not None
    return symmetry


def area(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return lower and upper corner of the even area. ``(2,)`` each"""
    bound = task(name)
    lower, upper = bound.frame.even_area
    home = np.array(bound.home[:2])
    return home + lower, home + upper


def bounded(name: str, observation: np.ndarray) -> np.ndarray:
    """Where gripper and object are in the plane. ``(things, batch, 2)``"""
    layout = task(name).layout
    entries = [layout.effector] + ([layout.object_entry] if layout.object_entry else [])
    return np.stack([observation[:, layout.slices[entry]][:, :2] for entry in entries])


def steps(name: str, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Start, action and end of steps, some of which leave the even area; and their draws."""
    rng, layout = np.random.default_rng(seed), task(name).layout
    lower, upper = area(name)
    centre, half = (lower + upper) / 2, (upper - lower) / 2
    observations = []
    for _ in range(2):
        observation = rng.normal(size=(ROWS, layout.obs_dim))
        for entry in ("gripper_pos", "object_pos"):
            if entry in layout.names:
                at = layout.slices[entry].start
                place = centre + 1.1 * half * rng.uniform(-1, 1, size=(ROWS, 2))
                observation[:, at : at + 2] = place
        observations.append(layout.complete(observation))
    action = rng.uniform(-1, 1, size=(ROWS, 4))
    return observations[0], action, observations[1], rng.uniform(size=(ROWS, PlaneSymmetry.draws))


def inside(name: str, *observations: np.ndarray, slack: float = 0.0) -> np.ndarray:
    """Which rows have gripper and object in the even area at both ends. ``(batch,)``"""
    lower, upper = area(name)
    places = np.concatenate([bounded(name, observation) for observation in observations])
    found = (places >= lower - slack) & (places <= upper + slack)
    return np.asarray(found.all(axis=(0, 2)))


@given(NAMES, SEEDS)
def test_the_reward_of_an_image_is_that_of_the_original(name: str, seed: int) -> None:
    start, _, end, uniform = steps(name, seed)
    model, maps = task(name).goal_model, declared(name).choose(uniform, start, end)
    achieved = model.achieved_goal(end)
    desired = achieved + np.random.default_rng(seed).normal(scale=0.03, size=achieved.shape)
    image = model.achieved_goal(maps.observation(end))
    np.testing.assert_allclose(image, maps.goal(achieved), atol=ROUNDING)
    distance = model.distance(image, maps.goal(desired))
    np.testing.assert_allclose(distance, model.distance(achieved, desired), atol=ROUNDING)
    assert (np.abs(image - achieved).max(-1) > 1e-3).any()


@given(NAMES, SEEDS)
def test_completing_an_image_changes_nothing(name: str, seed: int) -> None:
    start, _, end, uniform = steps(name, seed)
    layout, maps = task(name).layout, declared(name).choose(uniform, start, end)
    image = maps.observation(start)
    np.testing.assert_allclose(layout.complete(image), image, atol=ROUNDING)


@given(NAMES, SEEDS)
def test_a_step_that_is_not_all_inside_the_area_is_its_own_image(name: str, seed: int) -> None:
    start, action, end, uniform = steps(name, seed)
    maps = declared(name).choose(uniform, start, end)
    within = inside(name, start, end)
    assert 0 < within.sum() < ROWS
    for values, image in (
        (start, maps.observation(start)),
        (end, maps.observation(end)),
        (action, maps.action(action)),
        (start[:, :3], maps.goal(start[:, :3])),
    ):
        np.testing.assert_array_equal(image[~within], values[~within])
    assert (maps.observation(start) != start)[within].any(axis=-1).all()


@given(NAMES, SEEDS)
def test_images_of_points_inside_the_area_stay_inside(name: str, seed: int) -> None:
    start, _, end, uniform = steps(name, seed)
    maps = declared(name).choose(uniform, start, end)
    images = maps.observation(start), maps.observation(end)
    within = inside(name, start, end)
    assert inside(name, *images, slack=1e-9)[within].all()


@given(NAMES, SEEDS)
def test_a_mirror_image_of_a_mirror_image_is_the_original(name: str, seed: int) -> None:
    start, action, end, uniform = steps(name, seed)
    uniform[:, 2:4] = 0.5  # no shift
    # The diagonal and another plane make a quarter turn, which is no mirror image.
    uniform[::2, :2], uniform[1::2, 4] = 0.9, 0.9
    symmetry = declared(name)
    maps = symmetry.choose(uniform, start, end)
    again = symmetry.choose(uniform, maps.observation(start), maps.observation(end))
    np.testing.assert_allclose(again.observation(maps.observation(end)), end, atol=ROUNDING)
    np.testing.assert_array_equal(again.action(maps.action(action)), action)
    goal = end[:, :3]
    np.testing.assert_allclose(again.goal(maps.goal(goal)), goal, atol=ROUNDING)


@given(NAMES, SEEDS)
def test_tensors_equal_arrays(name: str, seed: int) -> None:
    start, action, end, uniform = steps(name, seed)
    symmetry = declared(name)
    arrays = symmetry.choose(uniform, start, end)
    tensors = symmetry.choose(*(torch.from_numpy(each) for each in (uniform, start, end)))
    for mine, theirs in (
        (arrays.observation(end), tensors.observation(torch.from_numpy(end))),
        (arrays.action(action), tensors.action(torch.from_numpy(action))),
        (arrays.goal(end[:, :3]), tensors.goal(torch.from_numpy(end[:, :3]))),
    ):
        np.testing.assert_array_equal(mine, theirs.numpy())
    single = symmetry.choose(*(torch.from_numpy(each).float() for each in (uniform, start, end)))
    assert single.observation(torch.from_numpy(end).float()).dtype == torch.float32


@given(NAMES, SEEDS)
def test_the_arguments_stay_as_they_were(name: str, seed: int) -> None:
    given_, kept = steps(name, seed), steps(name, seed)
    start, action, end, uniform = given_
    maps = declared(name).choose(uniform, start, end)
    maps.observation(start)
    maps.action(action)
    maps.goal(end[:, :3])
    for mine, theirs in zip(given_, kept, strict=True):
        np.testing.assert_array_equal(mine, theirs)


@given(NAMES, SEEDS)
def test_motions_are_mapped_as_the_places_between_which_they_lead(name: str, seed: int) -> None:
    start, action, end, uniform = steps(name, seed)
    layout = task(name).layout
    gripper, velocity = layout.slices["gripper_pos"], layout.slices["gripper_vel"]
    end[:, velocity] = end[:, gripper] - start[:, gripper]
    action[:, :3] = end[:, gripper] - start[:, gripper]
    maps = declared(name).choose(uniform, start, end)
    image = maps.observation(end)
    moved = image[:, gripper] - maps.observation(start)[:, gripper]
    np.testing.assert_allclose(image[:, velocity], moved, atol=ROUNDING)
    np.testing.assert_allclose(maps.action(action)[:, :3], moved, atol=ROUNDING)
    np.testing.assert_array_equal(maps.action(action)[:, 3], action[:, 3])
    np.testing.assert_array_equal(image[:, gripper][:, 2], end[:, gripper][:, 2])


def mirrors(*signs: float, diagonal: bool = False) -> tuple[np.ndarray, PlaneMap[Any]]:
    """Return a reflection or rotation of space, and the map that should equal it, one row."""
    sign = np.array(signs)
    space = np.diag(sign)[:, [1, 0, 2]] if diagonal else np.diag(sign)
    exchanged = np.full((1, 1), float(diagonal))
    return space, PlaneMap(declared("push"), exchanged, sign[None], np.zeros((1, 3)))


SIGNS = st.sampled_from([(-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (-1.0, -1.0, 1.0)])


def cross(vector: np.ndarray) -> np.ndarray:
    """The matrix that takes the cross product with a vector: velocities of a turning body."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@given(SIGNS, SEEDS)
def test_angles_and_angular_velocities_are_those_of_the_mirrored_body(
    signs: tuple[float, float, float], seed: int
) -> None:
    space, maps = mirrors(*signs)
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=4)
    quat /= np.linalg.norm(quat)
    angles, turning = quat_to_euler(quat), rng.normal(size=3)
    observation = np.zeros((1, 25))
    where = OBJECT_LAYOUT.slices
    observation[0, where["object_euler"]] = angles
    observation[0, where["object_angvel"]] = turning
    image = maps.observation(observation)[0]
    # A point p of the body is at R p; that of its mirror image, S p, is at S R p.
    expected = space @ rotations.euler2mat(angles) @ space
    found = rotations.euler2mat(image[where["object_euler"]])
    np.testing.assert_allclose(found, expected, atol=1e-9)
    # It moves at w x p, and its mirror image at S (w x p).
    expected = space @ cross(turning) @ space
    np.testing.assert_allclose(cross(image[where["object_angvel"]]), expected, atol=1e-12)


@given(st.sampled_from([(1.0, 1.0, 1.0), (-1.0, 1.0, 1.0), (-1.0, -1.0, 1.0)]), SEEDS)
def test_angles_of_a_flat_body_are_those_of_its_diagonal_reflection(
    signs: tuple[float, float, float], seed: int
) -> None:
    space, maps = mirrors(*signs, diagonal=True)
    rng, where = np.random.default_rng(seed), OBJECT_LAYOUT.slices
    angles, turning = np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]), rng.normal(size=3)
    observation = np.zeros((1, 25))
    observation[0, where["object_euler"]] = angles
    observation[0, where["object_angvel"]] = turning
    observation[0, where["object_rel_vel"]] = rng.normal(size=3)
    image = maps.observation(observation)[0]
    found = rotations.euler2mat(image[where["object_euler"]])
    expected = space @ rotations.euler2mat(angles) @ np.linalg.inv(space)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    spun = space @ cross(turning) @ np.linalg.inv(space)
    np.testing.assert_allclose(cross(image[where["object_angvel"]]), spun, atol=1e-12)
    moved = space @ observation[0, where["object_rel_vel"]]
    np.testing.assert_array_equal(image[where["object_rel_vel"]], moved)


@pytest.mark.parametrize(
    ("rough", "kind", "expected"),
    [(False, "ee_delta", 0.0), (True, "ee_delta", 0.5), (True, "joint", 0.0)],
)
def test_rough_maps_need_a_request_and_end_effector_commands(
    rough: bool, kind: str, expected: float
) -> None:
    robot = dataclasses.replace(fake_spec(), command_kinds=(kind,))
    bound = make_task("push").bind(robot)
    start = np.zeros((1000, 25))
    start[:, 0:2] = start[:, 3:5] = bound.home[:2]
    uniform = np.random.default_rng(0).uniform(size=(1000, PlaneSymmetry.draws))
    symmetry = bound.symmetry(rough=rough)
    assert symmetry is not None
    share = float(symmetry.choose(uniform, start, start).diagonal.mean())
    assert share == pytest.approx(expected, abs=0.05)


def test_only_a_mirror_image_across_the_fingers_exchanges_them() -> None:
    observation = np.zeros((1, 25))
    slices = OBJECT_LAYOUT.slices["fingers_pos"], OBJECT_LAYOUT.slices["fingers_vel"]
    for where in slices:
        observation[0, where] = (0.01, 0.04)
    for signs, expected in (
        ((1.0, 1.0, 1.0), (0.01, 0.04)),
        ((-1.0, 1.0, 1.0), (0.01, 0.04)),
        ((1.0, -1.0, 1.0), (0.04, 0.01)),
        ((-1.0, -1.0, 1.0), (0.04, 0.01)),
    ):
        image = mirrors(*signs)[1].observation(observation)[0]
        for where in slices:
            np.testing.assert_array_equal(image[where], expected)


@pytest.mark.parametrize("name", list(TASKS))
def test_all_maps_are_drawn_and_slide_is_never_mirrored_ahead(name: str) -> None:
    symmetry, rng = declared(name), np.random.default_rng(0)
    lower, upper = area(name)
    start = np.zeros((4000, task(name).layout.obs_dim))
    for entry in ("gripper_pos", "object_pos"):
        if entry in task(name).layout.names:
            at = task(name).layout.slices[entry].start
            start[:, at : at + 2] = (lower + upper) / 2
    maps = symmetry.choose(rng.uniform(size=(4000, symmetry.draws)), start, start)
    mirrored = maps.sign < 0
    expected = (0.0 if name == "slide" else 0.5, 0.5, 0.0)
    np.testing.assert_allclose(mirrored.mean(0), expected, atol=0.04)
    assert abs((mirrored[:, 0] & mirrored[:, 1]).mean() - expected[0] / 2) < 0.04
    moved = maps.observation(start)[:, :3] - start[:, :3]
    assert (np.abs(moved) <= 0.1 + ROUNDING).all()
    np.testing.assert_allclose(moved[:, :2].std(0), 0.1 / np.sqrt(3), rtol=0.05)
    assert (moved[:, 2] == 0).all()
    for axis in (0, 1):  # whether it is mirrored says nothing about where it is shifted
        if mirrored[:, axis].any():
            assert abs(moved[mirrored[:, axis], axis].mean()) < 0.01


def test_the_area_lies_around_home() -> None:
    far = task("push", home=(2.0, -1.0, 0.5), even_area=((-0.1, -0.2), (0.3, 0.2)))
    symmetry = far.symmetry()
    assert symmetry is not None
    places = np.array([(1.91, -1.19), (2.29, -0.81), (1.89, -1.0), (2.31, -1.0), (2.0, -0.79)])
    start = np.zeros((5, 25))
    start[:, 0:2] = start[:, 3:5] = places
    maps = symmetry.choose(np.full((5, 5), 0.1), start, start)
    changed = (maps.observation(start) != start).any(axis=-1)
    assert changed.tolist() == [True, True, False, False, False]


def test_kinds_must_be_those_of_the_layout() -> None:
    square = ((0.0, 0.0), (1.0, 1.0))
    missing = {name: kind for name, kind in OBJECT_KINDS.items() if name != "object_rel"}
    for kinds in (missing, OBJECT_KINDS | {"elbow": Kind.POSITION}):
        with pytest.raises(ValueError, match="object_pos"):
            PlaneSymmetry(OBJECT_LAYOUT, kinds, area=square)


def test_a_task_that_declares_no_kinds_has_no_symmetry() -> None:
    class Bare(Push):
        kinds: ClassVar[dict[str, Kind]] = {}

    assert Bare().bind(fake_spec()).symmetry() is None


@pytest.mark.parametrize(
    "corners",
    [
        ((0.1, -0.2), (0.1, 0.2)),
        ((-0.1, 0.2), (0.1, -0.2)),
        ((-float("inf"), -0.2), (0.1, 0.2)),
        ((-0.1, -0.2), (0.1, float("nan"))),
    ],
    ids=str,
)
def test_an_even_area_without_an_inside_is_an_error(
    corners: tuple[tuple[float, float], tuple[float, float]],
) -> None:
    with pytest.raises(InvalidFrame, match=r"even_area is .*allowed: a lower and an upper corner"):
        dataclasses.replace(TaskFrame(), even_area=corners)
