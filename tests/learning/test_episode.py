"""Episodes: splitting at invalid ticks."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.learning.fakes import marked_episode


@settings(deadline=None)
@given(st.lists(st.booleans(), min_size=1, max_size=12))
def test_segments_hold_exactly_the_valid_ticks_and_span_no_other(valid: list[bool]) -> None:
    episode = replace(marked_episode(7, len(valid)), valid=np.array(valid))
    segments = episode.segments()
    ticks = [segment.actions[:, 1].astype(int).tolist() for segment in segments]
    assert list(chain.from_iterable(ticks)) == np.flatnonzero(valid).tolist()
    for segment, mine in zip(segments, ticks, strict=True):
        assert segment.valid.all()
        assert mine == list(range(mine[0], mine[0] + len(segment)))
        assert segment.observations[:, 1].astype(int).tolist() == [*mine, mine[-1] + 1]
        assert np.array_equal(segment.requested_actions, segment.actions)
        assert np.array_equal(segment.desired_goal, episode.desired_goal)
    for before, after in pairwise(ticks):
        assert after[0] > before[-1] + 1  # maximal runs: two valid neighbours are never parted


@pytest.mark.parametrize("name", ["observations", "requested_actions", "valid"])
def test_arrays_of_different_lengths_are_refused(name: str) -> None:
    episode = marked_episode(0, 5)
    with pytest.raises(ValueError, match="an episode of 5 actions has 6 observations"):
        replace(episode, **{name: getattr(episode, name)[:-1]})
