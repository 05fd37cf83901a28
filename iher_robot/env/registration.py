"""Registration of the environments with Gymnasium."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

ENV_IDS = {
    "iher_robot/Reach-v0": "reach",
    "iher_robot/Push-v0": "push",
    "iher_robot/PickAndPlace-v0": "pick_and_place",
    "iher_robot/Slide-v0": "slide",
}
"""Task of each id."""

_EPISODE_TICKS = 50
_GYMNASIUM = "gymnasium"


def register_envs() -> None:
    """Register the simulated tasks with Gymnasium; idempotent.

    Drivers and tasks are imported only when an environment is made.
    """
    import gymnasium as gym

    for env_id, task_name in ENV_IDS.items():
        if env_id not in gym.registry:
            gym.register(
                id=env_id,
                entry_point="iher_robot.env:make_env",
                max_episode_steps=_EPISODE_TICKS,
                kwargs={"task_name": task_name},
            )


def register_envs_with_gymnasium() -> None:
    """Register at once if Gymnasium is loaded, otherwise as soon as it has been imported.

    Gymnasium 1.x has no entry points for environments, and importing it here would cost every
    command line, `--version` included, its and numpy's time.
    """
    if _GYMNASIUM in sys.modules:
        register_envs()
    elif not any(isinstance(finder, _GymnasiumFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _GymnasiumFinder())


class _GymnasiumFinder(MetaPathFinder):
    """Finds Gymnasium where the other finders do, and has its loader register the environments."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != _GYMNASIUM:
            return None
        behind = sys.meta_path.index(self) + 1 if self in sys.meta_path else 0
        for finder in sys.meta_path[behind:]:
            spec = finder.find_spec(fullname, path, target)
            if spec is not None and spec.loader is not None:
                spec.loader = _RegisteringLoader(spec.loader, self)
                return spec
        return None


class _RegisteringLoader(Loader):
    """Loads Gymnasium by its own loader, then registers the environments, once."""

    def __init__(self, loader: Loader, finder: _GymnasiumFinder) -> None:
        self._loader = loader
        self._finder = finder

    def __getattr__(self, name: str) -> object:
        # For what looks at the package without importing it, such as `inspect` or `pkgutil`.
        if name == "_loader":  # of a copy that is not yet filled
            raise AttributeError(name)
        return getattr(self._loader, name)

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        # What reads data files of the package asks its own loader for them.
        assert module.__spec__ is not None
        module.__loader__ = module.__spec__.loader = self._loader
        self._loader.exec_module(module)
        if self._finder in sys.meta_path:
            sys.meta_path.remove(self._finder)
        register_envs()
