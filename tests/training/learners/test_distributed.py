"""Training runs that torchrun starts as several processes, which learn together."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import pytest
import torch

from iher_robot.config.options import load_config
from iher_robot.errors import UserError
from iher_robot.storage.checkpoint import load_checkpoint
from iher_robot.storage.provenance import read_provenance
from iher_robot.training import loop as loop_module
from iher_robot.training.learners import distributed_worker as distributed_worker_module
from iher_robot.training.learners.distributed import DistributedLearner
from iher_robot.training.learners.messages import weights_checksum
from iher_robot.training.learners.process_group import PeerGone, PeerGroup
from iher_robot.training.learners.torchrun import TorchrunRank
from iher_robot.training.train import resume
from tests.learning.point_mass import PointMassGoals
from tests.learning.small_learner import new, quick
from tests.repository import ROOT
from tests.served.served_robot import eventually, is_running
from tests.small_runs import TINY, metrics, motion_ticks, run, stored_ticks

MINUTES = 0.15001  # 225 ticks: two epochs of 100 ticks and a quarter of one
TICKS = 225
WITH_CONTACT = (
    "learner.schedule.workers=2",
    "learner.schedule.real_rollouts=1",
    "learner.contact.enabled=true",
    "learner.matmul_precision=highest",
)
TASK = ("--task", "push", "--preset", "paper", "--device", "cpu", "--quiet")
OPTIONS = (*TASK, "--until-success", "off", "--budget-minutes", str(MINUTES))
PROGRAM = """
import os, sys
from pathlib import Path
from iher_robot.cli.app import main
from iher_robot.learning.learner import Learner
from iher_robot.training.learners.process_group import PeerGroup

rank = int(os.environ["RANK"])
Path(f"pid-{rank}").write_text(str(os.getpid()))
learn, agree_on, calls = Learner.learn, PeerGroup.agree_on, 0

def learn_and(self, *progress):
    global calls
    calls += 1
    if LEARNING and (rank, calls) == (LEARNING - 1, 2):
        self.ddpg.end_cycle = lambda: os.kill(os.getpid(), 9)
    return learn(self, *progress)

def agree_and(self, number):
    same = agree_on(self, number)
    if WAITING and rank:
        os.kill(os.getpid(), 9)
    return same

Learner.learn, PeerGroup.agree_on = learn_and, agree_and
main(sys.argv[1:])
"""
"""Kills the process before LEARNING in the second epoch, or the others after WAITING."""

GONE = (
    "process 1 of the 2 that learn together is gone; nothing recorded is lost, continue with: "
    "iher-robot train --resume run"
)


@dataclass
class Ended:
    stdout: str
    stderr: str


def _command(processes: int, *program: str) -> list[str]:
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone"]
    return [*torchrun, "--nproc-per-node", str(processes), *program]


def _train(folder: Path, *words: str, learning: int = 0, waiting: bool = False) -> Ended:
    """Run the command in two processes, and wait until all of them are gone."""
    program = folder / "program.py"
    said = PROGRAM.replace("LEARNING", str(learning)).replace("WAITING", str(waiting))
    program.write_text(said)
    settings = [word for setting in (*TINY, *WITH_CONTACT) for word in ("--set", setting)]
    words = words or (*OPTIONS, *settings, "--out", "run")
    with subprocess.Popen(
        _command(2, str(program), "train", *words),
        cwd=folder,
        env=_environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            stdout, stderr = process.communicate(timeout=120.0)
        finally:
            process.kill()
    for pid in _pids(folder):
        assert not is_running(pid)
    return Ended(stdout, stderr)


def _environment() -> dict[str, str]:
    root = str(ROOT)
    return os.environ | {
        "GLOO_SOCKET_IFNAME": "lo",
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])]),
    }


def _pids(folder: Path) -> list[int]:
    return [int(path.read_text()) for path in sorted(folder.glob("pid-*"))]


def _tensors(node: Any, path: str = "") -> Iterator[tuple[str, torch.Tensor]]:
    if isinstance(node, torch.Tensor):
        yield path, node
    elif isinstance(node, dict):
        for name, part in node.items():
            yield from _tensors(part, f"{path}/{name}")


def _assert_close(one: Path, other: Path) -> None:
    """Whether two runs came to the same, within what rounding does to episodes, too."""
    states = [load_checkpoint(out / "checkpoint.pt") for out in (one, other)]
    assert states[0] is not None
    assert states[1] is not None
    compared = 0
    learners = [dict(_tensors(state["learner"])) for state in states if state is not None]
    for name, tensor in learners[0].items():
        if "optimizer" not in name and tensor.is_floating_point():
            torch.testing.assert_close(tensor, learners[1][name], rtol=1e-3, atol=1e-4, msg=name)
            compared += 1
    assert compared > 50
    ours, theirs = metrics(one), metrics(other)
    assert [list(row) for row in ours] == [list(row) for row in theirs]
    for row, expected in zip(ours, theirs, strict=True):
        for name, value in row.items():
            if expected[name] is None:
                assert value is None
            else:
                assert value == pytest.approx(expected[name], rel=1e-2, abs=1e-5), name


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.set_num_threads(1)
    out = tmp_path_factory.mktemp("alone") / "run"
    run(out, MINUTES, *WITH_CONTACT, task="push")
    return out


def test_two_processes_equal_one_even_if_the_one_that_has_robot_and_folder_was_killed(
    tmp_path: Path, alone: Path
) -> None:
    out = tmp_path / "run"
    ended = _train(tmp_path, learning=1)
    assert "iher-robot:" not in ended.stderr
    assert "iher_robot/" not in ended.stderr, "no traceback"
    assert "<NO_OTHER_FAILURES>" in ended.stderr, "torchrun did not have to kill the other one"
    assert [row["epoch"] for row in metrics(out)] == [1]
    ended = _train(tmp_path, "--resume", "run", "--quiet")
    assert ended.stderr == ""
    assert ended.stdout.startswith("success in 2 fresh episodes")
    assert ended.stdout.count("policy  ") == 1, "the other one says nothing"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["pid-0", "pid-1", "program.py", "run"]
    assert motion_ticks(out) == stored_ticks(out) == motion_ticks(alone) == TICKS
    assert read_provenance(out / "provenance.json")["processes"] == 2
    assert "processes" not in read_provenance(alone / "provenance.json")
    configs = [(folder / "config.yaml").read_text() for folder in (out, alone)]
    assert configs[0] == configs[1], "how many learn is no setting of a run"
    _assert_close(out, alone)


@pytest.mark.parametrize(("learning", "waiting"), [(2, False), (0, True)])
def test_a_process_that_is_gone_ends_the_run_with_a_sentence_and_costs_nothing(
    tmp_path: Path, alone: Path, learning: int, waiting: bool
) -> None:
    ended = _train(tmp_path, learning=learning, waiting=waiting)
    said = [line for line in ended.stderr.splitlines() if line.startswith("iher-robot:")]
    assert said == [f"iher-robot: {GONE}"]
    assert re.search(r"exitcode *: 2 .*pid: " + str(_pids(tmp_path)[0]), ended.stderr)
    assert "iher_robot/" not in ended.stderr, "no traceback"
    assert ended.stdout == ""
    out = tmp_path / "run"
    assert [row["epoch"] for row in metrics(out)] == [1]
    assert motion_ticks(out) == stored_ticks(out), "the episode under way was ended"
    if learning:
        resume(out, display=False)  # with one process, what two began
        _assert_close(out, alone)


def test_an_interrupt_of_torchrun_ends_all_in_order(tmp_path: Path) -> None:
    words = ["-m", "iher_robot", "train", *TASK, "--out", "run", "--budget-minutes", "9"]
    words += ["--set", "evaluation.episodes=1", "--set", "learner.schedule.real_rollouts=1"]
    words += [word for setting in TINY[:6] for word in ("--set", setting)]
    command = _command(2, *words)
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, cwd=tmp_path, env=_environment(), stderr=pipe, text=True
    ) as process:
        try:
            assert eventually((tmp_path / "run" / "checkpoint.pt").exists, 60.0)
            children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text()
            process.send_signal(signal.SIGINT)
            _, stderr = process.communicate(timeout=25.0)
        finally:
            process.kill()
    said = [line for line in stderr.splitlines() if line.startswith("iher-robot:")]
    assert said == ["iher-robot: interrupted; continue with: iher-robot train --resume run"]
    assert len(children.split()) >= 2
    assert not [child for child in children.split() if is_running(int(child))]


def _place(monkeypatch: pytest.MonkeyPatch, rank: int, count: int) -> None:
    names = {"TORCHELASTIC_RUN_ID": "x", "RANK": rank, "WORLD_SIZE": count, "LOCAL_RANK": rank}
    for name, value in names.items():
        monkeypatch.setenv(name, str(value))


def test_what_cannot_be_shared_is_refused_before_anything_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _place(monkeypatch, 0, 2)
    with pytest.raises(UserError, match=r"--async one process .* torchrun several .* one of the"):
        run(tmp_path / "run", MINUTES, asynchronous=True)
    _place(monkeypatch, 0, 3)
    sentence = r"ddpg.batch_size is 64, which 3 processes cannot share equally, allowed: a multiple"
    with pytest.raises(UserError, match=sentence):
        run(tmp_path / "run", MINUTES)
    _place(monkeypatch, 1, 2)
    with pytest.raises(UserError, match=r"process 1 of torchrun, which only learns"):
        run(tmp_path / "run", MINUTES)
    assert not (tmp_path / "run").exists()


def test_a_process_without_a_gpu_of_its_own_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    config = load_config("reach", device="auto")
    require = distributed_worker_module._require_device
    require(config, TorchrunRank(rank=1, world_size=2, local_rank=1))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    require(config, TorchrunRank(rank=2, world_size=3, local_rank=0))
    with pytest.raises(UserError, match=r"process 1 of the 2 .* no GPU: this machine has 1"):
        require(config, TorchrunRank(rank=1, world_size=2, local_rank=1))


def test_torchrun_with_one_process_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _place(monkeypatch, 0, 1)
    result = run(tmp_path / "run", 0.03)
    assert result.epochs == 1


def test_weights_that_differ_end_the_run_with_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Apart:
        world_size = 2
        gone: PeerGone | None = None

        def join(self) -> None:
            pass

        def send(self, message: object) -> None:
            pass

        def agree_on(self, number: int) -> bool:
            return False

        def missed(self, timeout_s: float = 0.0) -> PeerGone | None:
            return self.gone

        def close(self) -> None:
            pass

    group = Apart()

    def learning(self: loop_module.TrainingRun) -> DistributedLearner:
        return DistributedLearner(self.setup, cast(PeerGroup, group), Path("r"), self._phase)

    monkeypatch.setattr(loop_module.TrainingRun, "_make_learning", learning)
    with pytest.raises(UserError, match=r"after epoch 1 the weights of the 2 .* --resume r$"):
        run(tmp_path / "run", MINUTES)
    group.gone = PeerGone(1)
    with pytest.raises(UserError, match=r"process 1 of the 2 that learn together is gone"):
        run(tmp_path / "other", MINUTES)


def test_a_single_weight_makes_another_number() -> None:
    config = quick(contact={"enabled": True, "hidden": (16, 16)})
    learners = [new(config, contact_model=PointMassGoals()) for _ in range(2)]
    number = weights_checksum(learners[0])
    assert 0 <= number < 2**63
    assert weights_checksum(learners[1]) == number
    one, contact = learners[0], learners[0].contact
    assert contact is not None
    for module in (one.ddpg.critics, one.policy.actor, one.ensemble.members, contact.ddpg.critics):
        with torch.no_grad():
            next(iter(module.parameters())).view(-1)[0] += 1e-6
        assert weights_checksum(one) != number
        number = weights_checksum(one)
