"""Episodes on a run's robot: charged, stored, and begun again after a lost connection."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

from drivers import DriverError, FaultLatched, LeaseRefused, LinkLost, StaleState
from drivers.closing import Closing
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.learning.exploration import Explorer
from iher_robot.learning.policy import Policy
from iher_robot.rollout.actor import PolicyActor
from iher_robot.rollout.durable_recorder import DurableRecorder
from iher_robot.rollout.episode import run_episode
from iher_robot.rollout.observer import EpisodeObserver
from iher_robot.rollout.reconnect import ReconnectPolicy
from iher_robot.rollout.recorder import Recorder
from iher_robot.rollout.timing import IdleMeter, TickJitter
from iher_robot.storage.accounts import Account
from iher_robot.storage.episode import EpisodeHeader
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.ledger import Entry, Ledger


class RobotEpisodes(Closing):
    """Runs the episodes of a run on its robot, and reconnects to it where it is lost.

    Args:
        env: The robot.
        store: Keeps the ticks of each episode.
        ledger: Accounts of the run.
        reconnect: Waits between two attempts to reach the robot.
        observers: Follow every episode.

    Attributes:
        jitter: Timing of the ticks of motion.
    """

    def __init__(
        self,
        env: GoalRobotEnv,
        store: EpisodeStore,
        ledger: Ledger,
        reconnect: ReconnectPolicy,
        observers: Sequence[EpisodeObserver] = (),
    ) -> None:
        self._env = env
        self._store = store
        self._ledger = ledger
        self._reconnect = reconnect
        self._observers = observers
        self._idle = IdleMeter(env.driver, ledger)
        self.jitter = TickJitter(env.driver)

    def run(
        self,
        account: Account,
        reserve: Callable[[], AbstractContextManager[Entry]],
        policy: Policy,
        *,
        epoch: int,
        seed: int,
        ticks: int,
        explorer: Explorer | None = None,
    ) -> Recorder:
        """Run an episode; one that did not begin costs nothing, and is begun again.

        Args:
            account: Account that its ticks are charged to.
            reserve: Reserves them, once for each attempt.
            policy: A policy on the CPU.
            epoch: Epoch that it belongs to.
            seed: Decides start, goal and noise.
            ticks: Most ticks to run.
            explorer: Disturbs the actions; None leaves them as they are.

        Returns:
            Its record, with at least one tick.

        Raises:
            UserError: The robot cannot be reset, or did not come back in time, or a record cannot
                be written.
        """
        while True:
            self._idle.end()
            lost = None
            with self._recorder(account, reserve, epoch, seed) as recorder:
                try:
                    run_episode(
                        self._env,
                        PolicyActor(policy, explorer),
                        recorder,
                        seed=seed,
                        ticks=ticks,
                        observers=self._observers,
                    )
                except DriverError as error:
                    if recorder.ticks or not self._may_come_back(error):
                        raise
                    lost = error
            if lost is None:
                self._reconnect.end()
                self._idle.begin()
                return recorder
            self._env.close()  # others may have the robot meanwhile
            self._reconnect.wait(lost)

    def still_idle(self) -> None:
        """Charge the robot's idle time so far; to be called now and then while learning."""
        self._idle.note()

    def close(self) -> None:
        """Settle the idle time; closing twice does nothing."""
        self._idle.end()

    def _recorder(
        self,
        account: Account,
        reserve: Callable[[], AbstractContextManager[Entry]],
        epoch: int,
        seed: int,
    ) -> DurableRecorder:
        return DurableRecorder(
            self._env,
            self._store,
            reserve,
            self._ledger,
            lambda source, entry: EpisodeHeader(epoch, source, account, seed, entry),
            self.jitter if account == "motion" else None,
        )

    def _may_come_back(self, error: DriverError) -> bool:
        if isinstance(error, FaultLatched):  # nothing clears it on a robot of this process alone
            return self._env.driver.exclusive or self._env.robot_spec.physical
        return isinstance(error, LinkLost | LeaseRefused | StaleState)
