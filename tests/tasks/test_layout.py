from __future__ import annotations

import numpy as np
import pytest

from tasks import TASKS, Difference, GoalTask, ObservationLayout


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS.keys())
def test_slices_cover_the_vector_once_and_in_order(task: type[GoalTask]) -> None:
    layout = task.layout
    numbers = np.arange(layout.obs_dim)
    covered = [numbers[layout.slices[name]] for name in layout.names]
    np.testing.assert_array_equal(np.concatenate(covered), numbers)


def test_the_layout_of_objects_is_that_of_fetch() -> None:
    layout = TASKS["push"].layout
    assert layout.obs_dim == 25
    assert layout.slices["object_rel"] == slice(6, 9)
    assert layout.slices["object_rel_vel"] == slice(14, 17)
    assert layout.slices["fingers_vel"] == slice(23, 25)
    assert TASKS["reach"].layout.obs_dim == 10


def test_a_digest_tells_order_and_derivation_apart() -> None:
    sizes = (("gripper_pos", 3), ("object_pos", 3), ("object_rel", 3))
    rel = Difference("object_rel", "object_pos", "gripper_pos")
    layouts = [
        ObservationLayout(sizes),
        ObservationLayout(sizes[::-1]),
        ObservationLayout(sizes, (rel,)),
        ObservationLayout(sizes, (Difference("object_rel", "gripper_pos", "object_pos"),)),
        ObservationLayout(sizes, effector="object_pos"),
        ObservationLayout(sizes, object_entry="object_pos"),
    ]
    assert len({layout.digest() for layout in layouts}) == len(layouts)
    assert ObservationLayout(sizes, (rel,)).digest() == layouts[2].digest()


def test_a_layout_that_names_unknown_entries_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"no entry \['gripper_pos'\]"):
        ObservationLayout((("gripper", 3),))
    with pytest.raises(ValueError, match=r"no entry \['object_pos'\]"):
        ObservationLayout((("gripper_pos", 3),), object_entry="object_pos")
    with pytest.raises(ValueError, match="allowed: names that are all different"):
        ObservationLayout((("gripper_pos", 3), ("gripper_pos", 3)))
