"""Optuna study of a search: its storage, its distributions and the check of its origin."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

from iher_robot.config.run import plain_identity
from iher_robot.errors import UserError
from iher_robot.experiments.folder import ExperimentFolder
from iher_robot.experiments.grid import Cell
from iher_robot.experiments.search_space import Parameter, Search

NEEDED = "pip install 'iher-robot[sweep]'"
_STUDY = "search"


def open_study(folder: ExperimentFolder, search: Search, cells: Iterable[Cell]) -> Any:
    """Open the study in an experiment's folder, or create it.

    Args:
        folder: Folder of the experiment.
        search: The search.
        cells: Cells of each trial, without the settings that the search draws.

    Returns:
        An Optuna study, in a SQLite file.

    Raises:
        UserError: Optuna is missing, or the study in the folder belongs to another search.
    """
    try:
        import optuna
    except ImportError as error:
        raise UserError(f"a search needs Optuna (the extra 'sweep'): {NEEDED}") from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    minimise = search.objective == "minutes-to-success"
    study = optuna.create_study(
        storage=f"sqlite:///{folder.study_path.absolute()}",
        study_name=_STUDY,
        direction="minimize" if minimise else "maximize",
        load_if_exists=True,
    )
    expected = {"objective": search.objective, "success": search.success, "grid": _digest(cells)}
    stored = study.user_attrs
    for name, value in expected.items():
        if name in stored and stored[name] != value:
            if name == "grid":
                raise _other(folder, "its grid is not that of the manifest")
            raise _other(folder, f"its {name} is {stored[name]!r}, and {value!r} in the manifest")
        study.set_user_attr(name, value)
    _require_same_parameters(study, folder, distributions_of(search))
    return study


def distributions_of(search: Search) -> dict[str, Any]:
    """Optuna's distribution of each parameter."""
    return {key: _distribution(parameter) for key, parameter in search.parameters.items()}


def is_whole(trial: Any, distributions: Mapping[str, Any]) -> bool:
    """Whether all parameters of a trial have been drawn."""
    return bool(trial.params.keys() == distributions.keys())


def _digest(cells: Iterable[Cell]) -> str:
    """Digest of everything that a trial's value depends on, except what the search draws."""
    content = [[cell.identity.as_row(), plain_identity(cell.config)] for cell in cells]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _require_same_parameters(
    study: Any, folder: ExperimentFolder, distributions: Mapping[str, Any]
) -> None:
    for trial in study.get_trials(deepcopy=False):
        drawn = trial.distributions
        if any(drawn[key] != distributions.get(key) for key in drawn) or (
            trial.state.is_finished() and drawn and not is_whole(trial, distributions)
        ):
            raise _other(folder, "its ranges or choices are not those of the manifest")


def _other(folder: ExperimentFolder, what: str) -> UserError:
    return UserError(
        f"the search in {folder.path} is a different one: {what}; choose another --out"
    )


def _distribution(parameter: Parameter) -> Any:
    from optuna import distributions

    if parameter.choices:
        return distributions.CategoricalDistribution(parameter.choices)
    low, high = parameter.ends
    if parameter.integer:
        return distributions.IntDistribution(low, high, log=parameter.log)
    return distributions.FloatDistribution(low, high, log=parameter.log)
