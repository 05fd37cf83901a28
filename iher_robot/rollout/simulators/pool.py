"""Pool of simulator processes, which run whole episodes in parallel."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
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


EpisodeFuture = Future[SimulatedEpisode]
"""An ordered episode; its exception is a `UserError` where the simulator is gone."""


class _Simulator(ChildProcess):
    def __init__(self) -> None:
        super().__init__(
            PROGRAM, "a simulator's process", "continue the run with: iher-robot train --resume"
        )
        self.ready = False
        self.episode: EpisodeFuture | None = None
        """The episode that it was ordered last."""
        self.actor = 0

    @property
    def busy(self) -> bool:
        """Whether a message of it is due."""
        return not self.ready or not (self.episode is None or self.episode.done())


class SimulatorPool(Closing):
    """Runs episodes of one task in several simulator processes; none depends on where it runs.

    Processes, not threads: the policy and inverse kinematics hold Python's lock for half of a tick
    or more. They are started when there is work for them, and kept.

    Args:
        config: Settings of the run: its robot, its task and how many simulators there are.
        episode_ticks: Control ticks of a whole episode.

    Attributes:
        episode_ticks: Control ticks of a whole episode.
        opened_ticks: Control ticks that it takes to open one of the simulators.
    """

    def __init__(self, config: RunConfig, episode_ticks: int) -> None:
        self._config = config
        self._simulators: list[_Simulator] = []
        self._actor: Message = {}
        self._actors = 0
        self._ordered: deque[EpisodeFuture] = deque()
        self._broken = False
        self.episode_ticks = episode_ticks
        self.opened_ticks = 0

    def act_as(self, learner: Learner) -> None:
        """Set the policy of the episodes that start from now on; running ones keep theirs."""
        self._actor = {"kind": "actor", "snapshot": take_snapshot(learner)}
        self._actors += 1

    def expect(self, episodes: int) -> None:
        """Start the processes that a number of episodes can use.

        Args:
            episodes: Episodes to come.
        """
        while len(self._simulators) < min(episodes, self._config.simulators):
            simulator = _Simulator()
            self._simulators.append(simulator)
            simulator.start()
            simulator.send({"kind": "begin", "config": self._config.model_dump_json()})

    @property
    def free(self) -> bool:
        """Whether an episode can begin at once."""
        while self._ordered and self._ordered[0].done():
            self._ordered.popleft()
        room = len(self._ordered) < _AHEAD * len(self._simulators)
        return room and not self._broken and self._idle() is not None

    def start(self, order: Order) -> EpisodeFuture:
        """Start an episode.

        Args:
            order: The episode.

        Returns:
            The episode, done after a `wait`.

        Raises:
            UserError: The simulator is gone; the episode has not begun.
        """
        simulator = self._idle()
        assert simulator is not None, "ask first whether one is free"
        if simulator.actor != self._actors:
            simulator.send(self._actor)
            simulator.actor = self._actors
        episode = EpisodeFuture()
        simulator.episode = episode  # first: after an interrupt it takes no other one
        self._ordered.append(episode)
        simulator.send({"kind": "episode"} | vars(order))
        return episode

    def wait(self) -> None:
        """Wait for the next message of any simulator, and take it in.

        Raises:
            UserError: One could not be started.
        """
        busy = {s.connection: s for s in self._simulators if s.busy and s.is_open}
        assert busy, "no episode is running"
        for connection in wait(list(busy)):
            self._receive(busy[connection])  # type: ignore[index]

    def run(self, learner: Learner, seeds: Sequence[int]) -> Iterator[SimulatedEpisode]:
        """Run episodes without noise, which are neither charged nor stored.

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
        left, ordered = deque(seeds), deque[EpisodeFuture]()
        while left or ordered:
            while left and self.free:
                ordered.append(self.start(Order(left.popleft(), self.episode_ticks, False)))
            if not (ordered and ordered[0].done()):
                self.wait()
                continue
            episode = ordered.popleft().result()
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

    def _receive(self, simulator: _Simulator) -> None:
        try:
            message = simulator.receive(0.0)
            if message is not None:
                self._take(simulator, message)
        except UserError as error:
            if not self._lose(simulator, error):
                raise
        except BaseException:  # an interrupt: the message is lost, and must not be waited for
            self._lose(simulator, simulator.lost_message())
            raise

    def _take(self, simulator: _Simulator, message: Message) -> None:
        if message["kind"] == "ready":
            simulator.ready, self.opened_ticks = True, message["opened_ticks"]
            return
        assert simulator.episode is not None, "a simulator sends what it was ordered"
        simulator.episode.set_result(SimulatedEpisode.from_message(message))

    def _lose(self, simulator: _Simulator, error: UserError) -> bool:
        """Drop a simulator; return whether an episode was running, which then has the error."""
        self._broken = True
        episode = simulator.episode
        ran = episode is not None and not episode.done()
        if episode is not None and ran:
            episode.set_exception(error)  # first: a caller may wait for it
        simulator.close()
        self._simulators.remove(simulator)
        return ran
