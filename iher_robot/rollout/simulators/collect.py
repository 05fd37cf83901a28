"""Real episodes of several simulators: charged and stored in the order of their numbers.

The episodes do not depend on how many simulators run them.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass

from drivers.closing import Closing
from iher_robot.errors import UserError
from iher_robot.learning.learner import Learner
from iher_robot.rollout.simulators.episode import Order, SimulatedEpisode
from iher_robot.rollout.simulators.pool import EpisodeFuture, SimulatorPool
from iher_robot.storage.budget import Budget
from iher_robot.storage.episode import StoredEpisode
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.ledger import Entry


@dataclass
class _Running:
    epoch: int
    seed: int
    future: EpisodeFuture
    motion: Entry
    reset: Entry
    place: int | None = None
    """Place in the store, set right before it is stored."""


class SimulatedEpisodes(Closing):
    """Runs the episodes of a run in a pool of simulators.

    The ticks of each are reserved before it begins. An episode that the budget shortens begins only
    when no other is running, whose unused ticks might come back.

    Args:
        pool: The simulators; their ticks are counted as if all were one robot.
        budget: Budget of the run.
        store: Store of the episodes.
        seed_of: Seed of an episode, by its number.
    """

    def __init__(
        self,
        pool: SimulatorPool,
        budget: Budget,
        store: EpisodeStore,
        seed_of: Callable[[int], int],
    ) -> None:
        self._pool = pool
        self._budget = budget
        self._store = store
        self._seed_of = seed_of
        self._running: deque[_Running] = deque()
        self._stack = ExitStack()
        self._seq = 0
        self._in_order = True

    def run(
        self, learner: Learner, *, epoch: int, first: int, count: int
    ) -> Iterator[SimulatedEpisode]:
        """Run the next episodes, as far as the budget goes.

        Args:
            learner: Acts as it is now.
            epoch: Epoch that they belong to.
            first: Number of the first one in the run.
            count: How many, at most. There are fewer where one ended before its first whole tick:
                that one has to run again.

        Yields:
            Each episode when it is stored.

        Raises:
            UserError: An error ended one, or its simulator, or it cannot be written down.
        """
        self._pool.act_as(learner)
        self._pool.expect(count)
        self._in_order = True
        begun = 0
        while True:
            while begun < count and self._in_order and self._pool.free and self._next_ticks:
                self._begin(epoch, self._seed_of(first + begun), self._next_ticks)
                begun += 1
            if self._running and self._running[0].future.done():
                in_order = self._in_order
                episode = self._keep(self._running[0])
                self._running.popleft()  # not before: an interrupt must find it here
                if episode.failure:
                    raise UserError(episode.failure)
                if in_order:
                    yield episode
            elif self._running or (begun < count and self._in_order and self._next_ticks):
                self._pool.wait()
            else:
                return

    def close(self) -> None:
        """Wait for the running episodes and store them; closing twice does nothing."""
        ending = sys.exception()
        try:
            while self._running:
                one = self._running[0]
                try:
                    if not one.future.done():
                        self._pool.wait()
                        continue
                    self._keep(one)
                except UserError:
                    if ending is None:
                        raise
                    if not one.future.done():
                        continue  # the error of another simulator, which could not be started
                    self._in_order = False  # it cannot be kept, and those after it not without it
                self._running.popleft()
        finally:
            self._running.clear()
            self._stack.close()  # reservations that are not settled count in full

    @property
    def _next_ticks(self) -> int:
        """Ticks of the next episode, 0 if it cannot begin now."""
        remaining = self._budget.remaining.ticks
        if remaining < self._pool.episode_ticks and self._running:
            return 0
        return min(self._pool.episode_ticks, remaining)

    def _begin(self, epoch: int, seed: int, ticks: int) -> None:
        motion = self._stack.enter_context(self._budget.reserve(ticks))
        # Far more than a reset takes: no human delay in simulation.
        ahead = self._pool.episode_ticks
        reset = self._stack.enter_context(self._budget.ledger.reserve("reset", ahead))
        try:
            future = self._pool.start(Order(seed, ticks, explores=True))
        except UserError:  # it has not begun
            self._settle(motion, 0)
            self._settle(reset, 0)
            raise
        self._running.append(_Running(epoch, seed, future, motion, reset))

    def _keep(self, one: _Running) -> SimulatedEpisode:
        """Store and settle an episode; it may be called again after an interrupt."""
        episode = one.future.result()
        reset_ticks = episode.reset_ticks
        if not self._seq:  # one robot is opened once, however many simulators there are
            reset_ticks += self._pool.opened_ticks
        begins = self._seq + reset_ticks
        if self._in_order and episode.data is not None:
            one.place = len(self._store) if one.place is None else one.place
            self._store.keep(_stored(one, episode, begins), one.place)
        self._settle(one.reset, reset_ticks)
        self._settle(one.motion, episode.ticks)
        if episode.data is None:
            self._in_order = False  # those after it are not the next ones
        self._seq = begins + int(episode.steps[-1]) if len(episode.steps) else begins
        return episode

    def _settle(self, entry: Entry, ticks: int) -> None:
        if entry.number in self._budget.ledger.open_reservations:
            entry.settle(ticks)


def _stored(one: _Running, episode: SimulatedEpisode, begins: int) -> StoredEpisode:
    assert episode.data is not None
    return StoredEpisode(
        epoch=one.epoch,
        policy_source=episode.policy_source,
        account="motion",
        seed=one.seed,
        entry=one.motion.number,
        index=0,
        ended=episode.ended,
        seqs=begins + episode.steps,
        elapsed=episode.elapsed,
        episode=episode.data,
    )
