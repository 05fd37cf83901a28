"""Settings of a host."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class HostSettings:
    """Settings of one host, shared by its processes.

    Attributes:
        name: Name of the robot on the network.
        driver: Name of the driver.
        options: Options of the driver.
        listen: Zenoh endpoints to listen on.
        memory_path: Folder that outlives the host: latched fault, tick counter, ledger.
        scene: The only scene served; None serves the one that a client's task needs.
        security_path: File with certificates, users and roles; None for none.
        insecure: Whether to listen beyond this machine without security.
        without_joint_limits: Whether to serve a robot that enforces no joint limits.
        perception: Objects whose poses come from another publisher.
        deadman_s: Silence after which an armed client is disarmed.
        command_age_ticks: Greatest age of a state that a command may answer, in control ticks.
        lease_s: Silence after which a client loses its lease.
        tick_log_path: File that gets a line for each control tick; None for none.
    """

    name: str
    driver: str
    options: Mapping[str, Any]
    listen: tuple[str, ...]
    memory_path: Path
    scene: str | None = None
    security_path: Path | None = None
    insecure: bool = False
    without_joint_limits: bool = False
    perception: tuple[str, ...] = field(default=())
    deadman_s: float = 0.2
    command_age_ticks: float = 2.0
    lease_s: float = 2.0
    tick_log_path: Path | None = None
