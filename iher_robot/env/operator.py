"""The person who starts a deployment, helps the robot and judges its episodes."""

from __future__ import annotations

import sys
from collections.abc import Callable

from drivers import HandsNotClear, ResetOutcome, ResetRequest, ResetResult, RobotDriver
from iher_robot.errors import UserError

Ask = Callable[[str], str]
"""Shows a question and returns the line that was typed; raises EOFError where input ends."""

_YES, _NO = ("y", "yes"), ("n", "no")


class Operator:
    """Asks the person at the terminal, or goes without where there is none."""

    def __init__(self, ask: Ask | None = None) -> None:
        """Find out whether anybody is there.

        Args:
            ask: How to ask; the terminal by default.
        """
        self._ask: Ask = input if ask is None else ask
        self.present = ask is not None or (sys.stdin is not None and sys.stdin.isatty())

    def confirms(self, question: str) -> bool:
        """Ask whether to go on; anything but a yes is a no."""
        try:
            return self._ask(f"{question} [y/N] ").strip().lower() in _YES
        except EOFError:
            return False

    def label(self, judged: bool) -> bool | None:
        """Ask whether an episode succeeded.

        Args:
            judged: What the task says.

        Returns:
            The operator's judgement; None leaves it to the task.
        """
        question = f"did it succeed? [y/n, Enter for {'yes' if judged else 'no'}] "
        while True:
            try:
                answer = self._ask(question).strip().lower()
            except EOFError:
                return None
            if not answer:
                return None
            if answer in (*_YES, *_NO):
                return answer in _YES

    def help(self, message: str) -> None:
        """Ask for a hand at a reset, and wait until it is done.

        Args:
            message: What the robot needs.

        Raises:
            UserError: The input ended: nobody has confirmed that hands are clear.
        """
        try:
            self._ask(f"{message}; press Enter when it is done and hands are clear ")
        except EOFError:
            raise UserError(
                f"nobody answered to {message!r}; run it in a terminal, the robot needs a hand"
            ) from None


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
