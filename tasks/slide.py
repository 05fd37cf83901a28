"""The slide task: hit a puck so that it slides to a goal out of reach."""

from __future__ import annotations

from tasks.frame import TaskFrame
from tasks.tabletop import TabletopTask


class Slide(TabletopTask):
    """FetchSlide-v4: a slippery table, and goals 0.4 m ahead."""

    name = "slide"
    scene = "slide"
    blocks_gripper = True
    mirrors = ("y",)  # the goals lie ahead, never behind
    default_frame = TaskFrame(
        object_range=0.1,
        goal_range=0.3,
        goal_offset=(0.4, 0.0, 0.0),
        object_size=(0.025, 0.025, 0.02),
        even_area=((-0.28, -0.4), (0.9, 0.4)),
    )
