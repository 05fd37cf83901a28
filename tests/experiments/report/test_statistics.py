"""Statistics of a report, against values computed by hand."""

from __future__ import annotations

import math
import statistics

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from iher_robot.experiments.report import formatting
from iher_robot.experiments.report.minutes_to_success import Crossing, MinutesTo, Ratio, ratio
from iher_robot.experiments.report.statistics import Run, estimate, success_curve


def run(*points: tuple[float, float], seed: int = 0, ended: bool = True) -> Run:
    minutes, success = np.array(points).reshape(-1, 2).T
    return Run(seed, minutes, success, 50, ended, until_success=None, wall_seconds=60.0, final=None)


RUNS = [
    run((1.0, 0.2), (2.0, 0.95), (3.0, 0.6)),
    run((1.0, 0.5), (2.0, 0.6), (3.0, 0.9)),
    run((1.0, 0.0), (2.0, 0.3), (3.0, 0.7)),
]


def crossings(*each: tuple[float, float]) -> MinutesTo:
    return MinutesTo(tuple(Crossing(after, by) for after, by in each))


def test_a_rate_is_reached_between_two_evaluations() -> None:
    assert MinutesTo.of(RUNS, 0.5) == crossings((1.0, 2.0), (0.0, 1.0), (2.0, 3.0))
    assert MinutesTo.of(RUNS, 0.5).latest == 2.0


def test_a_seed_that_missed_the_rate_sorts_last() -> None:
    found = MinutesTo.of(RUNS, 0.9)

    assert found == crossings((1.0, 2.0), (2.0, 3.0), (3.0, math.inf))
    assert (found.earliest, found.latest, found.known) == (3.0, 3.0, True)
    assert formatting.minutes_to(found) == "**3.0** (2.0, 3.0, not in 3.0)"


def test_an_unknown_median_is_bounded_by_the_last_evaluations() -> None:
    found = MinutesTo.of([RUNS[0], run((4.0, 0.1)), run((5.0, 0.1))], 0.9)

    assert not found.known
    assert found.earliest == 4.0, "lower bound of the median of 2, 4 or more, 5 or more"
    assert formatting.minutes_to(found) == "**not in 4.0** (2.0, not in 4.0, not in 5.0)"
    assert formatting.minutes_to(MinutesTo.of([run((0.25, 0.0))], 0.9)) == "**not in 0.25**"
    assert formatting.minutes_to(MinutesTo.of([run((1.96, 0.0))], 0.9)) == "**not in 1.9**", (
        "no more"
    )


def test_a_seed_with_few_evaluations_may_be_the_fastest() -> None:
    found = MinutesTo.of([run((3.2, 1.0)), run((2.4, 1.0)), run((1.6, 0.5))], 0.9)

    assert (found.earliest, found.latest, found.known) == (2.4, 3.2, False)
    assert formatting.minutes_to(found) == "**2.4 to 3.2** (3.2, 2.4, not in 1.6)"


@pytest.mark.parametrize(
    ("baseline", "other", "said"),
    [
        ((400.0, 420.0), (2.0, 2.4), "175 (166 to 210)"),
        ((2.9, 3.0), (1.9, 2.0), "1.5 (1.4 to 1.6)"),
        ((27.0, 54.0), (2.0, 2.4), "22 (11 to 27)"),
        ((27.0, 54.0), (0.0, 2.0), "27 (> 13)"),  # at its first evaluation
        ((0.0, 3.0), (1.0, 2.0), "1.5 (< 3.0)"),
        ((0.0, 3.0), (0.0, 2.0), "-"),
        ((100.0, math.inf), (1.0, 2.0), "> 50"),
        ((19.6, math.inf), (0.5, 1.0), "> 19"),  # rounded down: a lower bound
        ((2.0, 3.0), (100.0, math.inf), "< 0.030"),
        ((2.0, 3.1), (100.0, math.inf), "< 0.031"),
        ((100.0, math.inf), (100.0, math.inf), "-"),
        ((100.0, math.inf), (150.0, 200.0), "-"),  # it may be faster or slower
        ((250.0, 300.0), (100.0, math.inf), "-"),
    ],
)
def test_ratios(baseline: tuple[float, float], other: tuple[float, float], said: str) -> None:
    assert formatting.ratio(ratio(crossings(baseline), crossings(other))) == said


def test_a_ratio_with_an_uncertain_baseline_is_a_range() -> None:
    """The median of 100, 10 and something above 1."""
    baseline = crossings((90.0, 100.0), (9.0, 10.0), (1.0, math.inf))

    assert ratio(baseline, crossings((4.0, 5.0))) == Ratio(None, 9.0 / 5.0, 100.0 / 4.0)


@given(
    st.lists(
        st.tuples(st.floats(0.1, 100.0), st.floats(0.1, 100.0), st.booleans()),
        min_size=1,
        max_size=7,
    ),
    st.lists(st.tuples(st.floats(0.1, 100.0), st.floats(0.1, 100.0)), min_size=1, max_size=7),
)
def test_the_true_ratio_is_within_its_bounds(
    slow: list[tuple[float, float, bool]], fast: list[tuple[float, float]]
) -> None:
    """Crossings lie anywhere between two evaluations, or after the last."""
    seen = [
        Crossing(max(0.0, at - step), math.inf if lost else at + step) for at, step, lost in slow
    ]
    others = [Crossing(max(0.0, at - step), at + step) for at, step in fast]

    found = ratio(MinutesTo(tuple(seen)), MinutesTo(tuple(others)))

    true = statistics.median(at for at, *_ in slow) / statistics.median(at for at, _ in fast)
    if found is not None:
        assert found.low <= true * (1 + 1e-9)
        assert true <= found.high * (1 + 1e-9)


def test_a_curve_keeps_finished_rates_and_ends_with_an_unfinished_run() -> None:
    stopped = run((1.0, 0.0), (2.0, 1.0))
    others = [run((1.5, 0.2), (3.0, 0.4), (4.0, 0.8)), run((1.0, 0.4), (3.0, 0.6), ended=False)]

    curve = success_curve([stopped, *others])

    # From the latest first evaluation to the last one of the unfinished run.
    assert curve.minutes.tolist() == [1.5, 2.0, 3.0]
    scores = np.array([[0.0, 1.0, 1.0], [0.2, 0.2, 0.4], [0.4, 0.4, 0.6]])
    np.testing.assert_allclose(curve.iqm, scores.mean(axis=0))  # three scores: nothing is trimmed
    assert (curve.low <= curve.iqm).all()
    assert (curve.iqm <= curve.high).all()
    np.testing.assert_allclose(curve.low[0], 0.0)
    np.testing.assert_allclose(curve.high[0], 0.4)


def test_the_interquartile_mean_leaves_out_a_quarter_on_either_side() -> None:
    by_hand = (0.2 + 0.6 + 0.7 + 0.8) / 4

    assert estimate([1.0, 0.1, 0.2, 0.6, 0.7, 0.8, 0.9, 0.0], kind="iqm").value == (
        pytest.approx(by_hand)
    )
    # Over tasks: of all scores together.
    over_tasks = estimate([1.0, 0.1, 0.2, 0.6], [0.7, 0.8, 0.9, 0.0], kind="iqm")
    assert over_tasks.value == pytest.approx(by_hand)


def test_over_tasks_seeds_are_resampled_within_each() -> None:
    # In every sample half of the scores are of either task.
    found = estimate([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], kind="mean")

    assert (found.value, found.low, found.high) == (0.5, 0.5, 0.5)


def test_the_interval_of_two_seeds_has_them_as_ends() -> None:
    # One in four draws takes the same seed twice, on either side: the percentiles are the ends.
    found = estimate([0.4, 0.8], kind="mean")

    assert (found.value, found.low, found.high) == pytest.approx((0.6, 0.4, 0.8))
    assert formatting.estimate(found) == "60 % (40 to 80)"


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
    assert formatting.estimate(found) == "40 %"


def test_a_run_without_evaluations_has_no_curve() -> None:
    assert success_curve([run()]).minutes.size == 0
