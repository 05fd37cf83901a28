"""Real episodes in several simulators at once: each charged and kept, in the order of their number.

Which episodes there are, and what is in them, does not depend on how many run at once.
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
from iher_robot.rollout.simulators.pool import SimulatorPool, Ticket
from iher_robot.storage.budget import Budget
from iher_robot.storage.episode import StoredEpisode
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.ledger import Entry


@dataclass
class _UnderWay:
    epoch: int
    seed: int
    ticket: Ticket
    motion: Entry
    reset: Entry
    place: int | None = None
    """In the store, once it is about to be there."""


class SimulatedEpisodes(Closing):
    """Runs the episodes of a run in a pool of simulators.

    The ticks of each are reserved before it begins. One that the budget shortens begins only when
    no other is under way, whose ticks might come back.

    Args:
        pool: The simulators, whose ticks are counted as if all were one robot.
        budget: What may be spent.
        store: Keeps the episodes.
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
        self._under_way: deque[_UnderWay] = deque()
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
                that one is to be begun again.

        Yields:
            Each episode when it is kept.

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
            if self._under_way and self._under_way[0].ticket.arrived:
                in_order = self._in_order
                episode = self._keep(self._under_way[0])
                self._under_way.popleft()  # not before: an interrupt must find it here
                if episode.failure:
                    raise UserError(episode.failure)
                if in_order:
                    yield episode
            elif self._under_way or (begun < count and self._in_order and self._next_ticks):
                self._pool.wait()
            else:
                return

    def close(self) -> None:
        """Keep what is under way when it is over; closing twice does nothing."""
        ending = sys.exception()
        try:
            while self._under_way:
                one = self._under_way[0]
                try:
                    if not one.ticket.arrived:
                        self._pool.wait()
                        continue
                    self._keep(one)
                except UserError:
                    if ending is None:
                        raise
                    if not one.ticket.arrived:
                        continue  # another simulator, which could not be started
                    self._in_order = False  # it cannot be kept, and those after it not without it
                self._under_way.popleft()
        finally:
            self._under_way.clear()
            self._stack.close()  # what is not settled counts in full

    @property
    def _next_ticks(self) -> int:
        """Ticks of the next episode, 0 if it cannot begin now."""
        remaining = self._budget.remaining_ticks
        if remaining < self._pool.episode_ticks and self._under_way:
            return 0
        return min(self._pool.episode_ticks, remaining)

    def _begin(self, epoch: int, seed: int, ticks: int) -> None:
        motion = self._stack.enter_context(self._budget.reserve(ticks))
        # Of a simulated robot, for which nobody walks to a table, far more than a reset takes.
        ahead = self._pool.episode_ticks
        reset = self._stack.enter_context(self._budget.ledger.reserve("reset", ahead))
        try:
            ticket = self._pool.start(Order(seed, ticks, explores=True))
        except UserError:  # it has not begun
            self._settle(motion, 0)
            self._settle(reset, 0)
            raise
        self._under_way.append(_UnderWay(epoch, seed, ticket, motion, reset))

    def _keep(self, one: _UnderWay) -> SimulatedEpisode:
        """Store and settle an episode; after an interrupt the same may be asked again."""
        episode = one.ticket.take()
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


def _stored(one: _UnderWay, episode: SimulatedEpisode, begins: int) -> StoredEpisode:
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
