"""Store of a deployment: its episodes and its ledger, in the format of a training run."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from drivers.closing import Closing
from iher_robot.deployment.episode import DeploymentRecorder
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.rollout.timing import IdleMeter
from iher_robot.storage.episode import EpisodeHeader
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.interface import keep_interface
from iher_robot.storage.ledger import Ledger


class DeploymentStore(Closing):
    """Episodes and ledger of a deployment.

    Args:
        path: Folder of the deployment.
        env: The robot.

    Attributes:
        idle: Charges the time between episodes.
    """

    def __init__(self, path: Path, env: GoalRobotEnv) -> None:
        directory = path / "episodes"
        keep_interface(directory, env.policy_interface())
        self._env = env
        self._ledger = Ledger(path / "ledger.sqlite")
        self._store = EpisodeStore(directory, durable_ticks=True)
        self.idle = IdleMeter(env.driver, self._ledger)

    def recorder(self, seed: int, ticks: int) -> DeploymentRecorder:
        """Create the recorder of the next episode, which stores and charges its ticks.

        Args:
            seed: Seed of start and goal.
            ticks: Maximal number of ticks.
        """
        self.idle.end()
        return DeploymentRecorder(
            self._env,
            self._store,
            partial(self._ledger.reserve, "deployment", ticks, counted=True),
            self._ledger,
            lambda source, entry: EpisodeHeader(0, source, "deployment", seed, entry),
        )

    def close(self) -> None:
        """Write what is pending; idempotent."""
        self.idle.end()
        self._store.close()
        self._ledger.close()
