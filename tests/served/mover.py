"""A client that keeps a remote robot moving: ``python -m tests.served.mover ENDPOINT [HOW]``.

It prints a line per tick. HOW it ends after 40 ticks: ``never``, ``silent`` (alive, but sends
nothing more) or ``disconnected`` (the session is closed without releasing the lease).
"""

from __future__ import annotations

import sys
import time

import numpy as np

from drivers import ResetRequest
from drivers.remote import ZenohDriver, link_options
from iher_robot.env.controller import make_controller

_TICKS = 40


def main(endpoint: str, how: str) -> None:
    driver = ZenohDriver(link_options({"connect": [endpoint], "timeout_s": 2.0}), "push")
    controller = make_controller(driver.spec, True)
    driver.open()
    driver.reset(ResetRequest())
    driver.arm()
    tick = 0
    while how == "never" or tick < _TICKS:
        state = driver.read()
        action = np.array([0.5 * np.cos(tick / 4), 0.5 * np.sin(tick / 4), 0.0, 0.0])
        driver.command(controller.command(action, state))
        driver.advance()
        tick += 1
        sys.stdout.write(f"{tick}\n")
        sys.stdout.flush()
    if how == "disconnected":
        assert driver._client is not None
        driver._client.close()
    time.sleep(60.0)


if __name__ == "__main__":
    main(*sys.argv[1:])
