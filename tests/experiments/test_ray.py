"""Experiments on a Ray cluster of several nodes on this machine, one of which is lost."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from iher_robot.errors import UserError
from iher_robot.experiments.experiment import experiment
from iher_robot.experiments.folder import ExperimentFolder
from tests.experiments.small import (
    EPOCH_MINUTES,
    epochs,
    process_count,
    processes_of,
    start,
    write_manifest,
)
from tests.served.served_robot import eventually, free_port

pytest.importorskip("ray")

CELLS = ("reach-her-matched-paper-seed0", "reach-her-matched-paper-seed1")


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A head without cores for cells, and two nodes with one each."""
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    made.workers = [made.add_node(num_cpus=1) for _ in range(2)]
    try:
        yield made
    finally:
        made.shutdown()


def test_an_experiment_finishes_on_the_remaining_nodes(cluster: Any, tmp_path: Path) -> None:
    out = tmp_path / "out"
    manifest = write_manifest(tmp_path / "m.yaml", {"budgets": [0.5], "seeds": [0, 1]})

    running = start(manifest, out, "--executor", "ray", "--address", cluster.address)
    try:
        begun = eventually(lambda: all(len(epochs(out, cell)) >= 1 for cell in CELLS), 180.0)
        if not begun:
            running.kill()
            pytest.fail(running.communicate()[0])
        both = set(processes_of(out))
        assert len(both) == 2, "one on each node"
        cluster.remove_node(cluster.workers[1], allow_graceful=False)
        assert eventually(lambda: len(set(processes_of(out)) & both) == 1, 60.0), "its cell ended"
        printed, _ = running.communicate(timeout=300.0)
    finally:
        running.kill()

    assert running.returncode == 0, printed
    assert "2 of 2 cells finished" in printed
    for cell in CELLS:
        assert epochs(out, cell) == list(range(1, len(epochs(out, cell)) + 1))
    # Both nodes see the folder: the cell of the lost node continued from its last epoch.
    assert sorted(process_count(out, cell) for cell in CELLS) == [1, 2]
    assert processes_of(out) == []


def test_cells_on_the_nodes_own_disks_send_small_files(cluster: Any, tmp_path: Path) -> None:
    out = tmp_path / "out"
    manifest = write_manifest(tmp_path / "m.yaml", {"budgets": [EPOCH_MINUTES]})
    options: dict[str, Any] = {"executor": "ray", "address": cluster.address, "display": False}

    done = experiment(manifest, out=out, ship=True, **options)

    assert not done.failed
    folder = ExperimentFolder(out)
    assert {file.name for file in folder.run(CELLS[0]).path.iterdir()} == {
        *("config.yaml", "provenance.json", "metrics.jsonl"),
        *("policy.pt", "success.png", "result.json"),
    }
    assert folder.log(CELLS[0]).read_text().startswith("== ")
    assert not experiment(manifest, out=out, **options).failed
    assert process_count(out, CELLS[0]) == 1, "it has finished"


def test_no_cluster(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="cannot use the Ray cluster"):
        experiment(
            write_manifest(tmp_path / "m.yaml", {}),
            out=tmp_path / "out",
            executor="ray",
            address=f"127.0.0.1:{free_port()}",
        )
