"""Commands: what is taken, what is refused and counted, what is an error."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np

from drivers import Command, InvalidCommand, Mode, Refusal, RobotDriver, RobotSpec
from drivers.testing.suite import ContractSuite, must_raise

_TICKS = 5
_LEAST_SHARE = 0.2
"""Of what was asked: inertia and lag cost some of the way."""


@dataclasses.dataclass(frozen=True, eq=False)
class UnknownCommand(Command):
    """A command of a kind that no robot declares."""

    kind: ClassVar[str] = "unknown to every robot"

    def check(self, spec: RobotSpec) -> None:
        """Refuse nothing: the kind alone is wrong."""


def assert_equal_commands(applied: Command, asked: Command) -> None:
    """Demand that what was applied is what was asked, since no limit was in the way."""
    assert type(applied) is type(asked)
    for field in dataclasses.fields(asked):
        np.testing.assert_allclose(
            getattr(applied, field.name),
            getattr(asked, field.name),
            rtol=0.0,
            atol=1e-9,
            err_msg=f"{field.name} of a command within the limits must be applied as asked",
        )


class CommandTests(ContractSuite):
    """`command` hands over a target; what was applied arrives in the next state."""

    def test_a_command_moves_and_is_reported_in_the_next_state(
        self, driver: RobotDriver, kind: str
    ) -> None:
        state, samples = self.start(driver), self.samples(driver, kind)
        first, asked, prompt = state, 0.0, 0
        for _ in range(_TICKS):
            command = samples.small(state)
            asked += samples.asked(state, command)
            assert driver.command(command).accepted
            driver.advance()
            state = driver.read()
            applied = self.applied_at_once(state)
            if applied is None:
                continue
            prompt += 1
            assert state.mode is Mode.MOVING, "a tick with an accepted command is a moving one"
            assert not applied.clipped, f"no limit is in the way, clipped: {applied.clipped}"
            assert_equal_commands(applied.command, command)
        assert prompt > _TICKS / 2, (
            "a command is applied in the tick after the state that it answers"
        )
        if prompt == _TICKS:
            assert driver.clips == {}, "a command within the limits counts no clip"
        moved = samples.moved(first, state)
        assert moved * np.sign(asked) > _LEAST_SHARE * abs(asked), (
            f"the robot must go where it is told: asked for {asked:.4f}, went {moved:.4f}"
        )

    def test_the_last_command_of_a_tick_counts(self, driver: RobotDriver, kind: str) -> None:
        state, samples = self.start(driver), self.samples(driver, kind)
        last = samples.small(state, sign=-1.0)
        driver.command(samples.small(state))
        driver.command(last)
        applied = self.hold(driver, 1).applied
        assert applied is not None
        assert_equal_commands(applied.command, last)

    def test_a_command_counts_for_one_tick(self, driver: RobotDriver, kind: str) -> None:
        self.start(driver)
        moved = self.tick(driver, self.samples(driver, kind))
        after = self.hold(driver, 2)
        assert moved.applied is not None
        assert after.applied is not None
        assert after.applied.tick == moved.applied.tick, (
            "a command is applied in one tick, not again"
        )

    def test_a_command_expires_with_the_state_that_it_answers(
        self, driver: RobotDriver, kind: str
    ) -> None:
        old, samples = self.start(driver), self.samples(driver, kind)
        stale = samples.small(old)
        period_ns = driver.spec.control_period_ns
        watchdog_ns = driver.spec.limits.watchdog_s * 1e9
        # Reads are spread: of the states that were read, a robot remembers the newest 64.
        stride = max(1, int(watchdog_ns / period_ns / 16))
        new = old
        while new.stamp_ns - old.stamp_ns <= watchdog_ns:
            # A period of room: in real time some passes before the robot judges the command.
            if new.stamp_ns - old.stamp_ns <= watchdog_ns - period_ns:
                taken = driver.command(stale)
                assert taken.accepted, f"a command expires only after the watchdog, got {taken}"
            new = self.hold(driver, stride)
        assert driver.command(stale).refusal is Refusal.EXPIRED, (
            "a command expires by the age of the state that it answers"
        )
        assert driver.command(samples.small(new)).accepted

    def test_only_states_read_since_the_reset_can_be_answered(
        self, driver: RobotDriver, kind: str
    ) -> None:
        old, samples = self.start(driver), self.samples(driver, kind)
        driver.disarm()
        self.reset(driver)
        driver.arm()
        new = driver.read()
        assert driver.command(samples.small(old)).refusal is Refusal.UNKNOWN_STATE, (
            "a state from before a reset cannot be answered"
        )
        ahead = dataclasses.replace(samples.small(new), answers=new.seq + 1000)
        assert driver.command(ahead).refusal is Refusal.UNKNOWN_STATE, (
            "a state that was never read cannot be answered"
        )
        driver.advance()
        assert driver.read().applied is None, "a refused command moves nothing"

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
        }, "refusals are counted by reason, accepted commands are not"

    def test_what_cannot_be_carried_out_is_an_error_and_moves_nothing(
        self, driver: RobotDriver, kind: str
    ) -> None:
        state = self.start(driver)
        for wrong, command in self.samples(driver, kind).broken(state):
            must_raise(InvalidCommand, lambda c=command: driver.command(c), f"{kind}: {wrong}")  # type: ignore[misc]
        self._assert_nothing_was_taken(driver)

    def test_kinds_that_are_not_declared_are_errors(self, driver: RobotDriver) -> None:
        state = self.start(driver)
        unknown = UnknownCommand(state.seq)
        must_raise(InvalidCommand, lambda: driver.command(unknown), "a command of no known kind")
        self._assert_nothing_was_taken(driver)

    def _assert_nothing_was_taken(self, driver: RobotDriver) -> None:
        assert driver.refusals == {}, "a command that is an error is no refusal"
        driver.advance()
        after = driver.read()
        assert (after.applied, after.mode) == (None, Mode.HELD), "an error moves nothing"
        self.hold(driver, self.settling_ticks)
        self.assert_at_rest(driver, "an error moves nothing")
