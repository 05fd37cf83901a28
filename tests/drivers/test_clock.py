from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import Clock, MonotonicClock, SimulatedClock


@given(st.lists(st.integers(min_value=0, max_value=10**12)))
def test_simulated_time_is_the_sum_of_its_advances(durations_ns: list[int]) -> None:
    clock = SimulatedClock(start_ns=7)
    for duration_ns in durations_ns:
        clock.advance_ns(duration_ns)
    assert clock.now_ns() == 7 + sum(durations_ns)


def test_simulated_time_jumps_ahead_and_never_back() -> None:
    clock = SimulatedClock()
    clock.sleep_until_ns(50)
    assert clock.now_ns() == 50
    clock.sleep_until_ns(20)
    assert clock.now_ns() == 50
    with pytest.raises(ValueError, match="-1, allowed: 0 or more"):
        clock.advance_ns(-1)


def test_the_machine_clock_has_passed_the_deadline_after_sleeping() -> None:
    clock: Clock = MonotonicClock()
    deadline_ns = clock.now_ns() + 2_000_000
    clock.sleep_until_ns(deadline_ns)
    assert clock.now_ns() >= deadline_ns
