"""Benchmark of the control of a simulated robot: tracking error, limits, scripted policies.

python bench/control.py [--robot fetch] [--episodes 100] [--out bench/results/NAME.json]
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from datetime import datetime
from pathlib import Path

import numpy as np

from drivers import Kinematics
from iher_robot.config.robot import choose_robot
from iher_robot.storage.provenance import collect_provenance
from tests.scripted import PickAndPlace, Push, success_rate


def tracking(robot: str, episodes: int) -> dict[str, object]:
    """Distance between setpoint and gripper, and speeds, over episodes of random actions."""
    with choose_robot("mujoco", robot).make_env("reach") as env:
        kinematics, rng = Kinematics(env.robot_spec), np.random.default_rng(0)
        limits = np.array([joint.max_velocity for joint in env.robot_spec.limits.joints.values()])
        errors_mm, commanded, measured = [], [], []
        clips: Counter[str] = Counter()
        for seed in range(episodes):
            env.reset(seed=seed)
            action, keep = np.zeros(4), 0.8 if seed % 2 else 0.0
            for _ in range(env.episode_ticks):
                action = np.clip(keep * action + rng.uniform(-1, 1, 4) * (1 - keep / 2), -1, 1)
                clips.update(map(str, env.step(action)[4]["clipped"]))
                state = env.driver.read()
                assert state.setpoint is not None
                at = kinematics.ee_pos(state.setpoint.q)
                errors_mm.append(1e3 * float(np.linalg.norm(state.ee_pos - at)))
                commanded.append(float((np.abs(state.setpoint.dq) / limits).max()))
                measured.append(float((np.abs(state.dq) / limits).max()))
    return {
        "tracking error mm, p50": float(np.percentile(errors_mm, 50)),
        "tracking error mm, p99": float(np.percentile(errors_mm, 99)),
        "tracking error mm, max": max(errors_mm),
        "commanded joint speed / limit, max": max(commanded),
        "measured joint speed / limit, p99": float(np.percentile(measured, 99)),
        "measured joint speed / limit, max": max(measured),
        "ticks": len(errors_mm),
        "ticks clipped, by reason": dict(clips),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="fetch")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    found: dict[str, object] = {}
    if choose_robot("mujoco", options.robot).options.get("actuation") != "mocap":
        found |= tracking(options.robot, options.episodes)
    for task, policy in (("push", Push), ("pick_and_place", PickAndPlace)):
        with choose_robot("mujoco", options.robot).make_env(task) as env:
            rate = success_rate(env, policy, options.episodes)
        found[f"scripted {task}, success of {options.episodes} episodes"] = rate
    for name, value in found.items():
        print(f"{name:50s} {value}")
    if options.out is not None:
        document = collect_provenance(sys.argv, 0, datetime.now().astimezone()) | found
        options.out.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
