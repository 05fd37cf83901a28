"""Latency of commands to a served robot and jitter of its ticks, alone and during training.

python bench/link.py [--rounds 3] [--seconds 64] [--out bench/results/NAME.json]

A host (iher-robot serve) on loopback, and a client that answers each state with the command to
hold the present setpoint. The host measures the round trip on its own clock, from packing a state
to the check of the command that answers it. In every second round iher-robot train runs too.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from bench.programs import host, program
from drivers import JointCommand, ResetRequest, StaleState
from drivers.remote import LinkOptions, ZenohDriver, link_options
from drivers.remote.client import RobotClient
from drivers.remote.messages import Empty
from iher_robot.storage.provenance import collect_provenance

START_S = 120.0
PINGS = 500
TARGETS_MS = {"state to command ms, p50": 1.5, "state to command ms, p99": 5.0}


@contextmanager
def training(folder: Path) -> Iterator[int]:
    """Run a learner; yield its process once it computes."""
    run = folder / "run"
    options = ("--driver", "mujoco", "--task", "push", "--out", str(run), "--quiet")
    with program("train", *options, "--until-success", "off") as process:
        deadline = time.monotonic() + START_S
        while not (run / "checkpoint.pt").exists():
            if process.poll() is not None or time.monotonic() > deadline:
                raise SystemExit("training did not start; try it by hand: iher-robot train")
            time.sleep(0.2)
        yield process.pid
        if process.poll() is not None:
            raise SystemExit("training ended before the round did")


def busy_s(pid: int) -> float:
    """CPU seconds of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def real_time(watchdog: int) -> bool:
    """Whether a process of the host was given real-time scheduling."""
    children = Path(f"/proc/{watchdog}/task/{watchdog}/children").read_text().split()
    return any(os.sched_getscheduler(int(child)) == os.SCHED_RR for child in children)


def answer_states(driver: ZenohDriver, ticks: int) -> dict[str, float]:
    """Answer each state for a number of ticks; count the problems."""
    driver.arm()
    disarmed, begun = 0, driver.measure().seq
    for _ in range(ticks):
        if not driver.is_armed:  # too late for the deadman
            disarmed += 1
            driver.arm()
        try:
            state = driver.read()
        except StaleState:
            driver.advance()
            continue
        setpoint = state.setpoint
        assert setpoint is not None
        hold = JointCommand(
            state.seq,
            setpoint.q,
            np.zeros_like(setpoint.q),
            driver.spec.control_period_s,
            setpoint.fingers,
        )
        driver.command(hold)
        driver.advance()
    seen = driver.measure().seq - begun
    return {"ticks": seen, "ticks not seen": seen - ticks, "disarmed by the deadman": disarmed}


def status(options: LinkOptions) -> dict[str, Any]:
    with RobotClient(options) as client:
        return client.request("status", Empty()).result


def measure(options: LinkOptions, seconds: float) -> dict[str, float]:
    """One round with a new host, whose statistics cover this round alone."""
    with ZenohDriver(options, "push") as driver:
        ticks = round(seconds / driver.spec.control_period_s)
        driver.reset(ResetRequest())
        before = status(options)
        counted = answer_states(driver, ticks)
        after = status(options)
        driver.disarm()
        pings = driver.measure_link(PINGS)
    refused = {
        reason: count - before["refusals"].get(reason, 0)
        for reason, count in after["refusals"].items()
    }
    return {
        "state to command ms, p50": after["answer_p50_ms"],
        "state to command ms, p99": after["answer_p99_ms"],
        "commands timed": after["answers_timed"],
        "commands refused": sum(refused.values()),
        "ping there and back ms, p50": pings.p50_ms,
        "ping there and back ms, p99": pings.p99_ms,
        "pings lost": pings.lost,
        "tick late ms, p50": after["tick_late_p50_ms"],
        "tick late ms, p99": after["tick_late_p99_ms"],
        "ticks overrun": after["tick_overruns"] - before["tick_overruns"],
        **counted,
    }


def one_round(seconds: float, beside_training: bool) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        with host(folder / "memory") as (endpoint, watchdog):
            options = link_options({"connect": [endpoint]})
            scheduled = {"real-time scheduling": float(real_time(watchdog))}
            if not beside_training:
                return measure(options, seconds) | scheduled
            with training(folder) as learner:
                computed, begun = busy_s(learner), time.monotonic()
                row = measure(options, seconds)
                share = (busy_s(learner) - computed) / (time.monotonic() - begun)
            return row | scheduled | {"cores that training used": share}


def table(found: dict[str, dict[str, list[float]]]) -> str:
    """Medians over rounds, with minimum and maximum."""
    names = list(found["beside training"])
    lines = [f"{'':30s}" + "".join(f"{where:>32s}" for where in found)]
    for name in names:
        line = f"{name:30s}"
        for rows in found.values():
            values = rows.get(name, [])
            cell = ""
            if values:
                middle = statistics.median(values)
                cell = f"{middle:,.2f}   ({min(values):,.2f} to {max(values):,.2f})"
            line += f"{cell:>32s}"
        if name in TARGETS_MS:
            line += f"   target, alone on an idle machine: {TARGETS_MS[name]:g}"
        lines.append(line.rstrip())
    return "\n".join(lines)


def main() -> None:
    """Measure in rounds, alone and during training in turn, and print medians."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=64.0, help="of each, 1,500 ticks are 60")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    provenance = collect_provenance(sys.argv, 0, datetime.now().astimezone())
    provenance["versions"] |= {name: version(name) for name in ("eclipse-zenoh", "msgpack")}
    load = os.getloadavg()[0]
    print(f"load before: {load:.2f}" + "; this machine is not idle" * (load > 0.5), flush=True)
    found: dict[str, dict[str, list[float]]] = {"alone": {}, "beside training": {}}
    for _ in range(options.rounds):
        for where, rows in found.items():
            row = one_round(options.seconds, beside_training=where == "beside training")
            for name, value in row.items():
                rows.setdefault(name, []).append(value)
    print(table(found))
    if options.out is not None:
        medians = {
            where: {name: statistics.median(values) for name, values in rows.items()}
            for where, rows in found.items()
        }
        measured = {
            "seconds": options.seconds,
            "load before": load,
            "median": medians,
            "all": found,
        }
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(json.dumps(provenance | measured, indent=2) + "\n")


if __name__ == "__main__":
    main()
