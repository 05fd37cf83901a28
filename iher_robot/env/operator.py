"""Operator at the terminal: confirms, labels and helps; and the reset that a person assists."""

from __future__ import annotations

import sys
from collections.abc import Callable

from drivers import HandsNotClear, ResetOutcome, ResetRequest, ResetResult, RobotDriver
from iher_robot.errors import UserError

PENDING_HELP = "help was requested earlier and has not been confirmed as done"

_YES, _NO = ("y", "yes"), ("n", "no")

Ask = Callable[[str], str]
"""Shows a question and returns the line typed; raises EOFError where the input ends."""

AskHuman = Callable[[str], None]
"""Called with what a person has to do; returns when it is done and hands are clear."""


class Operator:
    """The operator at the terminal, who may be absent.

    Args:
        ask: Asks a question; the terminal by default.

    Attributes:
        present: Whether there is an operator to ask.
    """

    def __init__(self, ask: Ask | None = None) -> None:
        self._ask: Ask = input if ask is None else ask
        self.present = ask is not None or (sys.stdin is not None and sys.stdin.isatty())

    def confirms(self, question: str) -> bool:
        """Ask for confirmation; anything but a yes is a no."""
        try:
            return self._ask(f"{question} [y/N] ").strip().lower() in _YES
        except EOFError:
            return False

    def label(self, task_success: bool) -> bool | None:
        """Ask whether an episode succeeded.

        Args:
            task_success: The task's result, which an empty answer accepts.

        Returns:
            The operator's label; None to keep the task's result.
        """
        question = f"did it succeed? [y/n, Enter for {'yes' if task_success else 'no'}] "
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
        """Ask for help with a reset, and wait until it is done.

        Args:
            message: What the robot needs.

        Raises:
            UserError: The input ended without a confirmation that hands are clear.
        """
        try:
            self._ask(f"{message}; press Enter when it is done and hands are clear ")
        except EOFError:
            raise UserError(
                f"no answer to {message!r}; run it in a terminal, the robot needs help"
            ) from None


def reset_with_help(
    driver: RobotDriver, request: ResetRequest, ask_human: AskHuman | None
) -> ResetResult:
    """Reset a robot, and ask a person for help where it needs one.

    Args:
        driver: The robot, disarmed.
        request: Requested positions.
        ask_human: Asks a person; None where none is present.

    Returns:
        Done, failed, or needs a person and none is present.

    Raises:
        HandsNotClear: Help was requested before, by this process or another, and no person is
            present to confirm that hands are clear.
        DriverError: The robot is stopped or lost.
    """
    while True:
        try:
            result = driver.reset(request)
        except HandsNotClear:
            if ask_human is None:
                raise
            message = PENDING_HELP
        else:
            if result.outcome is not ResetOutcome.NEEDS_HUMAN or ask_human is None:
                return result
            message = result.message
        ask_human(message)
        driver.confirm_hands_clear()
