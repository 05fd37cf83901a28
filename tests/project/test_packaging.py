"""What an installed copy contains, and what it does beside folders of the same names."""

from __future__ import annotations

import configparser
import importlib
import importlib.resources
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import iher_robot
from tests.repository import ROOT

PACKAGES = ("iher_robot", "drivers", "tasks")


def run_python(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder, with this checkout on the path after it."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("name", ["drivers", "tasks"])
@pytest.mark.parametrize("form", ["{}/__init__.py", "{}.py"])
def test_a_foreign_package_is_named_in_the_error(tmp_path: Path, name: str, form: str) -> None:
    foreign = tmp_path / form.format(name)
    foreign.parent.mkdir(exist_ok=True)
    foreign.touch()

    result = run_python("-c", "import iher_robot", folder=tmp_path)

    last_line = result.stderr.strip().splitlines()[-1]
    shadow = foreign.parent if foreign.name == "__init__.py" else foreign
    assert result.returncode == 1
    assert last_line.startswith("ImportError")
    assert f"{shadow} comes first on the import path and shadows it" in last_line
    assert str(ROOT / name) in last_line


def test_the_advice_of_the_shadow_error_works(tmp_path: Path) -> None:
    (tmp_path / "drivers").mkdir()
    (tmp_path / "drivers" / "__init__.py").touch()

    assert run_python("-P", "-c", "import iher_robot", folder=tmp_path).returncode == 0


def test_a_foreign_folder_that_is_no_package_does_no_harm(tmp_path: Path) -> None:
    (tmp_path / "tasks").mkdir()
    (tmp_path / "tasks" / "todo.md").touch()

    result = run_python("-c", "import iher_robot, tasks; print(tasks.__file__)", folder=tmp_path)

    assert Path(result.stdout.strip()) == ROOT / "tasks" / "__init__.py"


def test_a_missing_package_is_named_in_the_error(tmp_path: Path) -> None:
    (tmp_path / "iher_robot").mkdir()
    for name in ("__init__.py", "_shadowing.py", "version.py"):
        shutil.copy(ROOT / "iher_robot" / name, tmp_path / "iher_robot")

    # -S leaves site-packages out, where another copy of the packages may be installed.
    command = [sys.executable, "-S", "-c", "import iher_robot"]
    result = subprocess.run(
        command, cwd=tmp_path, env={}, capture_output=True, text=True, check=False
    )

    assert f"'drivers' at {tmp_path / 'drivers'}, which is missing" in result.stderr


# What is heavy, and must not be loaded by what is used often or in many processes.
HEAVY = {
    "iher_robot": {"gymnasium", "mujoco", "numpy", "torch"},
    "iher_robot.cli.app": {"gymnasium", "mujoco", "numpy", "torch"},
    "iher_robot.host.serve": {"matplotlib", "mujoco", "scipy", "torch"},
    "iher_robot.datasets.api": {"matplotlib", "mujoco", "scipy", "torch"},
    "iher_robot.datasets.spending": {"matplotlib", "mujoco", "scipy", "torch"},
    "iher_robot.experiments.experiment": {"matplotlib", "mujoco", "scipy", "torch"},
    "iher_robot.training.train": {"matplotlib", "mujoco", "scipy", "tensorboard"},
}


@pytest.mark.parametrize("module", HEAVY)
def test_what_takes_long_to_load_is_loaded_when_it_is_used(module: str) -> None:
    code = f"import sys, {module}; print({HEAVY[module]} & set(sys.modules))"

    assert run_python("-c", code, folder=ROOT).stdout.strip() == "set()"


@pytest.mark.parametrize("name", ["train", "evaluate", "experiment", "report"])
@pytest.mark.parametrize("first", ["pass", "import {home}", "iher_robot.{name}"])
def test_an_application_is_callable_in_every_order_of_imports(name: str, first: str) -> None:
    home = iher_robot._LAZY[name]
    code = (
        f"import iher_robot; {first.format(name=name, home=home)}\n"
        f"from {home} import {name} as function\n"
        f"assert iher_robot.{name} is function\n"
        f"try: iher_robot.{name}(no_such_argument=1)\n"
        f"except TypeError as error: print(error)\n"
    )

    result = run_python("-c", code, folder=ROOT)

    assert result.stdout.startswith(f"{name}() got an unexpected keyword"), result.stderr


def test_every_public_name_resolves_to_what_bears_it() -> None:
    assert set(iher_robot._LAZY) < set(iher_robot.__all__)
    for name in iher_robot.__all__:
        assert hasattr(iher_robot, name)
        assert name in dir(iher_robot)
    for name, home in iher_robot._LAZY.items():
        module = importlib.import_module(home)
        assert getattr(iher_robot, name) is getattr(module, name)
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = iher_robot.no_such_name


@pytest.mark.parametrize(
    "imports",
    [
        "import gymnasium, iher_robot",
        "import iher_robot, gymnasium",
        "import iher_robot, gymnasium.spaces",
        "import gymnasium.envs.registration, iher_robot.cli.app",
        "import importlib as i, iher_robot as r; i.reload(r.env.registration); i.reload(r)",
    ],
)
def test_the_environments_are_registered_in_every_order_of_imports(imports: str) -> None:
    code = (
        f"{imports}\nimport importlib.resources, sys, gymnasium\n"
        "print(gymnasium.spec('iher_robot/Push-v0').entry_point)\n"
        "print(type(gymnasium.__spec__.loader).__name__, type(gymnasium.__loader__).__name__)\n"
        "print((importlib.resources.files('gymnasium') / 'envs').is_dir())\n"
        "print([one for one in sys.meta_path if type(one).__module__.startswith('iher_robot')])"
    )

    lines = run_python("-c", code, folder=ROOT).stdout.splitlines()

    loader = "SourceFileLoader"
    assert lines == ["iher_robot.env:make_env", f"{loader} {loader}", "True", "[]"]


def test_gymnasium_can_be_looked_at_without_being_imported() -> None:
    code = (
        "import importlib.util, iher_robot, sys\n"
        "spec = importlib.util.find_spec('gymnasium')\n"
        "print(spec.loader.get_filename('gymnasium') == spec.origin, 'gymnasium' in sys.modules)\n"
        "import gymnasium\n"
        "print('iher_robot/Push-v0' in gymnasium.registry)"
    )

    assert run_python("-c", code, folder=ROOT).stdout.split() == ["True", "False", "True"]


def test_an_environment_is_made_in_a_program_that_names_no_room() -> None:
    code = (
        "import iher_robot, gymnasium\n"
        "env = gymnasium.make('iher_robot/Reach-v0')\n"
        "print(type(env.unwrapped).__name__, env.spec.max_episode_steps)\n"
    )

    result = run_python("-c", code, folder=ROOT)

    assert result.stdout.split() == ["GoalRobotEnv", "50"], result.stderr


def test_the_presets_are_package_data() -> None:
    resources = importlib.resources.files("iher_robot.config") / "configs" / "presets"
    shipped = {entry.name for entry in resources.iterdir() if entry.is_dir()}

    assert {"default", "paper"} <= shipped
    assert (resources / "paper" / "push.yaml").read_text()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """The wheel that a build from the source distribution makes, in a copy of the checkout."""
    copy = tmp_path_factory.mktemp("checkout")
    ignored = shutil.ignore_patterns("__pycache__")
    for name in (*PACKAGES, "configs"):
        shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", "dist"]
    subprocess.run(command, cwd=copy, check=True, capture_output=True)
    (built,) = (copy / "dist").glob("*.whl")
    return zipfile.ZipFile(built)


def test_the_wheel_contains_every_module_and_preset_and_nothing_else(
    wheel: zipfile.ZipFile,
) -> None:
    modules = {
        str(file.relative_to(ROOT)) for name in PACKAGES for file in (ROOT / name).rglob("*.py")
    }
    presets = {
        f"iher_robot/config/{file.relative_to(ROOT)}" for file in ROOT.glob("configs/**/*.yaml")
    }
    templates = {str(file.relative_to(ROOT)) for file in ROOT.glob("iher_robot/**/*.j2")}
    typed = {f"{name}/py.typed" for name in PACKAGES}

    contents = {name for name in wheel.namelist() if ".dist-info/" not in name}

    assert presets
    assert templates
    assert contents == modules | presets | templates | typed


def test_the_entry_points_of_the_wheel_resolve(wheel: zipfile.ZipFile) -> None:
    (name,) = (name for name in wheel.namelist() if name.endswith("entry_points.txt"))
    points = configparser.ConfigParser()
    points.read_string(wheel.read(name).decode())

    assert points["console_scripts"]["iher-robot"] == "iher_robot.cli:main"
    assert "mujoco" in points["iher_robot.drivers"]
    for section in points.sections():
        for target in points[section].values():
            module, _, attribute = target.partition(":")
            assert callable(getattr(importlib.import_module(module), attribute)), target
