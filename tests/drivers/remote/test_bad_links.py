"""Links that lose, delay, reorder, repeat and damage messages, and links that are cut."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from drivers import (
    Command,
    DriverError,
    JointCommand,
    LeaseRefused,
    LinkLost,
    Mode,
    ResetRequest,
    RobotState,
)
from drivers.remote import ZenohDriver
from drivers.remote.messages import Empty
from drivers.remote.state_message import HostInfo
from iher_robot.env.controller import make_controller
from iher_robot.env.goal_env import EpisodeAborted, GoalRobotEnv, make_env
from tests.served.faulty_link import NO_FAULTS, TO_HOST, Faults, FaultyLink
from tests.served.limits import assert_within_limits
from tests.served.observer import Observer
from tests.served.served_robot import ServedRobot, eventually

pytestmark = pytest.mark.real_time

TICKS = 80
PATIENCE_S = 60.0
LATEST_TICKS = 3
"""A command may be two ticks old when it arrives, and is applied in the next tick."""
CUT_S = 3.0
EPISODES = 5
WATCHDOG_TICKS = 5  # 0.2 s
STILL = 5e-3

FAULTS = {
    "drop": Faults(drop=0.2),
    "delay": Faults(delay_ms=(50.0, 150.0)),
    "reorder": Faults(delay_ms=(0.0, 30.0), swap=0.3),
    "duplicate": Faults(delay_ms=(0.0, 60.0), duplicate=0.5),
    "truncate": Faults(truncate=0.2),
    "all": Faults(drop=0.2, delay_ms=(0.0, 60.0), swap=0.1, duplicate=0.1, truncate=0.1),
}


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedRobot]:
    with ServedRobot(tmp_path_factory.mktemp("memory")) as host:
        yield host


@dataclass
class Drive:
    """A client that moves a robot, whatever the link does.

    Attributes:
        sent: Commands sent, by the state that they answer.
        errors: Errors raised by the driver.
        at_start: Whether the robot was reset since it was opened.
    """

    driver: ZenohDriver
    sent: dict[int, Command] = field(default_factory=dict)
    errors: list[DriverError] = field(default_factory=list)
    at_start: bool = False

    def run(self, ticks: int) -> None:
        """Run a number of ticks, starting again after each error."""
        controller = make_controller(self.driver.spec, True)
        done, deadline = 0, time.monotonic() + PATIENCE_S
        while done < ticks and time.monotonic() < deadline:
            try:
                self._make_ready()
                while done < ticks and self.driver.is_armed:
                    action = 0.8 * np.array([np.cos(done / 5), np.sin(done / 5), 0.0, 0.0])
                    command = controller.command(action, self.driver.read())
                    assert command.answers not in self.sent, "each answers another state"
                    self.sent[command.answers] = command
                    self.driver.command(command)
                    self.driver.advance()
                    done += 1
            except DriverError as error:
                self.errors.append(error)
                if isinstance(error, LeaseRefused):
                    self.driver.close()
        assert done == ticks, f"{done} ticks in {PATIENCE_S} s, errors: {self.errors}"

    def _make_ready(self) -> None:
        if not self.driver.is_open:
            self.driver.open()
            self.at_start = False
        if not self.at_start:
            self.driver.reset(ResetRequest())
            self.at_start = True
        if not self.driver.is_armed:
            self.driver.arm()


def _advance_until_lost(driver: ZenohDriver) -> None:
    for _ in range(3):  # a state may have arrived before
        driver.advance()


def _driver(served: ServedRobot, link: FaultyLink) -> ZenohDriver:
    """Make a client behind a bad link, with short timeouts so that losses are detected quickly."""
    options: dict[str, Any] = {
        "connect": [link.endpoint],
        "timeout_s": 0.5,
        "reset_timeout_s": 1.0,
    }
    while True:
        try:
            return served.driver(**options)
        except DriverError:
            continue  # the request or its reply was lost


def _status(observer: Observer) -> dict[str, Any]:
    return observer.client.request("status", Empty()).result


def _applied(seen: list[tuple[RobotState, HostInfo]]) -> list[RobotState]:
    """States of the ticks in which a command moved the robot."""
    return [
        state for state, _ in seen if state.applied is not None and state.applied.tick == state.seq
    ]


def _assert_only_what_was_sent(applied: list[RobotState], sent: dict[int, Command]) -> None:
    answers = [state.applied.command.answers for state in applied if state.applied is not None]
    assert all(a < b for a, b in pairwise(answers)), (
        f"each command must be applied in one tick, and none after a later one: {answers}"
    )
    for state in applied:
        assert state.applied is not None
        command = state.applied.command
        age = state.seq - command.answers
        assert 1 <= age <= LATEST_TICKS, f"a command {age} ticks old was applied"
        asked = sent[command.answers]
        assert isinstance(command, JointCommand) and isinstance(asked, JointCommand)  # noqa: PT018
        if age == 1 and not state.applied.clipped:  # a later one starts from elsewhere
            np.testing.assert_allclose(command.q_target, asked.q_target, rtol=0, atol=1e-9)
            np.testing.assert_allclose(command.dq, asked.dq, rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", FAULTS)
def test_no_expired_repeated_or_late_command_is_applied(served: ServedRobot, kind: str) -> None:
    with (
        Observer(served.endpoint) as observer,
        FaultyLink(served.endpoint, FAULTS[kind], seed=7) as link,
    ):
        drive = Drive(_driver(served, link))
        before = Counter(_status(observer)["refusals"])
        drive.run(TICKS)
        faulty = _applied(observer.seen)
        refused = Counter(_status(observer)["refusals"]) - before
        link.faults = NO_FAULTS
        drive.driver.close()
        begun = len(observer.seen)
        drive.run(40)
        assert eventually(lambda: len(_applied(observer.seen[begun:])) >= 10), (
            "on a good link the same client moves the robot"
        )
        drive.driver.close()
        _assert_only_what_was_sent(_applied(observer.seen), drive.sent)
        assert_within_limits(observer.seen, observer.spec)
        assert sum(link.suffered.values()) >= (0 if kind == "delay" else TICKS / 10)
        assert _status(observer)["robot"], "the host is up and answers"
    if kind == "delay":
        assert not faulty
        assert refused["expired"] > TICKS / 2
    else:
        assert len(faulty) >= TICKS / 4, "commands that arrive in time must still be applied"


def test_late_states_from_before_a_lease_do_not_end_it(served: ServedRobot) -> None:
    with FaultyLink(served.endpoint, FAULTS["delay"], seed=5) as link:
        driver = _driver(served, link)
        for _ in range(6):
            driver.open()
            driver.advance()
            driver.close()


def test_a_cut_link_leaves_the_robot_held_and_heals(served: ServedRobot) -> None:
    with Observer(served.endpoint) as observer, FaultyLink(served.endpoint) as link:
        drive = Drive(_driver(served, link))
        drive.run(30)
        link.partitioned = True
        cut_at = observer.newest[0].seq
        with pytest.raises(LinkLost):
            _advance_until_lost(drive.driver)
        assert not drive.driver.is_armed
        assert eventually(lambda: observer.newest[0].seq > cut_at + CUT_S * 25)
        link.partitioned = False
        drive.driver.close()
        drive.run(20)
        drive.driver.close()
        seen = [(state, info) for state, info in observer.seen if state.seq > cut_at - 5]
    tripped = next(state.seq for state, info in seen if not info.armed)
    moved = max(s.seq for s, _ in seen if s.mode is Mode.MOVING and s.seq <= tripped)
    assert moved <= cut_at + LATEST_TICKS
    assert tripped - moved <= WATCHDOG_TICKS + 1, "the host disarms a silent client"
    still = [s for s, _ in seen if moved + WATCHDOG_TICKS <= s.seq <= cut_at + CUT_S * 25]
    assert max(float(np.abs(state.dq).max()) for state in still) < STILL
    assert _applied(seen)[-1].seq > cut_at + CUT_S * 25, "the robot moves again after the cut"


def test_training_episodes_on_a_lossy_link_end_or_abort_with_a_clear_error(
    served: ServedRobot,
) -> None:
    totals: Counter[str] = Counter()
    rng = np.random.default_rng(3)
    with (
        Observer(served.endpoint) as observer,
        FaultyLink(served.endpoint, seed=11) as link,
    ):
        options: dict[str, Any] = {
            "connect": [link.endpoint],
            "timeout_s": 1.0,
            "reset_timeout_s": 20.0,
        }
        env = make_env("reach", "zenoh", **options)
        before = _status(observer)["total_ticks"]["motion"]
        for episode in range(EPISODES):
            link.faults = NO_FAULTS  # the requests of a reset are not tested here
            env.reset(seed=episode)
            link.faults = FAULTS["drop"]
            totals.update(_run_lossy_episode(env, rng))
        link.faults = NO_FAULTS
        env.close()
        spent = _status(observer)["total_ticks"]["motion"] - before
    assert totals["steps"] >= 10
    assert totals["unseen"] > 0
    assert link.passed[TO_HOST, "cmd"] >= totals["steps"] / 2
    aborted = totals["aborted"]
    apart = aborted * (WATCHDOG_TICKS + 1) + 2 * (EPISODES - aborted)
    assert abs(spent - totals["charged"]) <= apart, (
        "host and client must count the same ticks, except at the ends of episodes"
    )


def _run_lossy_episode(env: GoalRobotEnv, rng: np.random.Generator) -> Counter[str]:
    """Run an episode; return its steps, ticks charged, ticks unseen, and whether it aborted."""
    totals: Counter[str] = Counter()
    seq = env.state.seq if env.state is not None else 0
    try:
        for _ in range(env.episode_ticks):
            _, _, _, _, info = env.step(rng.uniform(-1, 1, 4).astype(np.float32))
            assert env.state is not None
            elapsed, seq = env.state.seq - seq, env.state.seq
            assert info["ticks"] == max(1, elapsed)
            assert elapsed == 1 or not info["tick_valid"], "unseen ticks must not be learned from"
            totals.update(steps=1, charged=info["ticks"], unseen=elapsed - 1)
    except EpisodeAborted as error:
        totals.update(charged=error.ticks, aborted=1)
    return totals
