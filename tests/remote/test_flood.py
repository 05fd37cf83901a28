"""100,000 messages that must be refused, while a client moves the robot."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

from drivers.remote.messages import Empty
from tests.remote.hostile import ANY
from tests.remote.limits import assert_within_limits
from tests.remote.observer import Observer
from tests.remote.served import ServedRobot

COUNT = 100_000
ROOT = Path(__file__).parents[2]


def test_a_flood_is_refused_and_counted_while_valid_commands_move_the_robot(tmp_path: Path) -> None:
    with ServedRobot(tmp_path) as served:
        mover = subprocess.Popen(
            [sys.executable, "-m", "tests.remote.mover", served.endpoint, "never"],
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        try:
            assert mover.stdout is not None
            while int(mover.stdout.readline()) < 20:
                pass
            with Observer(served.endpoint) as observer:
                flood = subprocess.run(
                    [sys.executable, "-m", "tests.remote.flooder", served.endpoint, str(COUNT)],
                    capture_output=True,
                    text=True,
                    cwd=ROOT,
                    timeout=200.0,
                    check=False,
                )
                assert flood.returncode == 0, flood.stderr
                seen = list(observer.seen)
                status = observer.client.request("status", Empty(), 10.0).result
        finally:
            mover.kill()
            mover.wait(10.0)
    sent, refused = Counter(json.loads(flood.stdout)), Counter(status["refusals"])
    assert_within_limits(seen, observer.spec)
    applied = sum(s.applied is not None and s.applied.tick == s.seq for s, _ in seen)
    assert sum(sent.values()) == COUNT
    by_chance = sent.pop(ANY, 0)
    assert sent <= refused, "each is counted under its reason"
    assert refused.total() - sent.total() == by_chance, "and none of them twice, or not at all"
    assert len(seen) > 100
    assert applied >= 0.8 * len(seen), "meanwhile valid commands move the robot"
    assert status["fault"] is None
