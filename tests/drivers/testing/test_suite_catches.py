"""The conformance suite fails for drivers that break the contract, and names the requirement."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable

import pytest

from drivers import RobotDriver
from iher_robot.testing import DriverContract
from tests.drivers.testing import bad_gantries as gantries
from tests.drivers.testing import bad_robots as bad


def suite_of(make: Callable[[], RobotDriver], *, in_real_time: bool) -> DriverContract:
    class Suite(DriverContract):
        real_time = in_real_time

        def make_driver(self) -> RobotDriver:
            return make()

    return Suite()


def run_test(
    make: Callable[[], RobotDriver], name: str, *, real_time: bool = False, **parameters: str
) -> None:
    """Run one test of the suite as pytest would."""
    driver, other_driver = make(), make()
    parameters["kind"] = driver.spec.command_kinds[0]
    given = {"driver": driver, "other_driver": other_driver, **parameters}
    test = getattr(suite_of(make, in_real_time=real_time), name)
    test(**{name: given[name] for name in inspect.signature(test).parameters})


@pytest.mark.parametrize(
    ("robot", "test", "requirement"),
    [
        (bad.AppliesAfterDisarm, "disarming_drops_an_accepted_command", "not be applied after"),
        (bad.AppliesAfterDisarm, "a_stop_latches_until_it_is_cleared_by_name", "not be applied"),
        (
            bad.RepeatsItsLastCommand,
            "a_tick_without_a_command_is_held",
            "accepted command must be held",
        ),
        (bad.RepeatsItsLastCommand, "a_command_counts_for_one_tick", "in one tick, not again"),
        (bad.DriftsWhileHeld, "arming_moves_nothing", "held until its first command"),
        (
            bad.DriftsWhileHeld,
            "a_stop_in_motion_brings_the_robot_to_rest",
            "stopped robot must be held",
        ),
        (bad.CountsTicksTwice, "every_tick_counts_one", "rise by 1 per tick, it rose by .2"),
        (bad.StampsEveryOtherTick, "every_tick_lasts_a_control_period", "of 40000000 ns, they"),
        (bad.StopsAtTheNextTick, "a_stop_from_another_thread_ends_motion", "when stop returns"),
        (
            bad.ForgetsItsStop,
            "a_latched_stop_survives_close_and_open",
            "must survive close and open",
        ),
        (
            bad.KeepsTheLatestStop,
            "a_stop_latches_until_it_is_cleared_by_name",
            "the first stop must be kept",
        ),
        (
            bad.ArmsWhenCleared,
            "a_stop_latches_until_it_is_cleared_by_name",
            "clear_fault must not arm",
        ),
        (
            bad.ReportsWhatWasAsked,
            "excessive_commands_stay_within_every_limit_and_are_reported",
            "`applied.clipped` must say why",
        ),
        (
            bad.SaysNotWhyItClips,
            "excessive_commands_stay_within_every_limit_and_are_reported",
            "`applied.clipped` must say why",
        ),
        (
            bad.OvershootsItsCommands,
            "excessive_commands_stay_within_every_limit_and_are_reported",
            "end effector moves at .* m/s",
        ),
        (bad.NeverExpires, "a_command_expires_with_the_state_that_it_answers", "by the age of the"),
        (bad.AnswersAnyState, "only_states_read_since_the_reset_can_be_answered", "before a reset"),
        (bad.RefusesWithoutCounting, "every_refusal_is_counted_by_its_reason", "counted by reason"),
        (
            bad.TakesNumbersThatAreNone,
            "invalid_commands_are_errors_and_move_nothing",
            "must raise InvalidCommand",
        ),
        (bad.GivesWritableArrays, "states_cannot_be_written_to", "state.ee_pos must be read-only"),
        (bad.SharesItsBuffer, "states_stay_as_they_were_read", "ee_pos must not change with later"),
        (bad.MeasuresInMillimetres, "velocities_fit_the_positions", "velocity of ee_pos, in m/s"),
        (bad.HasOneFinger, "states_have_the_shapes_that_the_spec_names", r"fingers_pos must .*2,"),
        (
            bad.TurnsWithLongQuaternions,
            "states_have_the_shapes_that_the_spec_names",
            "ee_quat must have length 1",
        ),
        (bad.LosesItsObject, "objects_come_from_the_declared_sources", "the objects of the spec"),
        (bad.IsAlwaysMoving, "the_mode_says_what_the_robot_does", "must be held, is moving"),
        (bad.StaysOpen, "a_context_ends_held_and_disarmed_when_its_body_raises", "closed"),
        (
            bad.PlacesWhatItHasNot,
            "impossible_requests_are_errors_and_move_nothing",
            "object0 at nan must raise",
        ),
        (bad.NeverGoesHome, "a_reset_brings_the_robot_home", "at the home of the spec"),
        (bad.LeavesTheObjectWhereItIs, "a_reset_places_the_objects", "object0 must be at"),
        (
            bad.RemembersTheLastEpisode,
            "a_reset_brings_the_robot_home",
            "must be None after a reset",
        ),
        (bad.IsAnotherEachTime, "equal_robots_have_equal_digests", "gains.kp"),
        (
            bad.SharesItsPosition,
            "two_drivers_are_independent",
            "must not move another driver's robot",
        ),
        (
            gantries.StandsStill,
            "a_command_moves_and_is_reported_in_the_next_state",
            "must move as commanded",
        ),
        (
            gantries.GoesTheOtherWay,
            "a_command_moves_and_is_reported_in_the_next_state",
            "must move as commanded",
        ),
        (
            gantries.MovesSlower,
            "a_command_moves_and_is_reported_in_the_next_state",
            "dq of a command within the limits",
        ),
        (
            gantries.StandsElsewhere,
            "the_kinematic_model_is_that_of_the_robot",
            "must give the position of the end",
        ),
        (gantries.HidesItsSetpoint, "the_setpoint_never_jumps", "in every state"),
        (gantries.StopsDead, "the_setpoint_never_jumps", "velocity jumps by .* at disarm"),
        (gantries.CoastsWhileHeld, "a_tick_without_a_command_is_held", "bring the robot to rest"),
        (
            gantries.CoastsWhileHeld,
            "disarming_in_motion_brings_the_robot_to_rest",
            "robot must be held",
        ),
        (
            gantries.IgnoresTheFilter,
            "excessive_commands_stay_within_every_limit_and_are_reported",
            "q_target applied to x is",
        ),
        (
            gantries.OvershootsItsSetpoint,
            "excessive_commands_stay_within_every_limit_and_are_reported",
            "joint . moves at",
        ),
        (gantries.SwapsTwoMotors, "each_joint_goes_where_its_setpoint_is", "where its setpoint is"),
        (
            gantries.MeasuresNoSpeed,
            "each_joint_goes_where_its_setpoint_is",
            "add up to its displacement",
        ),
        (
            gantries.OpensItsFingersWhenHeld,
            "fingers_reach_their_targets_and_stay",
            "a held tick must not move the finger",
        ),
        (gantries.TakesTheFirstCommandOfATick, "the_last_command_of_a_tick_counts", "q_target"),
        (gantries.CarriesOutOneAfterTheOther, "the_last_command_of_a_tick_counts", "q_target"),
    ],
)
def test_a_robot_that_breaks_the_contract_fails_at_the_test_that_names_it(
    robot: Callable[[], RobotDriver], test: str, requirement: str
) -> None:
    with pytest.raises(AssertionError) as failure:
        run_test(robot, f"test_{test}")
    assert re.search(requirement, str(failure.value)), failure.value


def test_every_call_is_tried_in_every_situation() -> None:
    name = "test_each_call_is_allowed_exactly_where_the_lifecycle_says"
    with pytest.raises(AssertionError, match="reset on a driver that is armed must raise"):
        run_test(bad.ResetsWhileArmed, name, situation="armed", call="reset")


def test_a_robot_in_real_time_may_be_late_but_never_early() -> None:
    with pytest.raises(AssertionError, match="stamps must rise by the control period"):
        run_test(bad.NeverWaits, "test_every_tick_lasts_a_control_period", real_time=True)


def test_a_robot_in_real_time_may_miss_a_tick_but_not_every_one() -> None:
    name = "test_a_command_moves_and_is_reported_in_the_next_state"
    with pytest.raises(AssertionError, match="applied in the tick after the state that it answers"):
        run_test(bad.AlwaysMissesATick, name, real_time=True)
