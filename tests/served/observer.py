"""A client that records the states of a served robot, without a lease."""

from __future__ import annotations

import threading

from drivers import RobotSpec, RobotState
from drivers.closing import Closing
from drivers.remote.client import RobotClient
from drivers.remote.driver import read_spec
from drivers.remote.link import link_options
from drivers.remote.messages import SpecRequest
from drivers.remote.state_message import HostInfo, unpack_state


class Observer(Closing):
    """Keeps every state that it receives, in order.

    Attributes:
        spec: The robot.
        seen: States, with the status of the host.
    """

    def __init__(self, endpoint: str) -> None:
        self._client = RobotClient(link_options({"connect": [endpoint], "timeout_s": 2.0}))
        reply = self._client.request("spec", SpecRequest(), 60.0)
        self.spec: RobotSpec = read_spec(reply.result["spec"])
        self.seen: list[tuple[RobotState, HostInfo]] = []
        self._arrived = threading.Event()
        self._client.listen(self._take)

    @property
    def newest(self) -> tuple[RobotState, HostInfo]:
        assert self._arrived.wait(5.0), "a host publishes states"
        return self.seen[-1]

    @property
    def client(self) -> RobotClient:
        return self._client

    def close(self) -> None:
        self._client.close()

    def _take(self, data: bytes, received_ns: int) -> None:
        self.seen.append(unpack_state(data, self.spec, received_ns))
        self._arrived.set()
