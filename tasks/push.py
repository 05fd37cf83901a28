"""The push task: push a block to a goal on the table."""

from __future__ import annotations

from tasks.frame import TaskFrame
from tasks.tabletop import TabletopTask


class Push(TabletopTask):
    """FetchPush-v4: push a block with the closed gripper."""

    name = "push"
    scene = "push"
    blocks_gripper = True
    rough_mirrors = ("xy",)  # the closed fingers are about as wide as thick
    default_frame = TaskFrame()
