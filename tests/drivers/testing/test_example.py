"""The example of `docs/drivers.md`: the page shows it verbatim, and it does what the page says."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from drivers import RobotDriver
from drivers.testing.suite import ContractSuite
from examples.line_robot import LineRobot
from iher_robot import GoalRobotEnv, make_task
from iher_robot.testing import DriverContract
from tests.repository import ROOT
from tests.served.served_robot import PATIENT, ServedRobot

EXAMPLE = ROOT / "examples" / "line_robot.py"
DOCS = (ROOT / "docs" / "drivers.md").read_text()


class TestLineRobot(DriverContract):
    def make_driver(self) -> RobotDriver:
        return LineRobot()


def code_blocks(language: str) -> list[str]:
    parts = DOCS.split(f"```{language}\n")[1:]
    return [part.split("```")[0] for part in parts]


def towards(goal: np.ndarray, achieved: np.ndarray) -> np.ndarray:
    step = np.clip((goal - achieved) / LineRobot().spec.action.position_scale_m, -1.0, 1.0)
    return np.append(step, 0.0).astype(np.float32)


def test_the_page_shows_the_file_verbatim() -> None:
    assert EXAMPLE.read_text() in code_blocks("python")


def test_the_suite_on_the_page_is_that_of_this_file(tmp_path: Path) -> None:
    (tmp_path / "test_line.py").write_text(code_blocks("python")[-1])
    done = run("-m", "pytest", "-v", "-p", "no:cacheprovider", "test_line.py", folder=tmp_path)
    assert done.returncode == 0, done.stdout
    assert "[joint] PASSED" in done.stdout


def test_the_tasks_run_on_the_example() -> None:
    with GoalRobotEnv(LineRobot(), make_task("reach")) as env:
        obs, _ = env.reset(seed=0)
        assert np.linalg.norm(obs["desired_goal"] - obs["achieved_goal"]) > 0.05
        for _ in range(env.episode_ticks):
            action = towards(obs["desired_goal"], obs["achieved_goal"])
            obs, _, _, _, info = env.step(action)
            assert info["tick_valid"]
        assert info["is_success"]
        assert env.driver.clips.keys() <= {"ee_speed", "joint_acceleration"}


SCRIPT = """
from iher_robot import make_driver, make_env
with make_driver("line", scene="reach") as driver:
    print(driver.spec.name, type(driver).__module__)
with make_env("reach", "line") as env:
    env.reset(seed=0)
    env.step(env.action_space.sample())
try:
    make_driver("line", scene="push")
except ValueError as error:
    print(error)
"""


def test_the_example_is_found_by_its_entry_point(tmp_path: Path) -> None:
    install_example(tmp_path)
    done = run("-c", SCRIPT, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "line line_robot",
        "scene of 'line' is 'push', allowed: 'reach'",
    ]


@pytest.mark.real_time
def test_the_example_is_served_by_its_entry_point(tmp_path: Path) -> None:
    install_example(tmp_path)
    served = ServedRobot(
        tmp_path / "memory", "--driver", "line", *PATIENT, path=python_path(tmp_path)
    )
    with served:
        driver = served.driver("reach", robot="line")
        assert driver.spec.to_dict() == LineRobot().spec.to_dict()
        with GoalRobotEnv(driver, make_task("reach")) as env:
            obs, _ = env.reset(seed=0)
            for _ in range(25):
                obs, _, _, _, info = env.step(towards(obs["desired_goal"], obs["achieved_goal"]))
            assert info["is_success"]


def install_example(folder: Path) -> None:
    """Write the metadata that an installation of the example's package writes."""
    project = tomllib.loads(code_blocks("toml")[0])["project"]
    info = folder / "line_robot-0.1.0.dist-info"
    info.mkdir()
    metadata = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    (info / "METADATA").write_text(metadata)
    for group, entries in project["entry-points"].items():
        lines = [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())]
        (info / "entry_points.txt").write_text("\n".join(lines))


def python_path(folder: Path) -> str:
    return os.pathsep.join(map(str, (folder, EXAMPLE.parent, ROOT)))


def run(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run Python in the folder of a driver's author."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": python_path(folder)},
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_page_lists_the_attributes_of_a_suite() -> None:
    listed = set(re.findall(r"^\| `(\w+)` \|", DOCS, flags=re.MULTILINE))
    assert listed == ContractSuite.__annotations__.keys() - {"sample_types"}
