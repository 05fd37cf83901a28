"""Simulators in processes of their own, which run whole episodes side by side."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from multiprocessing.connection import wait

from drivers.closing import Closing
from iher_robot.config.run import RunConfig
from iher_robot.errors import UserError
from iher_robot.learning.learner import Learner
from iher_robot.rollout.simulators.actor import take_snapshot
from iher_robot.rollout.simulators.child_process import ChildProcess
from iher_robot.rollout.simulators.episode import Order, SimulatedEpisode
from iher_robot.rollout.simulators.messages import Message

PROGRAM = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])
from iher_robot.rollout.simulators.worker import main
main(int(sys.argv[2]))
"""
"""What each process runs."""
_AHEAD = 2
"""Episodes for each simulator that may begin before the oldest of them is over."""


class Ticket:
    """An episode that was begun.

    Attributes:
        arrived: Whether ``take`` need not wait.
    """

    def __init__(self) -> None:
        self._outcome: SimulatedEpisode | UserError | None = None

    @property
    def arrived(self) -> bool:
        """Whether it is known what became of it."""
        return self._outcome is not None

    def take(self) -> SimulatedEpisode:
        """What became of it.

        Raises:
            UserError: Nobody knows: its simulator is gone.
        """
        assert self._outcome is not None, "wait comes first"
        if isinstance(self._outcome, UserError):
            raise self._outcome
        return self._outcome

    def settle(self, outcome: SimulatedEpisode | UserError) -> None:
        """Say what became of it, for the pool."""
        self._outcome = outcome


class _Simulator(ChildProcess):
    def __init__(self) -> None:
        super().__init__(
            PROGRAM, "a simulator's process", "continue the run with: iher-robot train --resume"
        )
        self.ready = False
        self.ticket: Ticket | None = None
        """Of the episode that it was told last."""
        self.actor = 0

    @property
    def busy(self) -> bool:
        """Whether it has something to tell yet."""
        return not self.ready or not (self.ticket is None or self.ticket.arrived)


class SimulatorPool(Closing):
    """Runs episodes of one task in several simulators; each is the same wherever it runs.

    Processes, since the policy and inverse kinematics hold Python's lock for half of a tick or
    more. They are started when there is work for them, and kept.

    Args:
        config: Settings of the run: its robot, its task and how many simulators there are.
        episode_ticks: Of a whole episode.

    Attributes:
        episode_ticks: Of a whole episode.
        opened_ticks: Control ticks that it takes to open one of the simulators.
    """

    def __init__(self, config: RunConfig, episode_ticks: int) -> None:
        self._config = config
        self._simulators: list[_Simulator] = []
        self._actor: Message = {}
        self._actors = 0
        self._tickets: deque[Ticket] = deque()
        self._broken = False
        self.episode_ticks = episode_ticks
        self.opened_ticks = 0

    def act_as(self, learner: Learner) -> None:
        """Take over what acts from now on, as it is now; episodes under way keep what they have."""
        self._actor = {"kind": "actor", "snapshot": take_snapshot(learner)}
        self._actors += 1

    def expect(self, episodes: int) -> None:
        """Start processes for so many episodes to come, as far as there are to be any.

        Args:
            episodes: How many.
        """
        while len(self._simulators) < min(episodes, self._config.simulators):
            simulator = _Simulator()
            self._simulators.append(simulator)
            simulator.start()
            simulator.send({"kind": "begin", "config": self._config.model_dump_json()})

    @property
    def free(self) -> bool:
        """Whether an episode can begin at once."""
        while self._tickets and self._tickets[0].arrived:
            self._tickets.popleft()
        room = len(self._tickets) < _AHEAD * len(self._simulators)
        return room and not self._broken and self._idle() is not None

    def start(self, order: Order) -> Ticket:
        """Begin an episode.

        Args:
            order: What to run.

        Raises:
            UserError: The simulator is gone; it has not begun.
        """
        simulator = self._idle()
        assert simulator is not None, "ask first whether one is free"
        if simulator.actor != self._actors:
            simulator.send(self._actor)
            simulator.actor = self._actors
        ticket = Ticket()
        simulator.ticket = ticket  # first: after an interrupt it takes no other one
        self._tickets.append(ticket)
        simulator.send({"kind": "episode"} | vars(order))
        return ticket

    def wait(self) -> None:
        """Wait until some simulator has something to tell.

        Raises:
            UserError: One could not be started.
        """
        busy = {s.connection: s for s in self._simulators if s.busy and s.is_open}
        assert busy, "nothing is under way"
        for connection in wait(list(busy)):
            self._hear(busy[connection])  # type: ignore[index]

    def run(self, learner: Learner, seeds: Sequence[int]) -> Iterator[SimulatedEpisode]:
        """Run episodes without noise that cost nothing and are not kept.

        Args:
            learner: Acts as it is now.
            seeds: Decide starts and goals.

        Yields:
            Each episode, in the order of the seeds.

        Raises:
            UserError: An error ended one, or its simulator.
        """
        self.act_as(learner)
        self.expect(len(seeds))
        left, tickets = deque(seeds), deque[Ticket]()
        while left or tickets:
            while left and self.free:
                tickets.append(self.start(Order(left.popleft(), self.episode_ticks, False)))
            if not (tickets and tickets[0].arrived):
                self.wait()
                continue
            episode = tickets.popleft().take()
            if episode.failure:
                raise UserError(episode.failure)
            yield episode

    def close(self) -> None:
        """End every simulator; closing twice does nothing."""
        simulators, self._simulators = self._simulators, []
        for simulator in simulators:
            simulator.close()

    def _idle(self) -> _Simulator | None:
        return next((s for s in self._simulators if not s.busy), None)

    def _hear(self, simulator: _Simulator) -> None:
        try:
            message = simulator.receive(0.0)
            if message is not None:
                self._take(simulator, message)
        except UserError as error:
            if not self._lose(simulator, error):
                raise
        except BaseException:  # an interrupt: what it said is gone, and nobody may wait for it
            self._lose(simulator, simulator.unheard())
            raise

    def _take(self, simulator: _Simulator, message: Message) -> None:
        if message["kind"] == "ready":
            simulator.ready, self.opened_ticks = True, message["opened_ticks"]
            return
        assert simulator.ticket is not None, "a simulator tells of what it was told to run"
        simulator.ticket.settle(SimulatedEpisode.from_message(message))

    def _lose(self, simulator: _Simulator, error: UserError) -> bool:
        """Do without a simulator; returns whether it had an episode, whose ticket has the error."""
        self._broken = True
        ticket = simulator.ticket
        ran = ticket is not None and not ticket.arrived
        if ticket is not None and ran:
            ticket.settle(error)  # first: somebody may wait for it
        simulator.close()
        self._simulators.remove(simulator)
        return ran
