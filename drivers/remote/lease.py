"""The client's side of a lease, the right to command a remote robot: acquire, renew, release."""

from __future__ import annotations

import getpass
import os
import platform
import threading
import time
import uuid

from drivers.errors import DriverError, LeaseRefused
from drivers.remote.client import RobotClient
from drivers.remote.messages import LeaseRequest

_RENEWALS = 4
"""Renewals in the time after which an unrenewed lease ends."""
_RETRY_PERIOD_S = 0.2
_RELEASE_TIMEOUT_S = 0.3


class ClientLease:
    """The lease of one client. A separate thread renews it.

    Attributes:
        token: Token that commands must carry, 0 without a lease.
        boot: Identifies the start of the host that granted it.
        session: Identifies this client, which may acquire its own lease again.
        seq: The robot's tick counter when it was granted; earlier states do not show it.
    """

    def __init__(self, scene: str | None) -> None:
        """Start without a lease.

        Args:
            scene: The scene that the task needs; None for the current one.
        """
        self.token = 0
        self.boot = ""
        self.seq = 0
        self.session = uuid.uuid4().hex
        self._scene = scene
        self._client: RobotClient | None = None
        self._ended = threading.Event()
        self._renewing: threading.Thread | None = None

    def acquire(self, client: RobotClient, patience_s: float) -> None:
        """Acquire the lease; retry while another client has it.

        Args:
            client: Session with the host.
            patience_s: How long to try; the lease of a client that died expires.

        Raises:
            LeaseRefused: Another client keeps it.
            LinkLost: The host does not answer.
        """
        deadline = time.monotonic() + patience_s
        while True:
            try:
                ttl_s = self._ask(client)
                break
            except LeaseRefused:
                if time.monotonic() >= deadline:
                    raise
                time.sleep(_RETRY_PERIOD_S)
        self._client = client
        self._ended = threading.Event()
        self._renewing = threading.Thread(
            target=self._renew, args=(client, ttl_s, self._ended), daemon=True, name="robot lease"
        )
        self._renewing.start()

    def release(self) -> None:
        """Release the lease; without an answer of the host it expires."""
        client, self._client = self._client, None
        self._ended.set()
        if client is None or not self.token:
            return
        try:
            client.request("lease", self._message("release"), _RELEASE_TIMEOUT_S)
        except DriverError:
            pass  # it expires
        finally:
            self.token = 0

    def _ask(self, client: RobotClient) -> float:
        # A scene may have to be loaded first.
        reply = client.request("lease", self._message("acquire"), client.options.reset_timeout_s)
        self.token, self.boot, self.seq = int(reply.result["token"]), reply.boot, reply.seq
        return float(reply.result["ttl_s"])

    def _renew(self, client: RobotClient, ttl_s: float, ended: threading.Event) -> None:
        while not ended.wait(ttl_s / _RENEWALS):
            try:
                client.request("lease", self._message("renew"), ttl_s / _RENEWALS)
            except LeaseRefused:
                return  # the next state or request reports it
            except DriverError:
                continue  # no reply, or the request was damaged in transit

    def _message(self, op: str) -> LeaseRequest:
        return LeaseRequest.model_validate(
            {
                "op": op,
                "session": self.session,
                "holder": f"{getpass.getuser()}@{platform.node()}:{os.getpid()}",
                "token": self.token,
                "scene": self._scene,
            }
        )
