"""Scripted policies solve the tasks in both actuations."""

from __future__ import annotations

import pytest

from iher_robot.env.goal_env import make_env
from tests.scripted import PickAndPlace, Policy, Push, success_rate

EPISODES = 100


@pytest.mark.parametrize("actuation", ["joint", "mocap"])
@pytest.mark.parametrize(
    ("task", "make_policy"),
    [("push", Push), ("pick_and_place", PickAndPlace)],
    ids=["push", "pick"],
)
def test_scripted_policies_succeed(task: str, make_policy: type[Policy], actuation: str) -> None:
    with make_env(task, actuation=actuation) as env:
        assert success_rate(env, make_policy, EPISODES) >= 0.95
