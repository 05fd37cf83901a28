"""Simulators side by side: what is collected and counted is that of one after the other."""

from __future__ import annotations

import itertools
import os
import signal
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from iher_robot.config.options import load_config
from iher_robot.env.goal_env import GoalRobotEnv
from iher_robot.errors import UserError
from iher_robot.evaluation.evaluate import evaluate
from iher_robot.evaluation.success_rate import run_simulated
from iher_robot.learning.episode import Episode
from iher_robot.rollout.actor import PolicyActor
from iher_robot.rollout.episode import Stream, episode_seed, run_episode
from iher_robot.rollout.recorder import Recorder
from iher_robot.rollout.simulators import pool as pool_module
from iher_robot.rollout.simulators.collect import SimulatedEpisodes
from iher_robot.rollout.simulators.episode import Order, SimulatedEpisode
from iher_robot.rollout.simulators.pool import EpisodeFuture, SimulatorPool
from iher_robot.storage.budget import Budget
from iher_robot.storage.episode import StoredEpisode
from iher_robot.storage.episode_reader import EpisodeReader
from iher_robot.storage.episode_store import EpisodeStore
from iher_robot.storage.files.sqlite import Database
from iher_robot.storage.ledger import Ledger
from iher_robot.storage.robot_time import RobotTime
from iher_robot.training import train as train_module
from iher_robot.training.display import TrainingDisplay
from iher_robot.training.result import TrainResult
from iher_robot.training.setup import open_pool, open_training_setup
from iher_robot.training.train import resume
from tests.forked import run_forked
from tests.served.served_robot import eventually, is_running
from tests.small_runs import Interruption, interruption, metrics, motion_ticks, stored_ticks
from tests.small_runs import run as run_small

MINUTES = 0.15001  # 225 ticks: two epochs of 100 ticks and a quarter of one
TICKS = 225
EPISODE_TICKS = 50
MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None  # no disk is waited for
KILLED = """
import os, signal, sys
from pathlib import Path
from tests.rollout.simulators.test_simulators import run
from iher_robot.storage.episode_journal import EpisodeIndex

original, calls = EpisodeIndex.add, 0

def killed(*args, **options):
    global calls
    calls += 1
    if calls == 2:
        me = os.getpid()
        children = Path(f"/proc/{me}/task/{me}/children").read_text()
        Path(sys.argv[2]).write_text(children)
        os.kill(me, signal.SIGKILL)
    return original(*args, **options)

EpisodeIndex.add = killed
run(Path(sys.argv[1]), simulators=2)
"""


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def run(out: Path, final_episodes: int = 0, **options: Any) -> TrainResult:
    """The cheapest run whose episodes are evaluated."""
    evaluated = ("evaluation.every_epochs=1", f"evaluation.final_episodes={final_episodes}")
    return run_small(out, MINUTES, *evaluated, robot="fetch-mocap", algo="her", **options)


def patch_simulators(patch: pytest.MonkeyPatch, then: str) -> None:
    """Do something in a simulator's process in the tenth tick of the run's third episode."""
    patched = f"""
import os
from iher_robot.env.goal_env import GoalRobotEnv
original, calls = GoalRobotEnv._run_tick, 0
def tick(self, action):
    global calls
    third = self.np_random_seed == {episode_seed(0, Stream.COLLECTION, 2)}
    calls += third
    if third and calls == 10:  # not in an episode that this process may be given afterwards
        {then}
    return original(self, action)
GoalRobotEnv._run_tick = tick
"""
    program = pool_module.PROGRAM.replace("main(int", patched + "main(int")
    patch.setattr(pool_module, "PROGRAM", program)


def assert_same_episode(one: Episode | None, other: Episode | None) -> None:
    assert one is not None
    assert other is not None
    for name, array in vars(one).items():
        assert array.dtype == getattr(other, name).dtype
        assert_array_equal(array, getattr(other, name), strict=True)


def stored(out: Path) -> list[StoredEpisode]:
    with EpisodeReader(out / "episodes") as reader:
        return list(reader)


def assert_same_run(one: Path, other: Path) -> None:
    assert metrics(one) == metrics(other)
    for first, second in zip(stored(one), stored(other), strict=True):
        assert_same_episode(first.episode, second.episode)
        assert_array_equal(first.seqs, second.seqs)
        assert_array_equal(first.elapsed, second.elapsed)
        for name in ("epoch", "policy_source", "account", "seed", "index", "ended"):
            assert getattr(first, name) == getattr(second, name), name


def totals(out: Path) -> dict[str, int]:
    with Ledger(out / "ledger.sqlite") as ledger:
        assert not ledger.open_reservations
        return {account: ledger.spent_ticks(account) for account in ("motion", "reset", "idle")}


@pytest.fixture(scope="module")
def one_after_the_other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("simulators") / "serial"
    run(out)
    return out


def test_a_run_is_the_same_with_any_number_of_simulators(
    tmp_path: Path, one_after_the_other: Path
) -> None:
    run(tmp_path / "two", simulators=2)
    assert_same_run(tmp_path / "two", one_after_the_other)
    assert totals(tmp_path / "two") == totals(one_after_the_other)


def test_the_final_policy_does_in_several_simulators_what_it_does_in_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_seeds, step = SimulatorPool.run, GoalRobotEnv.step
    beside: list[SimulatedEpisode] = []
    here: list[Any] = []

    def noted(*args: Any) -> Iterator[SimulatedEpisode]:
        for episode in run_seeds(*args):
            beside.append(episode)
            yield episode

    def noted_step(*args: Any) -> Any:
        result = step(*args)
        here.append(result[0]["observation"])
        return result

    monkeypatch.setattr(SimulatorPool, "run", noted)
    with monkeypatch.context() as patch:
        patch.delattr(train_module, "evaluate_on")
        result = run(tmp_path / "run", simulators=2, final_episodes=3)
    monkeypatch.setattr(GoalRobotEnv, "step", noted_step)
    assert result.final == evaluate(result.policy, episodes=3, robot="fetch-mocap")
    episodes = [one.episode() for one in beside[-3:]]
    found = np.concatenate([one.observations[1:] for one in episodes if one is not None])
    assert_array_equal(np.array(here, found.dtype), found)


def test_a_run_goes_on_with_another_number_of_simulators(
    tmp_path: Path, one_after_the_other: Path
) -> None:
    out = tmp_path / "run"
    with interruption(TrainingDisplay, "epoch", 1):
        run(out, simulators=2)
    with pytest.raises(UserError, match="--simulators is 0, allowed: an integer, 1 or more"):
        resume(out, simulators=0, display=False)
    resume(out, simulators=1, display=False)
    assert metrics(out) == metrics(one_after_the_other)


def test_a_learner_beside_evaluates_the_same_in_simulators_of_its_own(tmp_path: Path) -> None:
    run(tmp_path / "one", asynchronous=True)
    run(tmp_path / "two", asynchronous=True, simulators=2)
    assert_same_run(tmp_path / "two", tmp_path / "one")


def test_what_explores_in_another_process_is_what_would_explore_here() -> None:
    """The second policy of Push included, before and after it rests."""
    config = load_config("push", overrides=["simulators=2"], robot="fetch-mocap")
    with open_training_setup(config) as setup:
        assert setup.pool is not None
        assert setup.learner.contact is not None
        for rests, seeds in ((False, (3, 1, 2)), (True, (4, 5))):
            setup.learner.contact.rests = rests
            setup.pool.act_as(setup.learner)
            for explores in (True, False):
                found = list(run_all(setup.pool, [Order(seed, 20, explores) for seed in seeds]))
                for seed, other in zip(seeds, found, strict=True):
                    recorder = Recorder()
                    actor = PolicyActor(
                        setup.learner.acting_policy(torch.device("cpu")),
                        setup.learner.explorer() if explores else None,
                    )
                    run_episode(setup.env, actor, recorder, seed=seed, ticks=20)
                    assert_same_episode(recorder.episode(), other.episode())
                    assert recorder.policy_source == other.policy_source
                    assert recorder.success == other.success
        here = list(run_simulated(setup.env, setup.learner, range(7, 10)))
        beside = list(setup.pool.run(setup.learner, range(7, 10)))
        for one, other in zip(here, beside, strict=True):
            assert_same_episode(one.episode(), other.episode())


def run_all(pool: SimulatorPool, orders: list[Order]) -> Iterator[SimulatedEpisode]:
    pool.expect(len(orders))
    episodes: list[EpisodeFuture] = []
    for order in orders:
        while not pool.free:
            pool.wait()
        episodes.append(pool.start(order))
    for episode in episodes:
        while not episode.done():
            pool.wait()
        yield episode.result()


class FakePool:
    """Ends episodes in any order; each as long as its seed says, if it is allowed to be.

    Where it says 0, the first with that seed ends before its first tick, and the next are whole.
    """

    episode_ticks, opened_ticks = EPISODE_TICKS, 1

    def __init__(self, simulators: int, lengths: list[int], order: Iterator[int]) -> None:
        self._simulators, self._lengths, self._order = simulators, lengths, order
        self._running: list[tuple[EpisodeFuture, Order, int]] = []
        self.most = 0
        self.ran: list[tuple[int, int]] = []
        """Seed and length of each episode, in the order in which they began."""

    def act_as(self, learner: object) -> None: ...

    def expect(self, episodes: int) -> None: ...

    @property
    def free(self) -> bool:
        return len(self._running) < self._simulators

    def start(self, order: Order) -> EpisodeFuture:
        wanted = self._lengths[order.seed % len(self._lengths)]
        if not wanted and (order.seed, 0) in self.ran:
            wanted = EPISODE_TICKS
        self.ran.append((order.seed, min(wanted, order.ticks)))
        self._running.append((EpisodeFuture(), order, self.ran[-1][1]))
        self.most = max(self.most, len(self._running))
        return self._running[-1][0]

    def wait(self) -> None:
        episode, order, length = self._running.pop(next(self._order) % len(self._running))
        zeros = np.zeros((length, 1))
        data = Episode(np.zeros((length + 1, 1)), zeros, zeros, np.ones(length, bool), np.zeros(1))
        episode.set_result(
            SimulatedEpisode(
                ticks=max(length, 1),
                reset_ticks=1,
                success=False,
                aborted="lost" if length < order.ticks else "",
                policy_source=0,
                ended="lost" if length < order.ticks else "done",
                failure="",
                steps=np.arange(1, length + 1),
                elapsed=np.ones(length, np.int64),
                data=data if length else None,
            )
        )


def collect(
    folder: Path, pool: Any, budget_ticks: int
) -> tuple[list[tuple[int, int, int, list[int]]], int, int]:
    """Run epochs of three episodes until the budget is spent; what is kept, and what it cost."""
    folder.mkdir()
    with (
        Ledger(folder / "ledger.sqlite") as ledger,
        EpisodeStore(folder / "episodes") as store,
    ):
        budget = Budget(ledger, RobotTime(budget_ticks, 0.04))
        episodes = SimulatedEpisodes(pool, budget, store, lambda number: number)
        collected, epoch = 0, 1
        learner: Any = None
        with episodes:
            while budget.remaining.ticks:
                have = 0
                while have < 3 and budget.remaining.ticks:
                    for one in episodes.run(learner, epoch=epoch, first=collected, count=3 - have):
                        assert budget.spent.ticks <= budget_ticks
                        have += one.data is not None
                        collected += one.data is not None
                epoch += 1
        assert not ledger.open_reservations
        kept = [(s.seed, s.epoch, len(s.episode), s.seqs.tolist()) for s in store]
        return kept, ledger.spent_ticks("motion"), ledger.spent_ticks("reset")


@settings(max_examples=12, deadline=None)
@given(
    simulators=st.integers(2, 4),
    budget_ticks=st.integers(1, 420),
    lengths=st.lists(st.integers(1, 80), min_size=1, max_size=5),
    order=st.lists(st.integers(0, 3), min_size=1, max_size=6),
)
def test_the_same_episodes_for_any_budget_and_whichever_ends_first(
    simulators: int, budget_ticks: int, lengths: list[int], order: list[int]
) -> None:
    with TemporaryDirectory(dir=MEMORY) as folder:
        alone = FakePool(1, lengths, itertools.repeat(0))
        one = collect(Path(folder) / "one", alone, budget_ticks)
        beside = FakePool(simulators, lengths, itertools.cycle(order))
        many = collect(Path(folder) / "many", beside, budget_ticks)
    assert one == many
    assert one[1] == budget_ticks


@settings(max_examples=12, deadline=None)
@given(
    simulators=st.integers(1, 4),
    budget_ticks=st.integers(1, 420),
    lengths=st.lists(st.integers(0, 80), min_size=1, max_size=5),
    order=st.lists(st.integers(0, 3), min_size=1, max_size=6),
)
def test_no_number_is_left_out_where_an_episode_ends_before_its_first_tick(
    simulators: int, budget_ticks: int, lengths: list[int], order: list[int]
) -> None:
    """Those begun after it are charged and thrown away, of which one simulator begins none."""
    pool = FakePool(simulators, lengths, itertools.cycle(order))
    with TemporaryDirectory(dir=MEMORY) as folder:
        kept, motion, reset = collect(Path(folder) / "run", pool, budget_ticks)
    expected: list[tuple[int, int]] = []
    for seed, length in pool.ran:
        if seed == len(expected) and length:
            expected.append((seed, length))
    assert [(seed, length) for seed, _, length, _ in kept] == expected
    assert motion == sum(max(length, 1) for _, length in pool.ran) == budget_ticks
    assert reset == len(pool.ran) + pool.opened_ticks
    if simulators == 1:
        assert [one for one in pool.ran if one[1]] == expected


def test_an_error_in_one_simulator_keeps_what_was_recorded_in_all(tmp_path: Path) -> None:
    out = tmp_path / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch_simulators(patch, "raise RuntimeError('a mistake')")
        with pytest.raises(UserError, match="ended by RuntimeError: a mistake, see its messages"):
            run(out, simulators=2)
    kept = stored(out)
    lengths = [len(one.episode) for one in kept]
    assert (lengths[:3], kept[2].ended) == ([50, 50, 9], "RuntimeError: a mistake")
    assert lengths[3:] in ([], [50]), "what was under way beside it is whole"
    assert motion_ticks(out) == stored_ticks(out) + 1, "the tick in flight is counted"
    totals(out)
    resume(out, simulators=1, display=False)
    assert motion_ticks(out) == TICKS


def test_a_simulator_that_dies_is_an_error_and_counts_in_full(tmp_path: Path) -> None:
    out = tmp_path / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch_simulators(patch, "os.kill(os.getpid(), 9)")
        with pytest.raises(UserError, match=r"^a simulator's process ended by itself with signal"):
            run(out, simulators=2)
    assert stored_ticks(out) == 2 * EPISODE_TICKS
    assert motion_ticks(out) in (3 * EPISODE_TICKS, 4 * EPISODE_TICKS)
    resume(out, simulators=1, display=False)
    assert motion_ticks(out) == TICKS
    seeds = [episode_seed(0, Stream.COLLECTION, number) for number in range(5)]
    assert [one.seed for one in stored(out)] == seeds[: len(stored(out))]


def test_an_interrupt_keeps_the_episodes_under_way(tmp_path: Path) -> None:
    out = tmp_path / "run"
    with interruption(EpisodeStore, "keep", 1):
        run(out, simulators=2)
    assert [len(one.episode) for one in stored(out)] == [EPISODE_TICKS] * 2
    assert totals(out)["motion"] == 2 * EPISODE_TICKS


def test_an_interrupt_while_an_episode_is_written_down_loses_nothing(
    tmp_path: Path, one_after_the_other: Path
) -> None:
    """It comes when the first is in the index, and before the store knows."""
    out, execute = tmp_path / "run", Database.execute
    coming = ["INSERT INTO episode VALUES (?, ?, ?)", "COMMIT"]

    def interrupted(database: Database, statement: str, values: Any = ()) -> Any:
        cursor = execute(database, statement, values)
        if coming and statement == coming[0]:
            coming.pop(0)
            if not coming:
                raise Interruption
        return cursor

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Database, "execute", interrupted)
        with pytest.raises(Interruption):
            run(out, simulators=2)
    assert [len(one.episode) for one in stored(out)] == [EPISODE_TICKS] * 2
    assert totals(out)["motion"] == 2 * EPISODE_TICKS
    resume(out, simulators=1, display=False)
    assert metrics(out) == metrics(one_after_the_other)


def test_an_episode_that_cannot_begin_costs_nothing(tmp_path: Path) -> None:
    pool: Any = FakePool(2, [EPISODE_TICKS], itertools.cycle([0]))
    start = pool.start

    def refused(order: Order) -> EpisodeFuture:
        if order.seed == 1:
            raise UserError("the simulator is gone")
        return cast(EpisodeFuture, start(order))

    pool.start = refused
    learner: Any = None
    with Ledger(tmp_path / "ledger") as ledger, EpisodeStore(tmp_path / "episodes") as store:
        with (
            pytest.raises(UserError, match="the simulator is gone"),
            SimulatedEpisodes(
                pool, Budget(ledger, RobotTime(TICKS, 0.04)), store, lambda n: n
            ) as episodes,
        ):
            list(episodes.run(learner, epoch=1, first=0, count=3))
        assert [one.seed for one in store] == [0]
        assert ledger.spent_ticks("motion") == EPISODE_TICKS
        assert ledger.spent_ticks("reset") == 1 + pool.opened_ticks
        assert not ledger.open_reservations


def test_a_killed_run_leaves_no_simulator_and_counts_what_was_reserved(tmp_path: Path) -> None:
    """The second episode is over, and in the journal alone."""
    out, children = tmp_path / "run", tmp_path / "children"
    done = run_forked(KILLED, str(out), str(children))
    assert done.returncode == -signal.SIGKILL, done.stderr
    simulators = list(map(int, children.read_text().split()))
    assert len(simulators) == 2
    try:
        assert eventually(lambda: not any(map(is_running, simulators)))
    finally:
        for simulator in filter(is_running, simulators):
            os.kill(simulator, signal.SIGKILL)
    assert motion_ticks(out) == 2 * EPISODE_TICKS
    resume(out, simulators=1, display=False)
    assert motion_ticks(out) == TICKS
    assert stored_ticks(out) == TICKS
    assert [row["epoch"] for row in metrics(out)] == list(range(1, len(metrics(out)) + 1))


@pytest.mark.parametrize("what", ["physical", "exclusive", "paces_itself"])
def test_any_other_robot_stays_one(what: str) -> None:
    is_so = {"exclusive": False, "paces_itself": False} | {what: True}
    spec = SimpleNamespace(physical=what == "physical")
    env: Any = SimpleNamespace(driver=SimpleNamespace(spec=spec, **is_so))
    config = load_config("push", overrides=["simulators=2"])
    with (
        ExitStack() as stack,
        pytest.raises(UserError, match=r"^simulators is 2, but mujoco fetch .* allowed: 1; "),
    ):
        open_pool(config, env, stack)
