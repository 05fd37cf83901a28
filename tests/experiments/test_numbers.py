"""Numbers of a report, against values worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from iher_robot.experiments import words
from iher_robot.experiments.numbers import (
    MinutesTo,
    Run,
    estimate,
    minutes_to,
    ratio,
    success_curve,
)


def run(*points: tuple[float, float], seed: int = 0, ended: bool = True) -> Run:
    minutes, success = np.array(points).reshape(-1, 2).T
    return Run(seed, minutes, success, ended, wall_seconds=60.0, final=None)


RUNS = [
    run((1.0, 0.2), (2.0, 0.95), (3.0, 0.6)),
    run((1.0, 0.5), (2.0, 0.6), (3.0, 0.9)),
    run((1.0, 0.0), (2.0, 0.3), (3.0, 0.7)),
]


def test_minutes_are_those_of_the_first_evaluation_with_the_rate() -> None:
    assert minutes_to(RUNS, 0.5) == MinutesTo((2.0, 1.0, 3.0), (3.0, 3.0, 3.0))
    assert minutes_to(RUNS, 0.5).median == 2.0


def test_a_seed_that_never_reached_it_is_later_than_all_that_did() -> None:
    found = minutes_to(RUNS, 0.9)

    assert found.seeds == (2.0, 3.0, math.inf)
    assert found.median == 3.0
    assert words.minutes_to(found) == "**3.0** (2.0, 3.0, not in 3.0)"


def test_a_median_that_is_not_known_is_bounded_by_how_far_was_looked() -> None:
    found = minutes_to([RUNS[0], run((4.0, 0.1)), run((5.0, 0.1))], 0.9)

    assert math.isinf(found.median)
    assert found.censored_at == 4.0, "the least that it can be: of 2, 4 or more, 5 or more"
    assert words.minutes_to(found) == "**not in 4.0** (2.0, not in 4.0, not in 5.0)"
    assert words.minutes_to(minutes_to([run((0.25, 0.0))], 0.9)) == "**not in 0.25**"


@pytest.mark.parametrize(
    ("baseline", "other", "found", "said"),
    [
        (420.0, 2.4, ("=", 175.0), "175"),
        (3.0, 2.0, ("=", 1.5), "1.5"),
        (math.inf, 2.0, (">", 50.0), "> 50"),
        (3.0, math.inf, ("<", 0.03), "< 0.03"),
        (math.inf, math.inf, None, "-"),
        (math.inf, 200.0, None, "-"),  # it may be faster or slower
        (300.0, math.inf, None, "-"),
    ],
)
def test_ratios(baseline: float, other: float, found: tuple[str, float] | None, said: str) -> None:
    """Each looked at for 100 minutes."""
    result = ratio(MinutesTo((baseline,), (100.0,)), MinutesTo((other,), (100.0,)))

    assert (result is None) == (found is None)
    if result and found:
        assert result[0] == found[0]
        assert result[1] == pytest.approx(found[1])
    assert words.ratio(result) == said


def test_a_curve_holds_the_last_rate_of_what_has_ended_and_ends_with_what_goes_on() -> None:
    stopped = run((1.0, 0.0), (2.0, 1.0))
    others = [run((1.5, 0.2), (3.0, 0.4), (4.0, 0.8)), run((1.0, 0.4), (3.0, 0.6), ended=False)]

    curve = success_curve([stopped, *others])

    # From the latest beginning to where one that goes on has come.
    assert curve.minutes.tolist() == [1.5, 2.0, 3.0]
    scores = np.array([[0.0, 1.0, 1.0], [0.2, 0.2, 0.4], [0.4, 0.4, 0.6]])
    np.testing.assert_allclose(curve.iqm, scores.mean(axis=0))  # of three nothing is trimmed
    assert (curve.low <= curve.iqm).all()
    assert (curve.iqm <= curve.high).all()
    np.testing.assert_allclose(curve.low[0], 0.0)
    np.testing.assert_allclose(curve.high[0], 0.4)


def test_the_interquartile_mean_leaves_out_a_quarter_on_either_side() -> None:
    by_hand = (0.2 + 0.6 + 0.7 + 0.8) / 4

    assert estimate([1.0, 0.1, 0.2, 0.6, 0.7, 0.8, 0.9, 0.0], kind="iqm").value == (
        pytest.approx(by_hand)
    )
    # Over tasks: of all scores together, wherever they are from.
    over_tasks = estimate([1.0, 0.1, 0.2, 0.6], [0.7, 0.8, 0.9, 0.0], kind="iqm")
    assert over_tasks.value == pytest.approx(by_hand)


def test_over_tasks_seeds_are_drawn_within_each() -> None:
    # Whatever is drawn, half of the scores are of either task.
    found = estimate([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], kind="mean")

    assert (found.value, found.low, found.high) == (0.5, 0.5, 0.5)


def test_the_interval_of_two_seeds_is_the_two_of_them() -> None:
    # One in four draws takes the same seed twice, on either side: the percentiles are the ends.
    found = estimate([0.4, 0.8], kind="mean")

    assert (found.value, found.low, found.high) == pytest.approx((0.6, 0.4, 0.8))
    assert words.estimate(found) == "60 % (40 to 80)"


def test_the_interval_of_many_seeds_is_that_of_their_mean() -> None:
    scores = np.random.default_rng(1).normal(0.5, 0.1, 400)

    found = estimate(scores.tolist(), kind="mean")

    error = 1.96 * scores.std() / math.sqrt(400)
    assert found.low == pytest.approx(scores.mean() - error, abs=0.1 * error)
    assert found.high == pytest.approx(scores.mean() + error, abs=0.1 * error)
    assert estimate(scores.tolist(), kind="mean") == found, "the draws are seeded"


def test_one_seed_has_no_interval() -> None:
    found = estimate([0.4], kind="iqm")

    assert (found.value, math.isnan(found.low), math.isnan(found.high)) == (0.4, True, True)
    assert words.estimate(found) == "40 %"


def test_nothing_was_evaluated() -> None:
    assert success_curve([run()]).minutes.size == 0
