"""What robot time was spent, and more of it: the application behind ``iher-robot budget``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from drivers.remote.client import RobotClient
from drivers.remote.status import read_status
from iher_robot.config.robot import ChosenRobot
from iher_robot.config.robot_link import link_of
from iher_robot.datasets.run_reader import RunData
from iher_robot.errors import UserError
from iher_robot.storage.accounts import ACCOUNTS, Account, read_accounts
from iher_robot.storage.budget import Budget, budget_ticks
from iher_robot.storage.ledger import Ledger


@dataclass(frozen=True)
class Spending:
    """Robot time by account.

    Attributes:
        whose: A run or a robot, in words.
        control_period_s: Time of a control tick.
        spent_ticks: Ticks by account.
        budget_ticks: Ticks of motion that may be spent in all, None for a robot, which has no
            budget of its own.
        granted_ticks: Those among them that were granted after the run began.
    """

    whose: str
    control_period_s: float
    spent_ticks: Mapping[Account, int]
    budget_ticks: int | None = None
    granted_ticks: int = 0

    @property
    def left_ticks(self) -> int | None:
        """Ticks of motion that are left, None where there is no budget."""
        if self.budget_ticks is None:
            return None
        return max(0, self.budget_ticks - self.spent_ticks["motion"])

    def minutes(self, ticks: int) -> float:
        """Robot minutes of so many ticks."""
        return ticks * self.control_period_s / 60.0


def spending_of_run(path: Path) -> Spending:
    """What a run has spent, even while it goes on.

    Args:
        path: The run's folder.

    Raises:
        UserError: There is no run, it has not begun, or a part of it is damaged.
    """
    with RunData(path) as run:
        period_s = _control_period_s(run)
        accounts = read_accounts(run.directory.ledger_path)
        return Spending(
            whose=f"run {path}",
            control_period_s=period_s,
            spent_ticks=accounts.spent,
            budget_ticks=_first_ticks(run) + accounts.granted_ticks,
            granted_ticks=accounts.granted_ticks,
        )


def spending_of_robot(robot: ChosenRobot) -> Spending:
    """What a served robot has done over all runs and learners, as its host counts.

    Motion there is every tick in which it was armed, evaluation and deployment included.

    Args:
        robot: The robot.

    Raises:
        UserError: A robot without a host.
        DriverError: The host does not answer.
    """
    with RobotClient(link_of(robot)) as client:
        status = read_status(client, client.options.timeout_s)
    ticks = {account: status.total_ticks.get(account, 0) for account in ACCOUNTS}
    return Spending(f"robot {status.robot}", status.control_period_s, ticks)


def grant(path: Path, minutes: float) -> Spending:
    """Give a run more robot minutes; ``iher-robot train --resume`` spends them.

    Args:
        path: The run's folder.
        minutes: Robot minutes of motion.

    Returns:
        How the run stands then.

    Raises:
        UserError: There is no run, it has not begun or is under way, or the minutes hold no
            control tick.
    """
    with RunData(path) as run:
        ticks = budget_ticks(minutes, _control_period_s(run))
        read_accounts(run.directory.ledger_path)  # which does not make one that is missing
        with Ledger(run.directory.ledger_path) as ledger:
            ledger.grant(ticks)
            total = Budget(ledger, _first_ticks(run)).budget_ticks
            spent = {account: ledger.spent_ticks(account) for account in ACCOUNTS}
            return Spending(
                whose=f"run {path}",
                control_period_s=_control_period_s(run),
                spent_ticks=spent,
                budget_ticks=total,
                granted_ticks=ledger.granted_ticks,
            )


def _first_ticks(run: RunData) -> int:
    return budget_ticks(run.config.budget_minutes, _control_period_s(run))


def _control_period_s(run: RunData) -> float:
    run.directory.check_config()
    if run.robot is None:
        raise UserError(f"{run.path} has not begun: nothing is spent, and nothing can be granted")
    return run.robot.control_period_s
