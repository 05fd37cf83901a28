"""What a host serves, and how strictly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class HostSettings:
    """Settings of one host. They travel to its processes.

    Attributes:
        name: Name of the robot on the network.
        driver: Name of the driver that moves it.
        options: For the driver.
        listen: Zenoh endpoints to listen on.
        memory_path: Folder that outlives the host: latched fault, tick counter, ledger.
        scene: The only scene served; None takes what a client's task needs.
        security_path: File with certificates, users and roles; None for none.
        insecure: Whether to listen beyond this machine without them.
        without_joint_limits: Whether to serve a robot whose joint limits nobody enforces.
        perception: Objects whose poses come from another publisher.
        deadman_s: Silence of an armed client after which it is disarmed.
        command_age_ticks: Age of the state that a command answers past which it is refused.
        lease_s: Silence of a client after which another may command.
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
