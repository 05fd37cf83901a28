"""Operator commands: doctor, home, stop, clear-fault."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import iher_robot
from drivers import EMERGENCY_STOP, Mode, ResetOutcome, ResetRequest, ResetResult
from drivers.remote.messages import Empty
from iher_robot.cli.app import main
from iher_robot.config import robot_link as robot_link_module
from iher_robot.deployment import commands as commands_module
from tests.drivers.fake_robot import FakeRobot
from tests.repository import ROOT
from tests.served.observer import Observer
from tests.served.served_robot import ServedRobot, eventually, free_port

pytestmark = pytest.mark.real_time

HOME_M = 0.05
STILL = 5e-3


@dataclass(frozen=True)
class Outcome:
    """Result of one invocation of the command line."""

    code: object
    out: str
    err: str

    def assert_one_sentence(self, *parts: str) -> None:
        assert self.code == 2, self
        assert self.err.startswith("iher-robot: "), self
        assert self.err.count("\n") == 1, self
        for part in parts:
            assert part in self.err


Run = Callable[..., Outcome]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """Run the command line in an empty folder, without a terminal."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.StringIO())

    def invoke(*words: str) -> Outcome:
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main(words)
        printed = capsys.readouterr()
        return Outcome(ended.value.code, printed.out, printed.err)

    return invoke


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedRobot]:
    with ServedRobot(tmp_path_factory.mktemp("memory")) as robot:
        yield robot


@pytest.fixture
def served(host: ServedRobot) -> Iterator[ServedRobot]:
    """The served robot; faults are cleared after each test."""
    yield host
    with Observer(host.endpoint) as observer:
        fault = observer.newest[1].fault
    if fault is not None:
        host.driver().clear_fault(fault.name)


def status(served: ServedRobot) -> dict[str, Any]:
    with Observer(served.endpoint) as observer:
        return observer.client.request("status", Empty()).result


def mover(served: ServedRobot) -> subprocess.Popen[str]:
    """Start a client that keeps the robot moving; wait until it moves."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.served.mover", served.endpoint, "never"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=ROOT,
    )
    assert process.stdout is not None
    assert any(int(line) >= 20 for line in process.stdout), "it moves"
    return process


def end(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.communicate(timeout=10.0)


# stop


def test_a_stop_is_acknowledged_and_prints_the_state_of_the_robot(
    run: Run, served: ServedRobot
) -> None:
    moving = mover(served)
    try:
        outcome = run("stop", "--connect", served.endpoint, "--reason", "someone walked in")
    finally:
        end(moving)
    assert outcome.code == 0, outcome
    assert "NOT CONFIRMED" not in outcome.out + outcome.err
    for part in (EMERGENCY_STOP, "someone walked in", Mode.STOPPED, "clear-fault"):
        assert part in outcome.out
    with Observer(served.endpoint) as observer:
        _, info = observer.newest
        assert info.fault is not None
        assert (info.fault.name, info.fault.reason) == (EMERGENCY_STOP, "someone walked in")
        assert not info.armed
        assert eventually(lambda: float(np.abs(observer.newest[0].dq).max()) < STILL)


def test_a_stop_without_a_host_is_not_confirmed(run: Run) -> None:
    outcome = run("stop", "--connect", f"tcp/127.0.0.1:{free_port()}", "--patience", "0.5")
    assert outcome.code == 1, outcome
    assert "NOT CONFIRMED" in outcome.out + outcome.err
    assert "emergency stop" in outcome.out + outcome.err


def test_a_stop_of_a_frozen_host_is_not_confirmed_in_time(tmp_path: Path) -> None:
    with ServedRobot(tmp_path / "memory") as served:
        children = [served.child("run_robot"), served.child("run_gateway")]
        served.signal(signal.SIGSTOP)
        try:
            for pid in children:
                os.kill(pid, signal.SIGSTOP)
            ended = subprocess.run(
                command("stop", "--connect", served.endpoint, "--patience", "1"),
                capture_output=True,
                text=True,
                timeout=20.0,  # most of which a busy machine takes to start it
                check=False,
            )
        finally:
            for pid in children:
                os.kill(pid, signal.SIGCONT)
            served.signal(signal.SIGCONT)
    assert ended.returncode == 1, ended
    assert "NOT CONFIRMED" in ended.stdout + ended.stderr


def test_a_stop_tries_until_the_host_is_there(tmp_path: Path) -> None:
    port = free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    trying = subprocess.Popen(
        command("stop", "--connect", endpoint, "--patience", "120"),
        stdout=subprocess.PIPE,
        text=True,
    )
    threading.Event().wait(2.0)  # some attempts fail
    try:
        with ServedRobot(tmp_path / "memory", port=port) as served:
            assert trying.wait(120.0) == 0
            assert status(served)["fault"]["name"] == EMERGENCY_STOP
    finally:
        end(trying)


def test_a_stop_that_is_interrupted_says_that_it_is_not_confirmed(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(commands_module, "RobotClient", interrupt)
    outcome = run("stop")
    assert outcome.code == 130, outcome
    assert "NOT CONFIRMED" in outcome.err


def test_a_stop_waits_for_no_learning_library() -> None:
    heavy = "{'torch', 'mujoco', 'matplotlib'}"
    program = (
        f"import sys, iher_robot.deployment.commands; sys.exit(len({heavy} & sys.modules.keys()))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


@pytest.mark.parametrize("patience", ["0", "-1", "nan", "1e9"])
def test_a_patience_out_of_range_is_refused(run: Run, patience: str) -> None:
    run("stop", "--patience", patience).assert_one_sentence("patience", "allowed")


@pytest.mark.parametrize("words", [("stop",), ("clear-fault", EMERGENCY_STOP)])
def test_a_robot_without_a_host_takes_no_commands(
    run: Run, tmp_path: Path, words: tuple[str, ...]
) -> None:
    (tmp_path / "robot.yaml").write_text("driver: mujoco\n")
    run(*words).assert_one_sentence("mujoco", "driver")


def test_a_wrong_key_in_a_robot_file_is_named(run: Run, tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("timeout: 1\n")
    for words in (("stop",), ("clear-fault", "x"), ("doctor",), ("home", "--yes")):
        run(*words).assert_one_sentence("timeout", "timeout_s")


def test_a_stop_is_sent_whatever_its_reason_is_and_the_first_one_is_kept(
    run: Run, served: ServedRobot
) -> None:
    reason = "\x1b[2J" + "a" * 5000 + "\udcff"
    outcome = run("stop", "--connect", served.endpoint, "--reason", reason)
    assert outcome.code == 0, outcome
    assert "\x1b" not in outcome.out
    second = run("stop", "--connect", served.endpoint, "--reason", "a second one")
    assert second.code == 0, second
    assert "aaa" in second.out
    assert "a second one" not in second.out


def test_a_reason_from_the_network_is_shown_without_control_characters(
    run: Run, served: ServedRobot
) -> None:
    with Observer(served.endpoint) as observer:
        observer.client.stop("\x1b[31mred", "\x1b[2Jall is well", 5.0)
    for words in (("stop",), ("doctor",), ("clear-fault", "x"), ("home", "--yes")):
        outcome = run(*words, "--connect", served.endpoint)
        expected = "latched: 'emergency_stop'" if words[0] == "clear-fault" else "all is well"
        assert expected in outcome.out + outcome.err, outcome
        assert "\x1b" not in outcome.out + outcome.err


# clear-fault


def test_a_fault_is_cleared_by_its_name_and_nothing_is_armed(run: Run, served: ServedRobot) -> None:
    connect = ("--connect", served.endpoint)
    run("clear-fault", EMERGENCY_STOP, *connect).assert_one_sentence(EMERGENCY_STOP, "None")
    assert run("stop", *connect).code == 0
    run("clear-fault", "another", *connect).assert_one_sentence("another", EMERGENCY_STOP)
    assert status(served)["fault"] is not None, "another name clears nothing"
    outcome = run("clear-fault", EMERGENCY_STOP, *connect)
    assert outcome.code == 0, outcome
    assert EMERGENCY_STOP in outcome.out
    now = status(served)
    assert now["fault"] is None
    assert not now["armed"]


@pytest.mark.parametrize("name", ["", "x" * 300])
def test_a_name_of_bad_length_is_refused(run: Run, served: ServedRobot, name: str) -> None:
    run("clear-fault", name, "--connect", served.endpoint).assert_one_sentence("fault")


@pytest.mark.parametrize("words", [("clear-fault", "x"), ("home", "--yes"), ("doctor",)])
def test_without_a_host_the_error_says_how_to_start_one(
    run: Run, tmp_path: Path, words: tuple[str, ...]
) -> None:
    (tmp_path / "robot.yaml").write_text("connect_timeout_s: 0.5\n")
    outcome = run(*words, "--connect", f"tcp/127.0.0.1:{free_port()}")
    outcome.assert_one_sentence("no host of robot 'fetch' answers", "iher-robot serve")


# home


def test_home_brings_a_robot_back_and_leaves_it_disarmed(run: Run, served: ServedRobot) -> None:
    end(mover(served))
    with Observer(served.endpoint) as observer:
        assert eventually(lambda: not observer.newest[1].token), "its lease ends"
        home = np.array(observer.spec.home.ee_pos)
        before = observer.newest[0]
        assert float(np.linalg.norm(before.ee_pos - home)) > 0.01, "it was elsewhere"
        outcome = run("home", "--yes", "--connect", served.endpoint)
        assert outcome.code == 0, outcome
        assert eventually(lambda: not observer.newest[1].token), "it is free for others"
        state, info = observer.newest
    np.testing.assert_allclose(state.ee_pos, home, atol=HOME_M)
    assert not info.armed
    assert "disarmed" in outcome.out
    assert "home" in outcome.out


def test_home_asks_and_without_a_terminal_nothing_moves(run: Run, served: ServedRobot) -> None:
    before = status(served)["total_ticks"]
    run("home", "--connect", served.endpoint).assert_one_sentence("--yes")
    assert status(served)["total_ticks"] == before


def test_home_of_a_robot_that_is_stopped_or_in_use_is_refused(
    run: Run, served: ServedRobot, tmp_path: Path
) -> None:
    (tmp_path / "robot.yaml").write_text(f"connect: [{served.endpoint}]\nconnect_timeout_s: 0.5\n")
    assert run("stop").code == 0
    run("home", "--yes").assert_one_sentence("stopped by 'emergency_stop'")
    assert run("clear-fault", EMERGENCY_STOP).code == 0
    with served.driver():
        run("home", "--yes").assert_one_sentence("is used by")


def test_home_works_in_the_scene_that_the_host_serves(run: Run, tmp_path: Path) -> None:
    with ServedRobot(tmp_path / "memory", "--scene", "reach") as served:
        outcome = run("home", "--yes", "--connect", served.endpoint)
        assert outcome.code == 0, outcome
        assert status(served)["scene"] == "reach"


class Interrupted(FakeRobot):
    """Raises KeyboardInterrupt on its way home."""

    def _reset(self, request: ResetRequest) -> ResetResult:
        raise KeyboardInterrupt


def test_an_interrupt_on_the_way_home_stops_the_robot(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = Interrupted()
    monkeypatch.setattr(robot_link_module, "make_driver", lambda *_, **__: robot)
    outcome = run("home", "--yes", "--driver", "mujoco")
    assert outcome.code == 130, outcome
    assert "a stop was sent" in outcome.err
    assert robot.fault is not None
    assert not robot.is_open


def test_home_that_is_not_reached_is_an_error(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = FakeRobot()
    robot.outcomes = [ResetOutcome.FAILED]
    monkeypatch.setattr(robot_link_module, "make_driver", lambda *_, **__: robot)
    outcome = run("home", "--yes", "--driver", "mujoco")
    assert outcome.code == 2, outcome
    assert "did not reach home" in outcome.err


def test_home_of_a_simulation_in_this_process(run: Run) -> None:
    outcome = run("home", "--yes", "--driver", "mujoco")
    assert outcome.code == 0, outcome
    assert "held and disarmed" in outcome.out


@pytest.mark.parametrize("speed", ["0", "1.5", "nan"])
def test_a_speed_out_of_range_is_refused(run: Run, speed: str) -> None:
    run("home", "--yes", "--speed", speed).assert_one_sentence("speed", "allowed")


# doctor


def test_doctor_prints_specification_state_and_link(run: Run, served: ServedRobot) -> None:
    with Observer(served.endpoint) as observer:
        spec = observer.spec
    with served.driver():
        outcome = run("doctor", "--connect", served.endpoint)
    for part in (
        spec.name,
        "simulated",
        "joint",
        "40 ms",
        spec.interface_digest[:12],
        spec.body_digest[:12],
        "object0 from simulator",
        "round trip",
        "p99",
        "disarmed",
        f":{os.getpid()}",  # holder of the lease
    ):
        assert part in outcome.out, part
    assert "stopped by" not in outcome.out


def test_doctor_for_scripts(run: Run, served: ServedRobot) -> None:
    outcome = run("doctor", "--json", "--connect", served.endpoint)
    report = json.loads(outcome.out)
    assert outcome.code == (1 if report["findings"] else 0)
    link = report["link"]
    assert 0.0 < link["p50_ms"] <= link["p99_ms"]
    assert link["count"] >= 50
    assert report["states"]["count"] > 10
    assert report["host"]["mode"] == Mode.DISARMED
    assert report["host"]["version"] == iher_robot.__version__
    assert report["spec"]["control_period_s"] == 0.04
    assert not [finding for finding in report["findings"] if "stopped" in str(finding)]


def test_doctor_finds_a_latched_fault(run: Run, served: ServedRobot) -> None:
    assert run("stop", "--connect", served.endpoint, "--reason", "smoke").code == 0
    outcome = run("doctor", "--connect", served.endpoint)
    assert outcome.code == 1, outcome
    assert f"clear-fault {EMERGENCY_STOP}" in outcome.out
    assert "smoke" in outcome.out


def test_doctor_finds_an_object_without_a_pose(run: Run, tmp_path: Path) -> None:
    with ServedRobot(tmp_path / "memory", "--perception", "object0") as served:
        outcome = run("doctor", "--connect", served.endpoint)
        assert outcome.code == 1, outcome
        assert "no pose of object0 was received yet" in outcome.out


def test_doctor_moves_no_physical_robot(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = FakeRobot()
    monkeypatch.setattr(robot_link_module, "make_driver", lambda *_, **__: robot)
    outcome = run("doctor", "--driver", "mujoco")
    assert "PHYSICAL" in outcome.out
    assert "reset" not in robot.calls
    assert not robot.is_open


def test_doctor_of_a_simulation_in_this_process(run: Run) -> None:
    outcome = run("doctor", "--driver", "mujoco")
    assert outcome.code == 0, outcome
    assert "nothing is wrong" in outcome.out
    outcome = run("doctor", "--driver", "mujoco", "--robot", "fetch-mocap")
    assert outcome.code == 1, outcome
    assert "joint limits" in outcome.out


def command(*words: str) -> list[str]:
    return [sys.executable, "-m", "iher_robot", *words]
