"""Formatting of the numbers and texts of a report."""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Callable, Iterable

from iher_robot.experiments.report.minutes_to_success import MinutesTo, Ratio
from iher_robot.experiments.report.statistics import Estimate

UNKNOWN = "-"
_MARKUP = re.compile(r"[\\`*\[\]<>|~&]|(?<!\w)_|_(?!\w)")


def minutes(value: float) -> str:
    """Robot minutes with their significant digits."""
    return f"{value:.{_decimals(value)}f}"


def span(ends: tuple[float, float]) -> str:
    """Range of robot minutes, or one number where both ends read the same."""
    return " to ".join(dict.fromkeys(map(minutes, ends)))


def minutes_to(found: MinutesTo) -> str:
    """Median, and the value of each seed."""
    each = [
        _not_in(seed.after) if math.isinf(seed.by) else minutes(seed.by) for seed in found.seeds
    ]
    if math.isinf(found.latest):
        median = _not_in(found.earliest)
    else:
        median = span((found.earliest, found.latest))
    return f"**{median}**" + (f" ({', '.join(each)})" if len(each) > 1 else "")


def _not_in(seen: float) -> str:
    return f"not in {_rounded(seen, _decimals(seen), math.floor)}"


def _decimals(value: float) -> int:
    return 0 if value >= 100.0 else 1 if value >= 1.0 else 2


def ratio(found: Ratio | None) -> str:
    """A ratio with its bounds, or a bound alone; bounds are rounded outwards."""
    if found is None:
        return UNKNOWN
    low = _rounded(found.low, _digits(found.low), math.floor) if found.low > 0.0 else ""
    high = _rounded(found.high, _digits(found.high), math.ceil) if math.isfinite(found.high) else ""
    bounds = f"{low} to {high}" if low and high else f"> {low}" if low else f"< {high}"
    if found.value is None:
        return bounds
    return f"{_rounded(found.value, _digits(found.value), round)} ({bounds})"


def _digits(value: float) -> int:
    """Decimals for two significant digits."""
    return max(0, 1 - math.floor(math.log10(value)))


def _rounded(value: float, decimals: int, how: Callable[[float], float]) -> str:
    # Rounded first: floating-point error must not move a bound.
    return f"{how(round(value * 10**decimals, 6)) / 10**decimals:.{decimals}f}"


def percent(value: float) -> str:
    """A rate in percent, without the sign."""
    return f"{100 * value:.0f}"


def percents(values: Iterable[float]) -> str:
    """Rates in percent, without the sign."""
    return ", ".join(map(percent, values))


def estimate(found: Estimate) -> str:
    """A rate with its interval."""
    if math.isnan(found.low):
        return f"{percent(found.value)} %"
    return f"{percent(found.value)} % ({percent(found.low)} to {percent(found.high)})"


def duration(seconds: float) -> str:
    """Wall-clock time."""
    return str(datetime.timedelta(seconds=round(seconds)))


def plain(text: object) -> str:
    """Text with Markdown's special characters escaped, for paragraphs and tables."""
    return _MARKUP.sub(r"\\\g<0>", " ".join(str(text).split()))


def as_code(text: str) -> str:
    """Text as code in a cell of a Markdown table."""
    text = " ".join(text.split()).replace("|", "\\|")
    longest = max(map(len, re.findall("`+", text)), default=0)
    fence = "`" * (longest + 1)
    padding = " " * (longest > 0)
    return f"{fence}{padding}{text}{padding}{fence}" if text else ""
