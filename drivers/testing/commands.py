"""Contract of `command`: which commands are accepted, refused and counted, or errors."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import ClassVar

import numpy as np

from drivers import Command, InvalidCommand, Mode, Refusal, RobotDriver, RobotSpec
from drivers.testing.suite import ContractSuite, must_raise

_TICKS = 5
_LEAST_SHARE = 0.2
"""Share of the requested displacement: inertia and lag cost some of it."""


@dataclasses.dataclass(frozen=True, eq=False)
class UnknownCommand(Command):
    """A command of a kind that no robot declares."""

    kind: ClassVar[str] = "unknown to every robot"

    def check(self, spec: RobotSpec) -> None:
        """Accept everything: only the kind is wrong."""


def assert_equal_commands(applied: Command, asked: Command) -> None:
    """Assert that a command within the limits was applied as requested."""
    assert type(applied) is type(asked), (
        f"a command must be applied as its own kind, {asked.kind}, not as {applied.kind}"
    )
    for field in dataclasses.fields(asked):
        np.testing.assert_allclose(
            getattr(applied, field.name),
            getattr(asked, field.name),
            rtol=0.0,
            atol=1e-9,
            err_msg=f"{field.name} of a command within the limits must be applied as requested",
        )


class CommandTests(ContractSuite):
    """`command` sets the target of a tick; the next state reports what was applied."""

    def test_a_command_moves_and_is_reported_in_the_next_state(
        self, driver: RobotDriver, kind: str
    ) -> None:
        state, samples = self.start(driver), self.samples(driver, kind)
        first, asked, prompt = state, 0.0, 0
        for _ in range(_TICKS):
            command = samples.small(state)
            asked += samples.asked(state, command)
            self.accept(driver, command)
            driver.advance()
            state = driver.read()
            applied = self.applied_at_once(state)
            if applied is None:
                continue
            prompt += 1
            assert state.mode is Mode.MOVING, (
                f"the mode after a tick with an accepted command must be moving, is {state.mode}"
            )
            assert not applied.clipped, (
                f"a command within the limits must not be clipped, clipped: {applied.clipped}"
            )
            assert_equal_commands(applied.command, command)
        assert prompt > _TICKS / 2, (
            "a command must be applied in the tick after the state that it answers; it was in "
            f"{prompt} of {_TICKS} ticks"
        )
        if prompt == _TICKS:
            assert driver.clips == {}, (
                f"a command within the limits must count no clip, counted: {driver.clips}"
            )
        moved = samples.moved(first, state)
        assert moved * np.sign(asked) > _LEAST_SHARE * abs(asked), (
            "the robot must move as commanded: "
            f"the commands add up to {asked:.4f}, it moved by {moved:.4f} m or rad"
        )

    def test_the_last_command_of_a_tick_counts(self, driver: RobotDriver, kind: str) -> None:
        state, samples = self.start(driver), self.samples(driver, kind)
        last = samples.small(state, sign=-1.0)
        driver.command(samples.small(state))
        driver.command(last)
        applied = self.hold(driver, 1).applied
        assert applied is not None, "an accepted command must be reported as applied"
        assert_equal_commands(applied.command, last)

    def test_a_command_counts_for_one_tick(self, driver: RobotDriver, kind: str) -> None:
        self.start(driver)
        moved = self.tick(driver, self.samples(driver, kind))
        after = self.hold(driver, 2)
        assert moved.applied is not None, "an accepted command must be reported as applied"
        assert after.applied is not None, "`applied` must stay in the states after its tick"
        assert after.applied.tick == moved.applied.tick, (
            "a command must be applied in one tick, not again in the ticks after it"
        )

    def test_a_command_expires_with_the_state_that_it_answers(
        self, driver: RobotDriver, kind: str
    ) -> None:
        old, samples = self.start(driver), self.samples(driver, kind)
        stale = samples.small(old)
        period_ns = driver.spec.control_period_ns
        watchdog_ns = driver.spec.limits.watchdog_s * 1e9
        # Reads are spread out: a driver keeps the ages of the newest 64 states only.
        stride = max(1, int(watchdog_ns / period_ns / 16))
        new = old
        while new.stamp_ns - old.stamp_ns <= watchdog_ns:
            # A period of slack: in real time some time passes before the command is judged.
            if new.stamp_ns - old.stamp_ns <= watchdog_ns - period_ns:
                acceptance = driver.command(stale)
                assert acceptance.accepted, (
                    "a command must not expire before the state that it answers is older than "
                    f"`limits.watchdog_s`, got {acceptance}"
                )
            new = self.hold(driver, stride)
        acceptance = driver.command(stale)
        assert acceptance.refusal is Refusal.EXPIRED, (
            "a command must expire by the age of the state that it answers, after "
            f"`limits.watchdog_s`, got {acceptance}"
        )
        self.accept(driver, samples.small(new))

    def test_only_states_read_since_the_reset_can_be_answered(
        self, driver: RobotDriver, kind: str
    ) -> None:
        old, samples = self.start(driver), self.samples(driver, kind)
        driver.disarm()
        self.reset(driver)
        driver.arm()
        new = driver.read()
        acceptance = driver.command(samples.small(old))
        assert acceptance.refusal is Refusal.UNKNOWN_STATE, (
            f"an answer to a state from before a reset must be refused, got {acceptance}"
        )
        ahead = dataclasses.replace(samples.small(new), answers=new.seq + 1000)
        acceptance = driver.command(ahead)
        assert acceptance.refusal is Refusal.UNKNOWN_STATE, (
            f"an answer to a state that was never read must be refused, got {acceptance}"
        )
        driver.advance()
        assert driver.read().applied is None, "a refused command must not be applied"

    def test_every_refusal_is_counted_by_its_reason(self, driver: RobotDriver, kind: str) -> None:
        state, samples = self.start(driver), self.samples(driver, kind)
        unread = dataclasses.replace(samples.small(state), answers=state.seq + 1000)
        driver.command(unread)
        driver.command(unread)
        driver.disarm()
        driver.command(samples.small(state))
        driver.stop("the suite stops it")
        driver.command(samples.small(state))
        assert driver.refusals == {
            Refusal.UNKNOWN_STATE: 2,
            Refusal.DISARMED: 1,
            Refusal.LATCHED: 1,
        }, "`refusals` must be counted by reason, without accepted commands"

    def test_invalid_commands_are_errors_and_move_nothing(
        self, driver: RobotDriver, kind: str
    ) -> None:
        state = self.start(driver)
        for wrong, command in self.samples(driver, kind).broken(state):
            must_raise(
                InvalidCommand, partial(driver.command, command), f"{kind} command with {wrong}"
            )
        self._assert_nothing_applied(driver)

    def test_kinds_that_are_not_declared_are_errors(self, driver: RobotDriver) -> None:
        state = self.start(driver)
        unknown = UnknownCommand(state.seq)
        must_raise(InvalidCommand, lambda: driver.command(unknown), "a command of undeclared kind")
        self._assert_nothing_applied(driver)

    def _assert_nothing_applied(self, driver: RobotDriver) -> None:
        assert driver.refusals == {}, "a command that raises must not count as a refusal"
        driver.advance()
        after = driver.read()
        assert (after.applied, after.mode) == (None, Mode.HELD), (
            "a command that raises must not be applied"
        )
        self.hold(driver, self.settling_ticks)
        self.assert_at_rest(driver, "a command that raises must not move the robot")
