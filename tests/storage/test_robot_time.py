"""Robot time: conversions round the safe way, and differences never fall below zero."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from iher_robot.errors import UserError
from iher_robot.storage.robot_time import RobotTime

PERIODS_S = st.integers(1, 10_000).map(lambda tenths_ms: tenths_ms / 10_000)
TICKS = st.integers(0, 10**7)


@pytest.mark.parametrize(
    ("minutes", "period", "ticks"),
    [
        (40, 0.04, 60_000),
        (40.0, 20 * 0.002, 60_000),
        (0.1, 0.04, 150),
        (0.7, 0.04, 1050),
        (1.1, 0.04, 1650),
        (1.0, 3 * 0.1, 200),  # 0.30000000000000004
        (0.035, 0.04, 52),  # 52.5
        (1e6, 0.001, 60_000_000_000),
    ],
)
def test_minutes_in_ticks(minutes: float, period: float, ticks: int) -> None:
    assert RobotTime.from_minutes(minutes, period).ticks == ticks


@given(tenths_ms=st.integers(1, 10_000), thousandths=st.integers(1, 10_000_000))
def test_ticks_fit_into_the_minutes_and_one_more_would_not(
    tenths_ms: int, thousandths: int
) -> None:
    period, minutes = Fraction(tenths_ms, 10_000), Fraction(thousandths, 1000)
    whole = math.floor(minutes * 60 / period)
    if whole:
        assert RobotTime.from_minutes(float(minutes), float(period)).ticks == whole


@pytest.mark.parametrize("minutes", [0.0, -1.0, math.nan, math.inf, 1e-9])
def test_a_budget_must_hold_a_tick(minutes: float) -> None:
    with pytest.raises(UserError, match=f"budget is {minutes}"):
        RobotTime.from_minutes(minutes, 0.04)


@given(ns=st.integers(0, 10**15), period_s=PERIODS_S)
def test_ticks_cover_a_duration_and_one_less_would_not(ns: int, period_s: float) -> None:
    period_ns = round(period_s * 1e9)
    ticks = RobotTime.from_ns(ns, period_s).ticks
    assert (ticks - 1) * period_ns < ns <= ticks * period_ns


@given(ticks=TICKS, period_s=PERIODS_S)
def test_seconds_and_minutes_come_back_as_the_same_ticks(ticks: int, period_s: float) -> None:
    time = RobotTime(ticks, period_s)
    assert RobotTime.from_seconds(time.seconds, period_s) == time
    assert time.minutes == pytest.approx(time.seconds / 60.0)
    assert time.minutes == ticks * period_s / 60.0, "bit for bit what metrics have always held"


@given(one=TICKS, other=TICKS, period_s=PERIODS_S)
def test_sums_and_differences_count_ticks(one: int, other: int, period_s: float) -> None:
    first, second = RobotTime(one, period_s), RobotTime(other, period_s)
    assert (first + second).ticks == one + other
    assert (first + second).minus(second) == first
    assert first.minus(first + second).ticks == 0


def test_times_of_robots_with_different_periods_do_not_mix() -> None:
    for combine in (RobotTime.__add__, RobotTime.minus):
        with pytest.raises(ValueError, match=r"control periods differ: 0\.04 s and 0\.02 s"):
            combine(RobotTime(1, 0.04), RobotTime(1, 0.02))


@pytest.mark.parametrize(
    ("ticks", "period_s"), [(-1, 0.04), (1, 0.0), (1, -0.04), (1, math.nan), (1, math.inf)]
)
def test_a_time_is_not_negative_and_a_tick_has_a_length(ticks: int, period_s: float) -> None:
    with pytest.raises(ValueError, match="must be"):
        RobotTime(ticks, period_s)


def test_it_prints_as_robot_minutes() -> None:
    assert str(RobotTime(1500, 0.04)) == "1.00 robot minutes"
