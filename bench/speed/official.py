"""The environments of gymnasium-robotics."""

from __future__ import annotations

import gymnasium as gym

ID = "FetchPush-v4"


def make_official() -> gym.Env:
    """Make Push of gymnasium-robotics."""
    import gymnasium_robotics

    gym.register_envs(gymnasium_robotics)
    return gym.make(ID)
