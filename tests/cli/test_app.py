"""The command line: options passed on, and one sentence with exit code 2 for bad input."""

from __future__ import annotations

import importlib
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import torch

import iher_robot
from iher_robot.cli.app import main
from iher_robot.evaluation.policy_file import PolicyFile, save_policy
from iher_robot.evaluation.video import film
from iher_robot.learning.config import LearnerConfig
from iher_robot.learning.goal_model import Shapes
from iher_robot.learning.policy import Policy
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.ledger import Ledger
from tests.forked import run_forked
from tests.repository import ROOT
from tests.small_runs import TINY

Run = Callable[..., "Outcome"]

# Bad input is refused before anything moves; otherwise the test still ends soon.
ONE_EPISODE = ("--budget-minutes", "0.04")


@dataclass(frozen=True)
class Outcome:
    """Result of one invocation of the command line."""

    code: object
    out: str
    err: str


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    """Run the command line in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def invoke(*words: str) -> Outcome:
        with pytest.raises(SystemExit) as stopped:
            main(words)
        printed = capsys.readouterr()
        return Outcome(stopped.value.code, printed.out, printed.err)

    return invoke


@dataclass
class Recorder:
    """Replaces an application: records its arguments and has a result to print."""

    error: BaseException | None = None
    args: tuple[object, ...] = ()
    complete: bool = True
    kwargs: dict[str, object] = field(default_factory=dict)

    def __call__(self, *args: object, **kwargs: object) -> Recorder:
        self.args, self.kwargs = args, kwargs
        if self.error is not None:
            raise self.error
        return self

    def summary(self) -> str:
        return "what the application says"


def replace(monkeypatch: pytest.MonkeyPatch, application: str, function: str) -> Recorder:
    recorder = Recorder()
    module = importlib.import_module(f"iher_robot.{application}")
    monkeypatch.setattr(module, function, recorder)
    return recorder


def assert_one_sentence(outcome: Outcome, *parts: str) -> None:
    assert outcome.code == 2, outcome
    assert outcome.err.startswith("iher-robot: ")
    assert outcome.err.count("\n") == 1, outcome.err
    assert outcome.out == ""
    for part in parts:
        assert part in outcome.err


def test_train_passes_every_option_on(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    train = replace(monkeypatch, "training.train", "train")

    outcome = run(
        *"train --task push --driver mujoco --preset paper --algo her --budget-minutes 1.5".split(),
        *"--set learner.ddpg.gamma=0.9 --set seed=3 --seed 7 --out there".split(),
        *"--until-success 0.9 --device cpu --async --quiet --robot worn --video".split(),
        *"--simulators 2".split(),
        *"--connect tcp/10.0.0.7:7447 --connect tls/arm:7447 --from-data a --from-data b".split(),
    )

    assert outcome == Outcome(0, "what the application says\n", "")
    assert train.kwargs == {
        "task": "push",
        "driver": "mujoco",
        "robot": "worn",
        "connect": ["tcp/10.0.0.7:7447", "tls/arm:7447"],
        "preset": "paper",
        "algo": "her",
        "budget_minutes": 1.5,
        "overrides": ["learner.ddpg.gamma=0.9", "seed=3"],
        "seed": 7,
        "out": Path("there"),
        "until_success": 0.9,
        "device": "cpu",
        "asynchronous": True,
        "simulators": 2,
        "display": False,
        "video": True,
        "from_data": ["a", "b"],
    }


def test_train_passes_defaults_for_missing_options(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    train = replace(monkeypatch, "training.train", "train")

    run("train", "--task", "reach", "--until-success", "OFF")

    assert train.kwargs["budget_minutes"] is None
    assert train.kwargs["out"] is None
    assert train.kwargs["until_success"] is None
    assert train.kwargs["robot"] is None
    assert train.kwargs["driver"] is None
    assert not train.kwargs["connect"]
    assert train.kwargs["video"] is False
    assert train.kwargs["display"] is True
    assert not train.kwargs["overrides"]


def test_resume_continues_a_folder(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    resume = replace(monkeypatch, "training.train", "resume")

    assert run("train", "--resume", "there", "--no-display").code == 0
    assert resume.args == (Path("there"),)
    assert resume.kwargs == {"simulators": None, "display": False, "video": False}
    assert run("train", "--resume", "there", "--video", "--simulators", "3").code == 0
    assert resume.kwargs == {"simulators": 3, "display": True, "video": True}


def test_experiment_passes_every_option_on(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = replace(monkeypatch, "experiments.experiment", "experiment")

    outcome = run(
        *"experiment push --out there --workers 3 --executor ray --address auto --ship".split(),
        *"--only push-* --only reach-* --quiet".split(),
    )

    assert outcome == Outcome(0, "what the application says\n", "")
    assert experiment.args == ("push",)
    assert experiment.kwargs == {
        "out": Path("there"),
        "executor": "ray",
        "workers": 3,
        "address": "auto",
        "ship": True,
        "only": ["push-*", "reach-*"],
        "display": False,
    }
    experiment.complete = False
    assert run("experiment", "push").code == 1
    assert experiment.kwargs["out"] is None
    assert experiment.kwargs["display"] is True


def test_report_passes_every_option_on(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    report = replace(monkeypatch, "experiments.report.report", "report")

    assert run("report", "there", "--out", "elsewhere").code == 0
    assert (report.args, report.kwargs) == ((Path("there"),), {"out": Path("elsewhere")})


def test_bad_manifests_are_one_sentence(run: Run) -> None:
    Path("m.yaml").write_text("title: t\ngrids: [{tasks: [reach], seed: 1}]\n")

    assert_one_sentence(run("experiment", "m.yaml"), "m.yaml: unknown key 'seed'")
    assert_one_sentence(run("experiment", "smok"), "did you mean 'smoke'")
    assert_one_sentence(run("report", "nowhere"), "there is no experiment in nowhere")


def test_evaluate_passes_every_option_on(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    evaluate = replace(monkeypatch, "evaluation.evaluate", "evaluate")

    outcome = run(
        *"evaluate p.pt --episodes 3 --official --video v.mp4 --seed 5 --task push".split(),
        *"--robot mine.yaml --accept-interface --connect tcp/10.0.0.7:7447".split(),
    )

    assert outcome == Outcome(0, "what the application says\n", "")
    assert evaluate.args == (Path("p.pt"),)
    assert evaluate.kwargs == {
        "episodes": 3,
        "seed": 5,
        "official": True,
        "driver": None,
        "robot": "mine.yaml",
        "connect": ["tcp/10.0.0.7:7447"],
        "task": "push",
        "video": Path("v.mp4"),
        "accept_interface": True,
    }


def test_view_passes_every_option_on(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    view = replace(monkeypatch, "evaluation.view", "view")

    words = "view --task push --policy p.pt --driver other --robot worn --seed 5 --episodes 3"
    outcome = run(*words.split(), "--accept-interface")

    assert outcome == Outcome(0, "what the application says\n", "")
    assert view.kwargs == {
        "task": "push",
        "policy": Path("p.pt"),
        "driver": "other",
        "robot": "worn",
        "seed": 5,
        "episodes": 3,
        "accept_interface": True,
    }
    run("view", "--task", "push")
    assert (view.kwargs["policy"], view.kwargs["episodes"]) == (None, None)


def test_view_and_videos_need_a_display(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(name, raising=False)
    assert_one_sentence(run("view", "--task", "push"), "evaluate --video")
    outcome = run("train", "--task", "reach", "--video", *ONE_EPISODE)
    assert_one_sentence(outcome, "MUJOCO_GL", "libegl1")
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_run_prints_how_to_resume(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    train = replace(monkeypatch, "training.train", "train")
    train.error = KeyboardInterrupt()
    Path("there").mkdir()
    for name in ("config.yaml", "ledger.sqlite"):
        (Path("there") / name).touch()

    for option in ("--out", "--resume"):
        replace(monkeypatch, "training.train", "resume").error = KeyboardInterrupt()
        words = ["--task", "push", "--out", "there"] if option == "--out" else [option, "there"]
        outcome = run("train", *words)

        assert outcome.code == 130
        assert "iher-robot train --resume there\n" in outcome.err
        assert outcome.err.count("\n") == 1

    train.error.add_note("continue with: iher-robot train --resume runs/named")
    assert "--resume runs/named\n" in run("train", "--task", "push").err


def test_an_interrupt_without_a_run_prints_no_resume(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace(monkeypatch, "training.train", "train").error = KeyboardInterrupt()

    for words in ([], ["--out", "absent"]):
        outcome = run("train", "--task", "push", *words)
        assert outcome == Outcome(130, "", "iher-robot: interrupted\n")


# At a known moment; a signal from outside would arrive anywhere.
SIGTERM_IN_STEP_131 = """
import os, signal
from iher_robot.cli.app import main
from iher_robot.env.goal_env import GoalRobotEnv

step, steps = GoalRobotEnv.step, 0

class Finalizer:
    def __del__(self):  # what is raised here goes no further
        os.kill(os.getpid(), signal.SIGTERM)

def terminate():
    if "IN_A_FINALIZER" in os.environ:
        Finalizer()
    else:
        os.kill(os.getpid(), signal.SIGTERM)

def counted(self, action):
    global steps
    steps += 1
    if steps == 131:
        terminate()
    return step(self, action)

GoalRobotEnv.step = counted
main()
"""


def terminated_train(out: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    words = [word for setting in TINY for word in ("--set", setting)]
    words += "--task reach --preset paper --budget-minutes 0.2".split()
    words += "--set learner.schedule.real_rollouts=6".split()
    words += ["--out", str(out), "--quiet", "--device", "cpu"]
    return run_forked(SIGTERM_IN_STEP_131, "train", *words, **environment)


def test_sigterm_settles_the_ledger_and_the_run_can_be_resumed(tmp_path: Path) -> None:
    out = tmp_path / "run"
    stopped = terminated_train(out)

    assert stopped.returncode == 143
    assert stopped.stderr.startswith("iher-robot: interrupted; ")
    assert f"--resume {out}" in stopped.stderr
    assert stopped.stderr.count("\n") == 1
    # The tick in flight is charged, though nothing of it could be stored.
    assert ticks(out) == (131, 130)

    program = "from iher_robot.cli.app import main; main()"
    assert run_forked(program, "train", "--quiet", "--resume", str(out)).returncode == 0
    assert ticks(out)[0] == 300


def test_sigterm_ends_a_run_at_any_point(tmp_path: Path) -> None:
    out = tmp_path / "run"
    stopped = terminated_train(out, IN_A_FINALIZER="1")

    assert "Exception ignored in: <function Finalizer.__del__" in stopped.stderr
    assert stopped.returncode == 143
    assert f"iher-robot: interrupted; continue with: iher-robot train --resume {out}" in (
        stopped.stderr
    )
    # The tick is whole, and no other follows.
    assert ticks(out) == (131, 131)


def ticks(out: Path) -> tuple[int, int]:
    with Ledger(out / "ledger.sqlite") as ledger:
        charged = ledger.spent_ticks("motion")
    return charged, sum(len(stored.episode) for stored in EpisodeReader(out / "episodes"))


def test_sigterm_is_handled_as_before_once_the_command_line_is_done(run: Run) -> None:
    before = signal.getsignal(signal.SIGTERM)
    run("--version")
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_bug_is_not_hidden_as_bad_input(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    replace(monkeypatch, "training.train", "train").error = ValueError("a bug")

    with pytest.raises(ValueError, match="a bug"):
        run("train", "--task", "push")


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ("train --task psh", ["'psh'", "pick_and_place", "did you mean 'push'?"]),
        ("train --task push --driver mujoko", ["'mujoko'", "did you mean 'mujoco'?"]),
        ("train --task push --preset papr", ["'papr'", "did you mean 'paper'?"]),
        ("train --task push --robot ftch", ["'ftch'", "did you mean 'fetch'?"]),
        ("train --task push --robot no/robot.yaml", ["no robot file at no/robot.yaml"]),
        ("train --task push --connect tcp/a:1", ["--connect is 'tcp/a:1'", "'mujoco'", "zenoh"]),
        ("train --task push --algo hr", ["'hr'", "her-matched", "did you mean 'her'?"]),
        ("train --task push --set learner.ddpg.gama=0.9", ["gama", "learner.ddpg.gamma"]),
        ("train --task push --set learner.ddpg.gamma=1.5", ["gamma", "1.5", "1"]),
        ("train --task push --set learner.ddpg.gamma", ["learner.ddpg.gamma", "="]),
        ("train --task push --set learner.ddpg.batch_size=many", ["batch_size", "many"]),
        ("train --task push --budget-minutes 0", ["--budget-minutes is 0.0, allowed", "above 0"]),
        ("train --task push --budget-minutes nan", ["--budget-minutes is nan", "above 0"]),
        ("train --task push --budget-minutes inf", ["--budget-minutes is inf", "above 0"]),
        ("train --task push --budget-minutes=-1", ["--budget-minutes is -1.0", "above 0"]),
        ("train --task push --budget-minutes 1e300", ["--budget-minutes is 1e+300", "1000000"]),
        ("train --task push --budget-minutes soon", ["--budget-minutes"]),
        (
            "train --task push --until-success 1.5",
            ["--until-success is 1.5, allowed: off", "up to 1"],
        ),
        ("train --task push --until-success nan", ["--until-success is nan, allowed: off"]),
        (
            "train --task push --until-success soon",
            ["--until-success is 'soon'", "off", "above 0 and up to 1"],
        ),
        ("train --task push --seed=-1", ["--seed is -1, allowed", "0 or more"]),
        ("train --task push --device warp", ["--device is 'warp'", "auto, cpu, cuda"]),
        ("train --task push --preset /tmp", ["'/tmp'", "YAML file", "default, paper"]),
        ("train --task push --out=", ["--out is ''"]),
        ("train --resume=", ["--resume is ''"]),
        ("train", ["--task", "--resume"]),
        ("train --resume there --task push --seed 3", ["--resume", "--task", "--seed"]),
        ("train --resume there", ["there"]),
        ("train --tsk push", ["--tsk", "--task"]),
        ("trian --task push", ["trian", "train"]),
        ("evaluate", ["policy"]),
        ("evaluate missing.pt", ["missing.pt"]),
    ],
)
def test_bad_input_gets_one_sentence_and_leaves_no_run(
    run: Run, tmp_path: Path, words: str, parts: list[str]
) -> None:
    new_run = words.startswith("train --task") and "--budget" not in words
    assert_one_sentence(run(*words.split(), *(ONE_EPISODE if new_run else ())), *parts)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_run_folder_is_not_written_into(run: Run, tmp_path: Path) -> None:
    kept = tmp_path / "there" / "policy.pt"
    kept.parent.mkdir()
    kept.write_text("kept")

    assert_one_sentence(run("train", "--task", "reach", "--out", "there", *ONE_EPISODE), "there")
    assert list(kept.parent.iterdir()) == [kept]
    assert kept.read_text() == "kept"


def test_a_run_folder_that_cannot_be_made_is_named(run: Run, tmp_path: Path) -> None:
    (tmp_path / "file").touch()

    outcome = run("train", "--task", "reach", "--out", "file/there", *ONE_EPISODE)

    assert_one_sentence(outcome, "file/there")


def test_a_file_that_is_not_a_policy_is_refused(run: Run, tmp_path: Path) -> None:
    torch.save({"weights": torch.zeros(3)}, tmp_path / "foreign.pt")
    whole = (tmp_path / "foreign.pt").read_bytes()
    (tmp_path / "truncated.pt").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "empty.pt").touch()
    (tmp_path / "text.pt").write_text("no policy")

    for name in ("foreign.pt", "truncated.pt", "empty.pt", "text.pt"):
        assert_one_sentence(run("evaluate", name), name)


class Trap:
    """Writes a file when it is unpickled."""

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (Path("sprung"),)


def test_a_policy_file_runs_no_code(run: Run, tmp_path: Path) -> None:
    torch.save({"policy": Trap()}, tmp_path / "trap.pt")

    assert_one_sentence(run("evaluate", "trap.pt"), "trap.pt")
    assert not (tmp_path / "sprung").exists()


def test_episodes_below_one_are_refused(run: Run, tmp_path: Path) -> None:
    (tmp_path / "any.pt").touch()

    assert_one_sentence(run("evaluate", "any.pt", "--episodes", "0"), "episodes", "0")


def test_the_official_environment_has_no_driver(run: Run, tmp_path: Path) -> None:
    (tmp_path / "any.pt").touch()

    outcome = run(*"evaluate any.pt --official --driver real".split())

    assert_one_sentence(outcome, "'real'", "--driver", "--official")


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda policy: policy.clear(), "shapes"),
        (lambda policy: policy.pop("actor"), "actor"),
        (lambda policy: policy["actor"].popitem(), "Missing key"),
        (lambda policy: policy.update(actor={}), "Missing key"),
        (lambda policy: policy.update(actor=3), "int"),
        (lambda policy: policy.update(hidden=[7]), "size mismatch"),
        (lambda policy: policy.update(hidden="wide"), ""),
        (lambda policy: policy.update(normalizer_clip="x"), ""),
        (lambda policy: policy["shapes"].update(obs_dim=3), "size mismatch"),
        (lambda policy: policy["shapes"].update(depth=3), "depth"),
        (lambda policy: policy["goal_normalizer"].update(mean=torch.zeros(1)), "goal_normalizer"),
        (lambda policy: policy["obs_normalizer"].update(mean=[0.0]), "list"),
        (lambda policy: policy["obs_normalizer"].clear(), "count"),
    ],
)
def test_a_sealed_policy_that_cannot_act_is_named(
    run: Run, tmp_path: Path, change: Callable[[dict[str, Any]], object], part: str
) -> None:
    with iher_robot.make_env("reach") as env:
        shapes = Shapes(env.task.layout.obs_dim, env.task.goal_dim, 4, 50)
        policy = Policy.from_config(
            shapes, LearnerConfig(), generator=torch.Generator(), device=torch.device("cpu")
        )
        content = policy.snapshot()
        change(content)
        saved = PolicyFile(policy=content, trained={}, **env.policy_interface())
    save_policy(tmp_path / "bad.pt", saved)

    outcome = run("evaluate", "bad.pt", "--episodes", "1")
    assert_one_sentence(outcome, "bad.pt holds no policy that can act", part)


def test_a_bad_video_name_is_reported_before_missing_packages(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "imageio.v2", None)
    monkeypatch.setenv("MUJOCO_GL", "egl")
    for name, message in (
        ("film.avi", r"\.mp4"),
        ("absent/film.mp4", "no folder"),
        ("film.mp4", "pip install imageio imageio-ffmpeg"),
    ):
        with pytest.raises(iher_robot.UserError, match=message), film(tmp_path / name):
            pass


def test_no_arguments_print_the_help(run: Run) -> None:
    outcome = run()

    assert outcome.code == 0
    assert re.search(r"train .*evaluate", outcome.out, flags=re.DOTALL)


def test_python_dash_m_is_the_command_and_prints_its_version() -> None:
    command = [sys.executable, "-m", "iher_robot", "--version"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)

    assert result.stdout == f"iher-robot {iher_robot.__version__}\n"
