"""Deployment of a policy on a robot: checks, log, and all endings."""

from __future__ import annotations

import dataclasses
import io
import itertools
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from drivers import LinkLost, ResetOutcome, ResetRequest, ResetResult, RobotSpec
from iher_robot.cli import deploy as cli_deploy
from iher_robot.config.robot import choose_own_robot, choose_robot
from iher_robot.deployment import deploy as deploy_module
from iher_robot.deployment.deploy import DeployResult, deploy
from iher_robot.deployment.log import DeploymentLog
from iher_robot.env import goal_env as goal_env_module
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.env.operator import Operator
from iher_robot.errors import UserError
from iher_robot.evaluation.policy_file import PolicyFile, save_policy
from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.goal_model import Shapes
from iher_robot.learning.policy import Policy
from iher_robot.rollout.actor import PolicyActor
from iher_robot.storage.accounts import read_accounts
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.interface import read_interface
from tasks import make_task
from tests.drivers.fake_robot import PERIOD_S, FakeRobot, fake_spec

OUT = Path("log")
TICKS = 50


class Robot(FakeRobot):
    """Records its position at the end of each tick; can fail at one of them."""

    def __init__(self, spec: RobotSpec | None = None) -> None:
        super().__init__(spec)
        self.seen: list[tuple[int, list[float]]] = []
        self.before_tick: Callable[[int], None] = lambda tick: None
        self.away = np.zeros(3)

    def _advance(self) -> None:
        self.before_tick(len(self.seen) + 1)
        super()._advance()
        self.seen.append((self.seq, self.position.tolist()))

    def _reset(self, request: ResetRequest) -> ResetResult:
        result = super()._reset(request)
        self.position = self.position + self.away
        return result

    def fail_at(self, tick: int, error: BaseException) -> None:
        def fail(now: int) -> None:
            if now == tick:
                raise error

        self.before_tick = fail

    @property
    def left_alone(self) -> bool:
        return not (self.is_armed or self.is_open) and self.calls[-1] == "close"


@dataclass
class Quality:
    p50_ms: float
    p99_ms: float


class LinkedRobot(Robot):
    """Has a link of known quality."""

    quality = Quality(0.5, 1.0)

    def measure_link(self) -> Quality:
        assert self.is_open
        return self.quality


def saved(path: Path, env: GoalRobotEnv, **changes: Any) -> Path:
    shapes = Shapes(env.task.layout.obs_dim, env.task.goal_dim, 4, TICKS)
    policy = Policy.from_config(
        shapes,
        LearnerConfig(),
        generator=torch.Generator().manual_seed(0),
        device=torch.device("cpu"),
    )
    interface = env.policy_interface() | changes
    save_policy(path, PolicyFile(policy=policy.snapshot(), trained={}, **interface))
    return path


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in an empty folder, without a terminal."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    torch.set_num_threads(1)
    return tmp_path


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    return saved(tmp_path / "policy.pt", GoalRobotEnv(FakeRobot(), make_task("push")))


@pytest.fixture
def serve(monkeypatch: pytest.MonkeyPatch) -> Callable[[FakeRobot], None]:
    """Make every driver name return a robot."""
    return lambda robot: monkeypatch.setattr(goal_env_module, "make_driver", lambda *_, **__: robot)


@pytest.fixture
def robot(serve: Callable[[FakeRobot], None]) -> Robot:
    made = Robot()
    serve(made)
    return made


@pytest.fixture
def full_action(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every policy command full speed, back and forth."""
    ways: Iterator[float] = iter(np.where(np.arange(10_000) // 4 % 2 == 0, 1.0, -1.0))
    full = np.array([1.0, 1.0, 1.0, 0.0], np.float32)
    monkeypatch.setattr(PolicyActor, "act", lambda *_: full * np.float32(next(ways)))


def run(policy: Path, **options: Any) -> DeployResult:
    settings: dict[str, Any] = {"driver": "fake", "out": OUT, "speed": 1.0, "episodes": 2}
    settings |= {"yes": True, "echo": lambda _: None}
    return deploy(policy, **settings | options)


def ticks(out: Path = OUT) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "ticks.jsonl").read_text().splitlines()]


def document(out: Path = OUT) -> dict[str, Any]:
    found = json.loads((out / "deployment.json").read_text())
    assert isinstance(found, dict)
    return found


# Before anything moves


def test_a_dry_run_checks_everything_and_moves_nothing(policy: Path, robot: Robot) -> None:
    said: list[str] = []
    result = run(policy, dry_run=True, yes=False, speed=0.5, echo=said.append)

    assert set(robot.calls) <= {"open", "read", "hold", "close"}
    assert robot.left_alone
    assert result.summary() == "dry run: nothing has moved"
    assert not OUT.exists()
    (plan,) = said
    for part in ("push", "PHYSICAL", "shoulder 1", "end effector up to 1.25 m/s", "x 0 to 1"):
        assert part in plan
    assert "2 of 100 ticks of 40 ms (50 at full speed): 0.13 robot minutes" in plan
    assert "refused" not in plan
    assert "warning" not in plan


def test_without_a_terminal_it_does_not_start_unconfirmed(policy: Path, robot: Robot) -> None:
    with pytest.raises(UserError, match=r"no terminal.*--yes"):
        run(policy, yes=False)
    with pytest.raises(UserError, match=r"no terminal.*--label"):
        run(policy, label=True)
    assert robot.calls == []


@pytest.mark.parametrize("answer", ["", "n", "later"])
def test_it_starts_after_a_yes_only(policy: Path, robot: Robot, answer: str) -> None:
    with pytest.raises(UserError, match="not confirmed; nothing has moved"):
        run(policy, yes=False, ask=lambda _: answer)
    assert "reset" not in robot.calls
    assert robot.left_alone
    assert not OUT.exists()

    assert len(run(policy, yes=False, ask=lambda _: "y").episodes) == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"episodes": 0}, "episodes is 0, allowed: 1 or more"),
        ({"seed": -1}, "seed is -1"),
        ({"speed": 0.0}, "speed is 0.0, allowed: above 0"),
        ({"speed": 1.5}, "speed is 1.5"),
        ({"speed": float("nan")}, "speed is nan"),
        ({"task": "reach"}, "the policy is for task 'push', not 'reach'"),
    ],
)
def test_bad_input_is_refused_without_a_connection(
    policy: Path, robot: Robot, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UserError, match=message):
        run(policy, **options)
    assert robot.calls == []


def simulated(spec: RobotSpec) -> RobotSpec:
    return dataclasses.replace(spec, physical=False, hold_on_silence_s=None)


def test_another_interface_is_accepted_by_a_simulated_robot_only(
    policy: Path, serve: Callable[[FakeRobot], None]
) -> None:
    other = dataclasses.replace(fake_spec(), frame="elsewhere")
    physical, harmless = Robot(other), Robot(simulated(other))
    for robot, accept in ((physical, False), (physical, True), (harmless, False)):
        serve(robot)
        with pytest.raises(UserError, match=r'frame: "elsewhere", not "world"'):
            run(policy, accept_interface=accept)
        assert "reset" not in robot.calls
        assert robot.left_alone
    serve(harmless)
    result = run(policy, accept_interface=True)
    assert any('frame: "elsewhere"' in warning for warning in result.warnings)


def test_another_body_is_listed_and_needs_to_be_accepted(
    policy: Path, serve: Callable[[FakeRobot], None]
) -> None:
    robot = Robot(dataclasses.replace(fake_spec(), gains={"kp": 90.0}, calibration_id="new"))
    serve(robot)
    listed = r'calibration_id: "new", not "2024-05-01"; gains.kp: 90.0, not 100.0;'
    with pytest.raises(UserError, match=listed + ".*--accept-body"):
        run(policy)
    assert "reset" not in robot.calls

    result = run(policy, accept_body=True)
    assert len(result.episodes) == 2
    assert [listed.rstrip(";") in warning for warning in result.warnings] == [True]


def test_another_controller_is_a_warning(tmp_path: Path, robot: Robot) -> None:
    env = GoalRobotEnv(FakeRobot(), make_task("push"))
    settings = dict(env.controller.settings) | {"blocks_gripper": False}
    policy = saved(tmp_path / "other.pt", env, controller=settings)
    said: list[str] = []
    run(policy, dry_run=True, echo=said.append)
    assert "blocks_gripper" in said[0]
    assert "warning  controller" in said[0]


def test_a_latched_fault_is_named_with_the_command_that_clears_it(
    policy: Path, robot: Robot
) -> None:
    robot.stop("an operator pressed it", "panic")
    with pytest.raises(UserError, match=r"'panic'.*pressed it.*iher-robot clear-fault panic"):
        run(policy)
    assert "reset" not in robot.calls
    assert not OUT.exists()


@pytest.mark.parametrize(
    ("p99_ms", "verdict"),
    [(1.0, "ok"), (19.0, "ok"), (21.0, "warning"), (41.0, "refused"), (np.nan, "refused")],
)
def test_a_slow_link_is_refused(
    policy: Path, serve: Callable[[FakeRobot], None], p99_ms: float, verdict: str
) -> None:
    robot = LinkedRobot()
    robot.quality = Quality(0.5, p99_ms)
    serve(robot)
    said: list[str] = []
    if verdict == "refused":
        with pytest.raises(UserError, match="a control period of 40 ms"):
            run(policy, dry_run=True, echo=said.append)
    else:
        run(policy, dry_run=True, echo=said.append)
    assert f"{verdict:8} link" in said[0]


def test_a_folder_that_is_not_empty_is_refused(policy: Path, robot: Robot) -> None:
    OUT.mkdir()
    (OUT / "kept").touch()
    with pytest.raises(UserError, match=r"log is not empty; choose another with --out"):
        run(policy)
    assert "reset" not in robot.calls
    assert [file.name for file in OUT.iterdir()] == ["kept"]


# While it runs


def test_the_log_has_a_line_for_each_tick_with_what_the_robot_reported(
    policy: Path, robot: Robot, full_action: None
) -> None:
    result = run(policy)

    lines = ticks()
    assert [(line["episode"], line["tick"]) for line in lines] == [
        (episode, tick) for episode in (1, 2) for tick in range(1, TICKS + 1)
    ]
    assert [(line["seq"], line["ee_pos"]) for line in lines] == robot.seen
    for line in lines:
        assert line["error"] is None
        assert (line["tick_valid"], line["ticks"], line["refusal"]) == (True, 1, None)
        moved = np.array(line["ee_linvel"]) * PERIOD_S / robot.spec.action.position_scale_m
        np.testing.assert_allclose(line["applied"][:3], moved, atol=1e-6)
        if not line["clipped"]:
            assert line["applied"] == line["requested"]
        np.testing.assert_allclose(line["next_observation"][:3], line["ee_pos"])
        assert min(line["policy_ms"], line["step_ms"]) > 0
    for line, following in itertools.pairwise(lines[:TICKS]):
        assert line["next_observation"] == following["observation"]
    assert result.ticks == len(lines)
    assert result.robot_minutes == pytest.approx(100 * PERIOD_S / 60)


def test_lines_are_numbered_by_the_ticks_charged_though_some_passed_unseen(
    policy: Path, robot: Robot
) -> None:
    def lose_ticks(tick: int) -> None:
        robot.lost_ticks = 2 if tick == 3 else 0

    robot.before_tick = lose_ticks
    result = run(policy, episodes=1)
    assert [line["tick"] for line in ticks()] == [1, 2, 3, *range(6, TICKS + 1)]
    assert [line["ticks"] for line in ticks()][:4] == [1, 1, 3, 1]
    assert result.ticks == TICKS


def test_each_line_is_in_the_file_before_the_next_tick(policy: Path, robot: Robot) -> None:
    found: list[int] = []
    robot.before_tick = lambda tick: found.append(len(ticks()))
    run(policy, episodes=1)
    assert found == list(range(TICKS))


def test_the_folder_records_settings_provenance_and_result(policy: Path, robot: Robot) -> None:
    result = run(policy, seed=3)
    found = document()
    assert found["ended"] == "done"
    assert found["settings"] == {"episodes": 2, "speed": 1.0, "seed": 3, "label": False}
    assert found["body_digest"] == robot.spec.body_digest
    assert len(found["policy_sha256"]) == 64
    assert found["provenance"]["versions"]["torch"]
    assert found["episodes"] == [dataclasses.asdict(record) for record in result.episodes]
    assert [episode["ended"] for episode in found["episodes"]] == ["done", "done"]
    assert f"log     {OUT}: done, 2 episodes, 100 ticks" in result.summary()


def test_ticks_of_a_deployment_are_stored_and_charged_like_those_of_a_run(
    policy: Path, robot: Robot
) -> None:
    robot.fail_at(TICKS + 8, LinkLost("gone"))
    with pytest.raises(UserError, match="gone"):
        deploy(policy, episodes=3, speed=1.0, yes=True, out=OUT)
    assert read_accounts(OUT / "ledger.sqlite").spent["deployment"] == TICKS + 8
    with EpisodeReader(OUT / "episodes") as reader:
        stored = list(reader)
    assert [len(episode.episode) for episode in stored] == [TICKS, 7]
    assert [episode.account for episode in stored] == ["deployment"] * 2
    assert stored[0].ended == "done"
    assert "gone" in stored[1].ended
    seqs = [int(seq) for episode in stored for seq in episode.seqs]
    assert seqs == [seq for seq, _ in robot.seen]
    assert read_interface(OUT / "episodes")["task"] == "push"


def test_folders_are_named_by_time_and_task(policy: Path, robot: Robot) -> None:
    result = run(policy, out=None)
    assert result.directory is not None
    assert result.directory.parent == Path("deployments")
    assert result.directory.name.endswith("Z-push")


@pytest.mark.parametrize("share", [0.1, 0.25])
def test_the_speed_limit_is_enforced_and_episodes_last_longer(
    policy: Path, robot: Robot, full_action: None, share: float
) -> None:
    run(policy, speed=share, episodes=1)
    lines = ticks()
    most = share * robot.spec.limits.max_ee_speed_m_s
    assert len(lines) == round(TICKS / share)
    assert max(np.linalg.norm(line["ee_linvel"]) for line in lines) == pytest.approx(most)
    assert all("ee_speed" in line["clipped"] for line in lines)


def test_the_joints_of_the_simulated_robot_are_slowed(tmp_path: Path, full_action: None) -> None:
    with choose_robot("mujoco", None).make_env("reach") as env:
        policy, spec = saved(tmp_path / "reach.pt", env), env.robot_spec
    fastest = {}
    for share in (1.0, 0.25):
        out = tmp_path / str(share)
        run(policy, driver="mujoco", speed=share, episodes=1, out=out)
        fastest[share] = max(np.linalg.norm(line["ee_linvel"]) for line in ticks(out))
        limits = np.array([joint.max_velocity for joint in spec.limits.joints.values()])
        measured = np.abs([line["dq"] for line in ticks(out)]).max(axis=0)
        assert (measured < 1.1 * share * limits + 0.02).all()
    assert fastest[0.25] < 0.27 * spec.limits.max_ee_speed_m_s
    assert fastest[1.0] > 2 * fastest[0.25]


def test_the_operators_label_counts_and_the_tasks_is_kept(policy: Path, robot: Robot) -> None:
    answers = iter(["perhaps", "y", "n", ""])
    said: list[str] = []
    result = run(policy, episodes=3, label=True, ask=lambda _: next(answers), echo=said.append)

    records = document()["episodes"]
    assert [record["operator_success"] for record in records] == [True, False, None]
    by_task = [record["task_success"] for record in records]
    assert [record["success"] for record in records] == [True, False, by_task[2]]
    assert result.successes == 1 + by_task[2]
    assert f"{sum(by_task)} of 3 succeeded according to the task" in result.summary()
    assert "episode 1 of 3: success, 50 ticks" in said


def test_an_operator_is_asked_for_help_with_a_reset(policy: Path, robot: Robot) -> None:
    asked: list[str] = []

    def answer(question: str) -> str:
        asked.append(question)
        assert not robot.is_armed
        return ""

    robot.outcomes = [ResetOutcome.NEEDS_HUMAN]
    run(policy, ask=answer)
    assert len(asked) == 1
    assert "the object fell off the table; press Enter" in asked[0]

    robot.outcomes = [ResetOutcome.NEEDS_HUMAN]
    with pytest.raises(UserError, match=r"needs_human: the object fell.*0 of 1 episodes"):
        run(policy, out=Path("other"))
    assert robot.left_alone


def test_the_end_of_the_input_does_not_confirm_clear_hands() -> None:
    def closed(_: str) -> str:
        raise EOFError

    operator = Operator(closed)
    with pytest.raises(UserError, match="no answer to 'lift it'"):
        operator.help("lift it")
    assert not operator.confirms("Start?")
    assert operator.label(True) is None


def test_a_robot_that_is_not_at_home_after_its_reset_does_not_act(
    policy: Path, robot: Robot
) -> None:
    robot.away = np.array([0.0, 0.06, 0.0])
    with pytest.raises(UserError, match=r"6\.0 cm from home, allowed: 5 cm"):
        run(policy)
    assert "apply" not in robot.calls
    assert robot.left_alone

    robot.away = np.array([0.0, 0.04, 0.0])
    assert len(run(policy, out=Path("other")).episodes) == 2


def test_a_joint_outside_its_range_prevents_the_start(
    policy: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = FakeRobot._read
    monkeypatch.setattr(
        FakeRobot, "_read", lambda self: dataclasses.replace(read(self), q=np.array([1.2]))
    )
    said: list[str] = []
    with pytest.raises(UserError, match=r"shoulder is at 1\.2000, allowed: -1 to 1"):
        run(policy, echo=said.append)
    assert "warning  joints now" in said[0]
    assert "apply" not in robot.calls


# Endings


def test_an_interrupt_in_a_tick_leaves_the_robot_held_and_the_log_whole(
    policy: Path, robot: Robot
) -> None:
    robot.fail_at(TICKS + 7, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt) as interrupt:
        run(policy)

    assert robot.left_alone
    lines = ticks()
    assert [(line["seq"], line["ee_pos"]) for line in lines[:-1]] == robot.seen
    assert len(lines) == TICKS + 7
    assert lines[-1]["error"] == "interrupted"
    assert (lines[-1]["seq"], lines[-1]["applied"]) == (None, None)
    assert len(lines[-1]["requested"]) == 4
    found = document()
    assert found["ended"] == "interrupted"
    assert [record["ticks"] for record in found["episodes"]] == [TICKS, 7]
    assert [record["ended"] for record in found["episodes"]] == ["done", "interrupted"]
    (note,) = interrupt.value.__notes__
    assert note == f"the robot is held and disarmed; 0 of 2 episodes succeeded, 57 ticks in {OUT}"


def test_an_interrupt_between_ticks_logs_no_tick(
    policy: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    act, chosen = PolicyActor.act, 0

    def interrupted(*arguments: Any) -> Any:
        nonlocal chosen
        chosen += 1
        if chosen == 5:
            raise KeyboardInterrupt
        return act(*arguments)

    monkeypatch.setattr(PolicyActor, "act", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(policy)
    assert robot.left_alone
    assert [line["seq"] for line in ticks()] == [seq for seq, _ in robot.seen]
    assert len(robot.seen) == 4
    assert document()["episodes"][0]["ticks"] == 4


def test_a_robot_that_is_lost_ends_the_deployment_with_one_sentence(
    policy: Path, robot: Robot
) -> None:
    robot.fail_at(5, LinkLost("fake did not send a state within 1 s"))
    with pytest.raises(UserError) as error:
        run(policy, episodes=3)
    assert str(error.value) == (
        f"fake did not send a state within 1 s; 0 of 1 episodes succeeded, 5 ticks in {OUT}"
    )
    assert robot.left_alone
    assert document()["ended"].startswith("LinkLost: ")
    assert "did not send a state" in ticks()[-1]["error"]
    assert document()["episodes"][0]["ended"].startswith("episode on fake aborted: fake did not")


def test_an_absent_robot_gives_the_drivers_own_sentence(
    policy: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent() -> None:
        raise LinkLost("no host answers; start a robot")

    monkeypatch.setattr(robot, "_open", absent)
    with pytest.raises(LinkLost, match=r"^no host answers; start a robot$"):
        run(policy)
    assert not OUT.exists()


def test_a_bug_is_not_hidden_and_says_what_is_logged(policy: Path, robot: Robot) -> None:
    robot.fail_at(3, ZeroDivisionError("a bug"))
    with pytest.raises(ZeroDivisionError, match="a bug") as bug:
        run(policy)
    assert bug.value.__notes__ == [f"0 of 1 episodes succeeded, 3 ticks in {OUT}"]
    assert robot.left_alone


def test_an_aborted_episode_fails_and_the_next_one_is_run(
    policy: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(goal_env_module.GoalRobotEnv, "_abort_if_lost", _abort_at(robot, 10))
    said: list[str] = []
    # Whatever label the operator would give.
    result = run(policy, label=True, ask=lambda _: "y", echo=said.append)

    assert [record.ticks for record in result.episodes] == [10, TICKS]
    assert [record.success for record in result.episodes] == [False, True]
    assert (result.aborted, result.episodes[0].operator_success) == (1, None)
    assert "episode 1 of 2: too slow, 10 ticks" in said
    assert "aborted 1 of 2, counted as failures" in result.summary()
    assert "too slow" in ticks()[9]["error"]


@pytest.mark.parametrize(("answer", "episodes"), [("n", 1), ("y", 2)])
def test_after_an_aborted_episode_the_operator_decides(
    policy: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch, answer: str, episodes: int
) -> None:
    monkeypatch.setattr(goal_env_module.GoalRobotEnv, "_abort_if_lost", _abort_at(robot, 10))
    result = run(policy, yes=False, ask=lambda asked: answer if "Go on" in asked else "y")
    assert len(result.episodes) == episodes


def _abort_at(robot: Robot, tick: int) -> Callable[..., None]:
    def abort(*_: object) -> None:
        if len(robot.seen) == tick:
            raise goal_env_module.EpisodeAborted("too slow")

    return abort


def test_an_external_stop_ends_the_deployment(policy: Path, robot: Robot) -> None:
    def stop(tick: int) -> None:
        if tick == 4:
            robot.stop("an operator pressed it", "panic")

    robot.before_tick = stop
    with pytest.raises(UserError, match=r"clear-fault panic; 0 of 1 episodes succeeded"):
        run(policy)
    assert robot.calls.count("reset") == 1
    assert robot.left_alone
    assert document()["episodes"][0]["ended"].startswith("episode on fake aborted")


# Selection of the robot, and the command


def test_the_robot_is_named_or_in_the_folder_or_on_this_machine(folder: Path) -> None:
    choose = choose_own_robot
    here = choose(None, None, ())
    assert (here.driver, here.options) == ("zenoh", {"robot": "fetch"})
    assert choose("mujoco", None, ()).title == "mujoco fetch"
    assert choose(None, "arm", ("tcp/a:1",)).options == {"robot": "arm", "connect": ["tcp/a:1"]}

    (folder / "robot.yaml").write_text("driver: mujoco\nactuation: mocap\n")
    mine = choose(None, None, ())
    assert (mine.driver, mine.name, mine.options) == (
        "mujoco",
        "robot.yaml",
        {"actuation": "mocap"},
    )
    assert choose("zenoh", None, ()).name == "fetch"
    (folder / "robot.yaml").write_text("robot: arm\n")
    assert choose(None, None, ()).driver == "zenoh"


def test_the_command_passes_its_options_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given: dict[str, Any] = {}
    result = DeployResult("push", "zenoh fetch", (), 0.04, (), None)

    def record(*policy: Path, **options: Any) -> DeployResult:
        given.update(options, policy=policy)
        return result

    monkeypatch.setattr(deploy_module, "deploy", record)
    cli_deploy.deploy(Path("p.pt"), robot="arm", connect=["tcp/a:1"], dry_run=True, speed=0.5)
    given.pop("echo")
    assert given == {
        "policy": (Path("p.pt"),),
        "driver": None,
        "robot": "arm",
        "connect": ["tcp/a:1"],
        "task": None,
        "episodes": 10,
        "speed": 0.5,
        "seed": 0,
        "dry_run": True,
        "yes": False,
        "label": False,
        "out": None,
        "accept_body": False,
        "accept_interface": False,
    }
    assert capsys.readouterr().out == "dry run: nothing has moved\n"


def test_non_finite_numbers_are_null_in_the_log(tmp_path: Path) -> None:
    with DeploymentLog.create(tmp_path / "made", {"speed": float("inf")}) as log:
        log.tick({"q": np.array([1.0, np.nan]), "mode": "held", "lost": float("-inf")})
    assert ticks(tmp_path / "made") == [{"q": [1.0, None], "mode": "held", "lost": None}]
    assert document(tmp_path / "made")["speed"] is None
