"""Numbers of an experiment as they stand in its report."""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterable

from iher_robot.experiments.numbers import Estimate, MinutesTo

UNKNOWN = "-"


def minutes(value: float) -> str:
    """Robot minutes with the digits that count."""
    if value >= 100:
        return f"{value:.0f}"
    return f"{value:.{1 if value >= 1.0 else 2}f}"


def minutes_to(found: MinutesTo) -> str:
    """Median, and each seed's."""
    each = [
        _not_in(seen) if math.isinf(value) else minutes(value)
        for value, seen in zip(found.seeds, found.seen, strict=True)
    ]
    median = _not_in(found.censored_at) if math.isinf(found.median) else minutes(found.median)
    return f"**{median}**" + (f" ({', '.join(each)})" if len(each) > 1 else "")


def _not_in(seen: float) -> str:
    return f"not in {minutes(seen)}"


def ratio(found: tuple[str, float] | None) -> str:
    """A ratio, or the bound that is known of it."""
    if found is None:
        return UNKNOWN
    sign, value = found
    digits = f"{value:.0f}" if value >= 20 else f"{value:.2g}"
    return digits if sign == "=" else f"{sign} {digits}"


def percent(value: float) -> str:
    """A rate without its sign."""
    return f"{100 * value:.0f}"


def percents(values: Iterable[float]) -> str:
    """Rates without their signs."""
    return ", ".join(map(percent, values))


def estimate(found: Estimate) -> str:
    """A rate with its interval."""
    if math.isnan(found.low):
        return f"{percent(found.value)} %"
    return f"{percent(found.value)} % ({percent(found.low)} to {percent(found.high)})"


def duration(seconds: float) -> str:
    """Wall-clock time."""
    return str(datetime.timedelta(seconds=round(seconds)))


def in_table(text: object) -> str:
    """Text that does not end a cell of a Markdown table."""
    return str(text).replace("|", "\\|").replace("\n", " ")


def as_code(text: str) -> str:
    """Code in a cell of a Markdown table."""
    return f"`{in_table(text)}`" if text else ""
