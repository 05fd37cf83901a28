"""A reset in which a person may have to help."""

from __future__ import annotations

from collections.abc import Callable

from drivers import HandsNotClear, ResetOutcome, ResetRequest, ResetResult, RobotDriver

AskHuman = Callable[[str], None]
"""Called with what a person has to do; returns when it is done and hands are clear."""

ASKED_BEFORE = "a person was asked for a hand before, and nobody has said that it is done"


def reset_with_help(
    driver: RobotDriver, request: ResetRequest, ask_human: AskHuman | None
) -> ResetResult:
    """Reset a robot, and ask a person for a hand where it needs one.

    Args:
        driver: The robot, disarmed.
        request: Where things should be.
        ask_human: Asks a person; None where nobody is there.

    Returns:
        Done, failed, or that it needs a person and none is there.

    Raises:
        HandsNotClear: A person was asked for before, by this process or another, and nobody is
            there to say that hands are clear.
        DriverError: The robot is stopped or lost.
    """
    while True:
        try:
            result = driver.reset(request)
        except HandsNotClear:
            if ask_human is None:
                raise
            message = ASKED_BEFORE
        else:
            if result.outcome is not ResetOutcome.NEEDS_HUMAN or ask_human is None:
                return result
            message = result.message
        ask_human(message)
        driver.confirm_hands_clear()
