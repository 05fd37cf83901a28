"""Episodes on a robot: each charged and kept, whatever ends it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager

from drivers import DriverError, FaultLatched, LeaseRefused, LinkLost, StaleState
from iher_robot.collect import Recorder, run_episode
from iher_robot.env import GoalRobotEnv
from iher_robot.episode_store import EpisodeStore
from iher_robot.learning.explorer import Explorer
from iher_robot.learning.policy import Policy
from iher_robot.ledger import Account, Entry
from iher_robot.patience import Patience


class RobotEpisodes:
    """Runs the episodes of a run on its robot, and waits for it where it is lost.

    Args:
        env: The robot.
        store: Keeps the ticks of each episode.
        patience: How long to wait.
    """

    def __init__(self, env: GoalRobotEnv, store: EpisodeStore, patience: Patience) -> None:
        self._env = env
        self._store = store
        self._patience = patience

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
            account: What its ticks are charged to.
            reserve: Reserves them, once for each attempt.
            policy: A policy on the CPU.
            epoch: Epoch that it belongs to.
            seed: Decides start, goal and noise.
            ticks: Most ticks to run.
            explorer: Disturbs the actions; None leaves them as they are.

        Returns:
            What was recorded, at least one tick.

        Raises:
            UserError: The robot cannot be reset, or did not come back in time.
        """
        while True:
            recorder, lost = Recorder(), None
            try:
                with reserve() as entry:
                    try:
                        run_episode(
                            self._env, policy, recorder, seed=seed, ticks=ticks, explorer=explorer
                        )
                    finally:
                        self._keep(recorder, account, epoch)
                        entry.settle(recorder.ticks)  # last: a failure before it charges all
            except DriverError as error:
                if recorder.ticks or not self._may_come_back(error):
                    raise
                lost = error
            if lost is None:
                self._patience.end()
                return recorder
            self._env.close()  # others may have the robot meanwhile
            self._patience.wait(lost)

    def _keep(self, recorder: Recorder, account: Account, epoch: int) -> None:
        episode = recorder.episode()
        if episode is not None:
            told = recorder.told_source
            self._store.append(episode, epoch=epoch, told_source=told, account=account)

    def _may_come_back(self, error: DriverError) -> bool:
        if isinstance(error, FaultLatched):  # of a robot of this process alone, nobody clears it
            return self._env.driver.exclusive or self._env.robot_spec.physical
        return isinstance(error, LinkLost | LeaseRefused | StaleState)
