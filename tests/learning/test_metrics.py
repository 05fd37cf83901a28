"""Averages of metrics."""

from __future__ import annotations

import torch

from iher_robot.learning.metrics import Meter


def test_each_name_is_averaged_over_the_steps_that_reported_it() -> None:
    meter = Meter()
    meter.add({"loss": 1.0, "q": torch.tensor(2.0)})
    meter.add({"loss": 4.0})
    meter.add({"q": torch.tensor(-6.0), "loss": torch.tensor(1.0)})
    assert meter.means() == {"loss": 2.0, "q": -2.0}


def test_each_step_of_a_vector_counts_once() -> None:
    meter = Meter()
    meter.add({"loss": torch.tensor([1.0, 2.0, 3.0]), "q": torch.tensor([5.0])})
    meter.add({"loss": torch.tensor([6.0])})
    meter.add({"loss": 8.0, "q": torch.tensor(7.0)})
    assert meter.means() == {"loss": 4.0, "q": 6.0}
