"""Driver of a remote robot, whose host is reached over Zenoh."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress

from pydantic import TypeAdapter, ValidationError

from drivers.clock import Clock, MonotonicClock
from drivers.command import (
    Command,
    Refusal,
    ResetOutcome,
    ResetRequest,
    ResetResult,
)
from drivers.driver import RobotDriver
from drivers.errors import DriverError, LeaseRefused, LifecycleError, LinkLost, StaleState
from drivers.gate import Fault
from drivers.remote.client import RobotClient
from drivers.remote.lease import ClientLease
from drivers.remote.link import LinkOptions
from drivers.remote.messages import (
    ArmRequest,
    ClearFaultRequest,
    Leased,
    ResetMessage,
    SpecRequest,
    command_fields,
)
from drivers.remote.newest import NewestState, Received
from drivers.remote.quality import LinkQuality, measure_link
from drivers.remote.state_message import HostInfo
from drivers.safety import SafetyFilter
from drivers.spec import RobotSpec
from drivers.state import RobotState
from drivers.validation import describe_first_problem
from drivers.wire import VERSION, pack

log = logging.getLogger(__name__)

_LOST_AFTER_TICKS = 3
"""Ticks after which a command that no state acknowledges counts as lost."""
_SPEC = TypeAdapter(RobotSpec)


class _RemoteSafety(SafetyFilter):
    """Checks commands, but does not limit them: the host, which trusts no client, does."""

    def limit(
        self,
        command: Command,
        state: RobotState,  # noqa: ARG002
        speed_scale: float,  # noqa: ARG002
    ) -> tuple[Command, tuple[str, ...]]:
        """Return the command unchanged."""
        return command, ()


class ZenohDriver(RobotDriver):
    """A robot whose host (``iher-robot serve``) has the safety filter, the deadman and the clock.

    `command` stores the command; `advance` sends it and waits for the end of the tick in which
    the host processed it, so that a command dropped in between never reaches the robot. While the
    gate is open every tick sends a message: the host disarms a silent client.

    Any call raises `LinkLost` if the link is lost, except `disarm`, `stop` and `close`: they log
    that the host did not confirm. Its deadman then holds the robot.
    """

    exclusive = True

    def __init__(
        self, options: LinkOptions, scene: str | None = None, clock: Clock | None = None
    ) -> None:
        """Request the robot's description from its host; the connection is closed again.

        Args:
            options: Address of the robot, and credentials.
            scene: The scene that the task needs; None for the current one.
            clock: This machine's monotonic clock.

        Raises:
            LinkLost: No host answers.
            DriverError: The host does not serve the scene.
        """
        spec, local = _ask_spec(options, scene), MonotonicClock() if clock is None else clock
        super().__init__(spec, local, _RemoteSafety(spec, local))
        self.options = options
        self._client: RobotClient | None = None
        self._lease = ClientLease(scene)
        self._newest = NewestState(self.spec, self._on_arrival)
        self._pending: Command | None = None
        self._sent = 0
        self._armed_at: int | None = None
        self._confirmed_stop: int | None = None
        self._lost: DriverError | None = None
        self._counted_before: tuple[Counter[str], Counter[str]] | None = None

    @property
    def refusals(self) -> Mapping[Refusal, int]:
        """Commands refused here, and by the host since this driver was first opened, by reason."""
        here, there = super().refusals, self._since_open(0)
        counted = {reason: here.get(reason, 0) + there[reason] for reason in Refusal}
        return {reason: count for reason, count in counted.items() if count}

    @property
    def clips(self) -> Mapping[str, int]:
        """Commands that the host cut since this driver was first opened, by reason."""
        return dict(self._since_open(1))

    @property
    def disarmed_because(self) -> str:
        """Why the host closed the gate by itself, empty if it did not."""
        newest = self._newest.value
        return "" if newest is None else newest[1].disarmed_because

    def measure_link(self, count: int = 50) -> LinkQuality:
        """Measure round trips to the host.

        Args:
            count: Number of round trips.

        Raises:
            LinkLost: The host answers none of them.
        """
        with self._connected() as client:
            return measure_link(client, count)

    def clear_fault(self, name: str) -> None:
        """Unlatch a fault on the robot's side, on behalf of an operator. Never arms.

        Args:
            name: Name of the latched fault.

        Raises:
            LifecycleError: If another fault, or none, is latched.
            LinkLost: If the host does not answer.
        """
        with self._connected() as client:
            client.request("clear_fault", ClearFaultRequest(name=name))
        self._confirmed_stop = None
        self._unlatch()

    def confirm_hands_clear(self) -> None:
        """Confirm that no person is in reach; the host knows whether a reset needed a human.

        Raises:
            LifecycleError: If no reset needed a human, of this client or an earlier one.
        """
        with self._hooks:
            known, self._hands_clear = self._hands_clear, False
            try:
                super().confirm_hands_clear()
            except BaseException:
                self._hands_clear = known
                raise

    # Hooks

    def _open(self) -> None:
        self._lost = None
        self._client = client = RobotClient(self.options)
        self._lease.acquire(client, self.options.connect_timeout_s)
        client.announce(self._lease.session)
        self._sent = 0
        client.listen(self._newest.take)
        boot, token = self._lease.boot, self._lease.token
        first = self._wait(
            lambda _, info: (info.boot, info.token) == (boot, token), "the first state"
        )
        if self._counted_before is None:
            self._counted_before = (Counter(first[1].refusals), Counter(first[1].clips))
        fault = self.fault
        if fault is None or first[1].fault is not None:
            return
        if self._confirmed_stop is None:
            self._confirm_stop(client, fault)
        else:  # the host had the fault, and an operator has cleared it since
            self._confirmed_stop = None
            self._unlatch()

    def _close(self) -> None:
        client, self._client = self._client, None
        self._armed_at = None
        if client is not None:
            self._lease.release()
            client.close()

    def _hold(self) -> None:
        self._pending = None
        client = self._client
        if client is None or self._armed_at is None:
            return  # it was not armed since the last confirmation
        self._armed_at = None
        try:
            reply = client.request("disarm", self._leased())
        except LeaseRefused:
            return  # the end of the lease has disarmed the robot
        except DriverError as error:
            log.warning("NOT CONFIRMED that %s is disarmed: %s", self.spec.name, error)
            return
        self._newest.wait(lambda state, _: state.seq > reply.seq, self.options.timeout_s)

    def _interrupt(self) -> None:
        self._newest.wake()
        fault = self.fault
        if fault is None:
            return
        try:
            with self._connected() as client:
                try:
                    self._confirm_stop(client, fault)
                except LinkLost:
                    if self._client is client:
                        raise
                    with RobotClient(self.options) as short:  # this session was closed meanwhile
                        self._confirm_stop(short, fault)
        except DriverError as error:
            log.error("%s", error)

    def _read(self) -> RobotState:
        self._require_link()
        newest = self._newest.value
        assert newest is not None, "opening waits for the first state"
        state = newest[0]
        missing = self.spec.objects.keys() - state.objects.keys()
        if missing:
            raise StaleState(
                f"no pose of {', '.join(sorted(missing))} of {self.spec.name} was received yet; "
                "start its publisher"
            )
        return state

    def _apply(self, command: Command, clipped: tuple[str, ...]) -> None:  # noqa: ARG002
        self._pending = command

    def _advance(self) -> None:
        client = self._require_link()
        command, self._pending = self._pending, None
        before = self._newest.value
        assert before is not None, "opening waits for the first state"
        seq = before[0].seq
        if not self._gate.armed:
            self._wait(lambda state, _: state.seq > seq, "a state")
            return
        self._sent = n = self._sent + 1
        answers = seq if command is None else command.answers
        client.send(self._packed(command, n, answers))
        lost = seq + _LOST_AFTER_TICKS
        self._wait(
            lambda state, info: state.seq > seq and (info.n >= n or state.seq >= lost), "a state"
        )

    def _reset(self, request: ResetRequest) -> ResetResult:
        client = self._require_link()
        message = ResetMessage(
            boot=self._lease.boot,
            token=self._lease.token,
            objects={name: list(map(float, place)) for name, place in request.objects.items()},
            seed=request.seed,
            speed=self._speed_limit,
        )
        reply = client.request("reset", message, self.options.reset_timeout_s)
        self._wait(lambda state, _: state.seq > reply.seq, "a state after the reset")
        return ResetResult(ResetOutcome(reply.result["outcome"]), reply.result["message"])

    def _prepare_to_arm(self) -> None:
        client = self._require_link()
        message = ArmRequest(
            boot=self._lease.boot, token=self._lease.token, speed=self._speed_limit
        )
        reply = client.request("arm", message)
        # A state just received leaves a whole tick for an answer.
        self._wait(lambda state, info: state.seq > reply.seq and info.armed, "an armed state")
        self._armed_at = reply.seq

    def _hands_confirmed(self) -> None:
        self._require_link().request("hands_clear", self._leased())

    # The link

    def _on_arrival(self, state: RobotState, info: HostInfo) -> None:
        """Update the local gate from a state. Called from the receiving thread."""
        if self._client is None:
            return
        if info.boot != self._lease.boot:
            self._lose(LinkLost(f"the host of {self.spec.name} was restarted; open it again"))
        elif info.token != self._lease.token and state.seq > self._lease.seq:
            self._lose(LeaseRefused(f"the lease of {self.spec.name} has ended; open it again"))
        if info.fault is not None:
            self._gate.latch(info.fault.name, info.fault.reason)
            self._confirmed_stop = state.seq
        elif self._confirmed_stop is not None and state.seq > self._confirmed_stop:
            self._confirmed_stop = None
            self._unlatch()  # an operator has cleared it
        if self._armed_at is not None and state.seq > self._armed_at and not info.armed:
            self._gate.disarm()

    def _unlatch(self) -> None:
        fault = self.fault
        if fault is not None:
            with suppress(LifecycleError):  # another thread cleared it first
                self._gate.clear(fault.name)

    def _lose(self, error: DriverError) -> None:
        self._lost = error
        self._gate.disarm()

    def _confirm_stop(self, client: RobotClient, fault: Fault) -> None:
        reply = client.stop(fault.name, fault.reason, self.options.timeout_s)
        self._confirmed_stop = reply.seq

    @contextmanager
    def _connected(self) -> Iterator[RobotClient]:
        """Yield the session of this driver, or a temporary one while it is closed."""
        client = self._client
        if client is not None:
            yield client
            return
        with RobotClient(self.options) as short:
            yield short

    def _wait(self, wanted: Callable[[RobotState, HostInfo], bool], what: str) -> Received:
        """Wait for a state, up to the link's timeout; a stop from another thread ends the wait."""
        limit_s, begun = self.options.timeout_s, time.monotonic()
        self._newest.wait(
            lambda state, info: self._lost is not None or wanted(state, info), limit_s
        )
        if self._lost is not None:
            raise self._lost
        newest = self._newest.value
        if newest is None or time.monotonic() - begun >= limit_s:
            self._gate.disarm()
            raise LinkLost(
                f"{self.spec.name} did not send {what} within {limit_s:g} s, and its host holds "
                "it; check that the host runs, and measure the link with: iher-robot doctor"
            )
        return newest

    def _require_link(self) -> RobotClient:
        if self._lost is not None:
            raise self._lost
        assert self._client is not None, "hooks are called between open and close"
        return self._client

    def _leased(self) -> Leased:
        return Leased(boot=self._lease.boot, token=self._lease.token)

    def _packed(self, command: Command | None, n: int, answers: int) -> bytes:
        content = {"v": VERSION, "boot": self._lease.boot, "token": self._lease.token, "n": n}
        return pack(content | {"answers": answers} | command_fields(command))

    def _since_open(self, which: int) -> Counter[str]:
        newest = self._newest.value
        if newest is None or self._counted_before is None:
            return Counter()
        counted = (Counter(newest[1].refusals), Counter(newest[1].clips))[which]
        return counted - self._counted_before[which]


def _ask_spec(options: LinkOptions, scene: str | None) -> RobotSpec:
    with RobotClient(options) as client:
        reply = client.request("spec", SpecRequest(scene=scene), options.reset_timeout_s)
    return read_spec(reply.result["spec"])


def read_spec(content: Mapping[str, object]) -> RobotSpec:
    """Decode a robot's description from its host.

    Args:
        content: Result of `RobotSpec.to_dict` at the host.

    Raises:
        LinkLost: It is invalid, or its digests differ from those of the host.
    """
    try:
        spec = _SPEC.validate_python(content)
    except ValidationError as error:
        raise LinkLost(
            f"the host sends no description of a robot: {describe_first_problem(error)}"
        ) from error
    for name in ("interface_digest", "body_digest"):
        if getattr(spec, name) != content.get(name):
            raise LinkLost(
                f"{name} of {spec.name} differs from that of its host; use the same version of "
                "iher-robot on both sides"
            )
    return spec
