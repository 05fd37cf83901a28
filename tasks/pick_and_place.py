"""The pick-and-place task: lift a block and bring it to a goal."""

from __future__ import annotations

from tasks.frame import TaskFrame
from tasks.tabletop import TabletopTask


class PickAndPlace(TabletopTask):
    """FetchPickAndPlace-v4: half of the goals are in the air."""

    name = "pick_and_place"
    scene = "pick_and_place"
    blocks_gripper = False
    default_frame = TaskFrame(air_probability=0.5)
