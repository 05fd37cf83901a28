"""Examine a robot and the link to it: the application behind ``iher-robot doctor``."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from drivers import ResetOutcome, ResetRequest, StaleState
from drivers.remote.client import RobotClient
from drivers.remote.driver import read_spec
from drivers.remote.messages import SpecRequest
from drivers.remote.quality import measure_link
from drivers.remote.state_stream import listen_to_states
from drivers.remote.status import printable, read_status
from iher_robot.config.robot import REMOTE_DRIVER, ChosenRobot
from iher_robot.config.robot_link import link_of, make_robot
from iher_robot.deployment.diagnosis import Examination, Remote
from iher_robot.env.goal_env import ResetFailed

_PINGS = 100
_LISTENING_S = 2.0


@dataclass(frozen=True)
class Report:
    """Result of an examination.

    Attributes:
        title: Name of the robot, and where it is reached.
        facts: Specification and state as text, by name.
        findings: A sentence per problem, with what to do.
        measured: The measurements as plain JSON data.
    """

    title: str
    facts: Mapping[str, str]
    findings: tuple[str, ...]
    measured: Mapping[str, Any]

    def text(self) -> str:
        """The report as text."""
        width = max(map(len, self.facts), default=0)
        lines = [f"{name:{width}}  {fact}" for name, fact in self.facts.items()]
        problems = [f"problem: {finding}" for finding in self.findings] or ["nothing is wrong"]
        return "\n".join([self.title, *lines, "", *problems])

    def to_dict(self) -> dict[str, Any]:
        """The report as plain JSON data."""
        return {"title": self.title, "findings": list(self.findings), **self.measured}


def doctor(robot: ChosenRobot) -> Report:
    """Examine a robot; a physical one, or one on the network, does not move.

    Args:
        robot: The robot.

    Raises:
        UserError: Bad input, or a simulated robot that does not reach home.
        DriverError: It cannot be reached.
    """
    remote = robot.driver == REMOTE_DRIVER
    examined = _examine_remote(robot) if remote else _examine_local(robot)
    title = robot.title
    if remote:
        link = link_of(robot)
        title = f"robot {link.robot!r} at {', '.join(link.connect)}"
    return Report(
        title=title,
        facts={name: printable(fact) for name, fact in examined.facts().items()},
        findings=tuple(map(printable, examined.findings())),
        measured=_measured(examined),
    )


def _examine_remote(robot: ChosenRobot) -> Examination:
    options = link_of(robot)
    with RobotClient(options) as client:
        before = read_status(client)
        reply = client.request("spec", SpecRequest(), options.reset_timeout_s)
        spec = read_spec(reply.result["spec"])
        listener = listen_to_states(client, spec)
        threading.Event().wait(_LISTENING_S)
        resets = before.total_ticks.get("reset", 0)
        after = read_status(client)
        states = listener.result(skipped=after.total_ticks.get("reset", 0) - resets)
        link = measure_link(client, _PINGS)
        status = read_status(client)
    overruns = max(0, status.tick_overruns - before.tick_overruns)
    fault = status.fault
    return Examination(
        spec=spec,
        state=states.newest,
        now_ns=states.received_ns,
        homed=False,
        fault=None if fault is None else (fault.name, fault.reason),
        remote=Remote(status, link, states, overruns),
    )


def _examine_local(robot: ChosenRobot) -> Examination:
    with make_robot(robot) as driver:
        homed = not driver.spec.physical and driver.fault is None
        if homed:
            result = driver.reset(ResetRequest())
            if result.outcome is not ResetOutcome.DONE:
                raise ResetFailed(
                    f"reset of {driver.spec.name} ended as {result.outcome}: {result.message}"
                )
        try:
            state = driver.measure()
        except StaleState:
            state = None
        fault = driver.fault
        return Examination(
            spec=driver.spec,
            state=state,
            now_ns=driver.now_ns,
            homed=homed,
            fault=None if fault is None else (fault.name, fault.reason),
        )


def _measured(examined: Examination) -> dict[str, Any]:
    remote, state = examined.remote, examined.state
    measured: dict[str, Any] = {
        "spec": examined.spec.to_dict(),
        "ee_pos": None if state is None else state.ee_pos.tolist(),
        "link": None,
        "states": None,
        "host": None,
    }
    if remote is None:
        return measured
    states = asdict(remote.states)
    del states["newest"], states["received_ns"]
    return measured | {
        "link": asdict(remote.link),
        "states": states,
        "host": remote.status.model_dump(mode="json"),
    }
