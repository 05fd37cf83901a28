"""Robot time spent by account, and grants of more: the application of ``iher-robot budget``."""

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
from iher_robot.storage.ledger import Ledger
from iher_robot.storage.robot_time import RobotTime


@dataclass(frozen=True)
class Spending:
    """Robot time by account.

    Attributes:
        owner: The run or robot.
        spent: Time spent on each account.
        budget: Time of motion that may be spent in all; None for a robot, which has no budget.
        granted: The part of the budget that was granted after the run began.
    """

    owner: str
    spent: Mapping[Account, RobotTime]
    budget: RobotTime | None = None
    granted: RobotTime | None = None

    @property
    def left(self) -> RobotTime | None:
        """Time of motion that is left, None without a budget."""
        return None if self.budget is None else self.budget.minus(self.spent["motion"])


def spending_of_run(path: Path) -> Spending:
    """Robot time of a run, even while it is in progress.

    Args:
        path: The run's folder.

    Raises:
        UserError: There is no run, it has not begun, or it is damaged.
    """
    with RunData(path) as run:
        first = _first_budget(run)
        accounts = read_accounts(run.directory.ledger_path)
        granted = first.with_ticks(accounts.granted_ticks)
        return Spending(
            owner=f"run {path}",
            spent={account: first.with_ticks(ticks) for account, ticks in accounts.spent.items()},
            budget=first + granted,
            granted=granted,
        )


def spending_of_robot(robot: ChosenRobot) -> Spending:
    """Robot time of a served robot over all runs and learners, as its host counts it.

    The account ``motion`` holds every armed tick, evaluation and deployment included.

    Args:
        robot: The robot.

    Raises:
        UserError: The robot has no host.
        DriverError: The host does not answer.
    """
    with RobotClient(link_of(robot)) as client:
        status = read_status(client, client.options.timeout_s)
    spent = {
        account: RobotTime(status.total_ticks.get(account, 0), status.control_period_s)
        for account in ACCOUNTS
    }
    return Spending(f"robot {status.robot}", spent)


def grant(path: Path, minutes: float) -> Spending:
    """Grant a run more robot minutes, for ``iher-robot train --resume``.

    Args:
        path: The run's folder.
        minutes: Robot minutes of motion.

    Returns:
        The run's robot time afterwards.

    Raises:
        UserError: There is no run, it has not begun or is in progress, or the minutes are shorter
            than a control tick.
    """
    with RunData(path) as run:
        more = RobotTime.from_minutes(minutes, _first_budget(run).control_period_s)
        read_accounts(run.directory.ledger_path)  # `Ledger` would create a missing one
        with Ledger(run.directory.ledger_path) as ledger:
            ledger.grant(more.ticks)
    return spending_of_run(path)


def _first_budget(run: RunData) -> RobotTime:
    run.directory.check_config()
    if run.robot is None:
        raise UserError(
            f"{run.path} has not begun, so it has no robot time yet; start it with iher-robot "
            "train --resume"
        )
    return RobotTime.from_minutes(run.config.budget_minutes, run.robot.control_period_s)
