"""Export to a Minari dataset; `MinariEpisodes` defines its episodes."""

from __future__ import annotations

import copy
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from iher_robot.config.robot import DEFAULT_DRIVER
from iher_robot.datasets.minari_episodes import MinariEpisodes
from iher_robot.datasets.selection import INSTALL_COMMAND, Selection
from iher_robot.datasets.summary import counted
from iher_robot.env.registration import ENV_IDS
from iher_robot.errors import UserError
from iher_robot.storage.files.atomic import write_folder
from iher_robot.version import __version__

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec

ROOT_VARIABLE = "MINARI_DATASETS_PATH"
"""Environment variable for the folder of all Minari datasets."""

_NAME = re.compile(r"(?:[-_\w]+/)*[-_\w]+-v\d+", re.ASCII)


@dataclass(frozen=True)
class MinariResult:
    """Size of a Minari dataset.

    Attributes:
        dataset: Name of the dataset.
        root: Folder of all datasets, None for Minari's own.
        episodes: Episodes in it.
        ticks: Steps in it.
        left_out_ticks: Invalid ticks, which were left out.
    """

    dataset: str
    root: Path | None
    episodes: int
    ticks: int
    left_out_ticks: int

    def summary(self) -> str:
        """The result in two lines."""
        variable = "" if self.root is None else f", with {ROOT_VARIABLE}={self.root.absolute()}"
        return (
            f"{counted(self.episodes, 'episode')}, {counted(self.ticks, 'tick')} (without "
            f"{self.left_out_ticks} that are not valid): {self.dataset}\n"
            f"load    minari.load_dataset({self.dataset!r}){variable}"
        )


def write_minari(
    selection: Selection, *, dataset: str, root: Path | None = None, overwrite: bool = False
) -> MinariResult:
    """Write episodes to a Minari dataset, stored as HDF5.

    Args:
        selection: The episodes.
        dataset: Name of the dataset, such as ``"iher/push-v0"``.
        root: Folder of all datasets; by default Minari's own.
        overwrite: Replace an existing dataset.

    Raises:
        UserError: The name is not allowed, the extra ``data`` is missing, an episode is damaged,
            or the dataset exists or cannot be written. Nothing is written.
    """
    if not _NAME.fullmatch(dataset):
        raise UserError(
            f"--dataset is {dataset!r}, allowed: letters, digits, - and _, with a version at the "
            "end, such as push-v0 or iher/push-v0"
        )
    path = _root(root) / dataset
    _check_target(path, overwrite=overwrite)
    _require_packages()
    from minari.dataset.minari_storage import MinariStorage

    observation_space, action_space = _spaces(selection)
    cut = MinariEpisodes(selection.task.goal_model)
    with write_folder(path) as folder:
        storage = MinariStorage.new(
            folder / "data",
            observation_space=observation_space,
            action_space=action_space,
            env_spec=_env_spec(selection),
            data_format="hdf5",
        )
        storage.update_metadata(_metadata(selection, dataset))
        storage.update_episodes(cut.buffers(selection.episodes()))
        if not cut.metadata:
            raise UserError("no tick of these episodes is valid; there is nothing to export")
        storage.update_episode_metadata(cut.metadata)
        ticks = storage.total_steps
    return MinariResult(dataset, root, len(cut.metadata), ticks, cut.left_out_ticks)


def _check_target(path: Path, *, overwrite: bool) -> None:
    if not path.exists():
        return
    if not (path / "data" / "metadata.json").is_file():
        raise UserError(f"{path} exists and is no dataset of Minari; choose another --dataset")
    if not overwrite:
        raise UserError(f"{path} already exists; choose another --dataset, or use --overwrite")


def _root(root: Path | None) -> Path:
    if root is None:
        named = os.environ.get(ROOT_VARIABLE)
        root = Path(named) if named else Path.home() / ".minari" / "datasets"
    return root.absolute()  # Minari cannot write a dataset to a relative path


def _require_packages() -> None:
    try:
        import h5py  # noqa: F401 (Minari itself imports it too late for a clear error)
        import minari  # noqa: F401
    except ImportError as error:
        raise UserError(
            f"Minari datasets need minari and h5py (the extra 'data'): {INSTALL_COMMAND}"
        ) from error


def _spaces(selection: Selection) -> tuple[spaces.Dict, spaces.Box]:
    """Spaces of `GoalRobotEnv`, which is not made: its robot may be out of reach."""
    _, first = next(selection.episodes())
    goal = spaces.Box(-np.inf, np.inf, (selection.task.goal_dim,), np.float64)
    observation = spaces.Box(-np.inf, np.inf, (selection.task.layout.obs_dim,), np.float64)
    action = spaces.Box(-1.0, 1.0, first.episode.actions.shape[1:], np.float32)
    named: dict[str, spaces.Space[Any]] = {
        "observation": observation,
        "achieved_goal": goal,
        "desired_goal": goal,
    }
    return spaces.Dict(named), action


def _env_spec(selection: Selection) -> EnvSpec | None:
    """The environment of the runs, if all have the same simulated one.

    Recovering the environment of a dataset must never move a real robot.
    """
    first, *others = (run.config.chosen_robot for run in selection.runs.values())
    if first.driver != DEFAULT_DRIVER or any(other != first for other in others):
        return None
    spec = copy.deepcopy(_registered(selection))
    spec.kwargs |= {"driver_name": DEFAULT_DRIVER, **first.options}
    return spec


def _registered(selection: Selection) -> EnvSpec:
    return gym.spec(next(name for name, task in ENV_IDS.items() if task == selection.task.name))


def _metadata(selection: Selection, dataset: str) -> Mapping[str, Any]:
    import minari

    described = selection.describe()
    runs = described["runs"].values()
    commits = sorted({str(run["provenance"].get("commit", "unknown")) for run in runs})
    methods = sorted({f"{run['algo']} (preset {run['preset']})" for run in runs})
    robots = sorted({run.config.chosen_robot.title for run in selection.runs.values()})
    return {
        "dataset_id": dataset,
        "minari_version": minari.__version__,
        "author": {"iher-robot"},
        "algorithm_name": ", ".join(methods),
        "code_permalink": f"iher-robot {__version__}, commit {', '.join(commits)}",
        "description": (
            f"Task {described['task']} on {', '.join(robots)}, as it was learned. Actions are "
            "the applied ones; the requested ones are in infos. Episodes are cut at invalid "
            "ticks."
        ),
        "requirements": ["iher-robot"],
        "eval_env_spec": _registered(selection).to_json(),
        "iher_robot": described,
    }
