"""Messages survive a round trip; bytes that are no message are refused."""

from __future__ import annotations

import dataclasses

import msgpack  # type: ignore[import-untyped]
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from drivers import (
    AppliedCommand,
    Command,
    EndEffectorCommand,
    InvalidSpec,
    JointCommand,
    Mode,
    make_driver,
)
from drivers.gate import Fault
from drivers.remote.driver import read_spec
from drivers.remote.keys import robot_key
from drivers.remote.messages import command_fields, unpack_command
from drivers.remote.state_message import HostInfo, pack_state, unpack_state
from drivers.wire import MAX_BYTES, WireError, pack, unpack_map
from tests.drivers.fake_robot import FakeRobot

INFO = HostInfo("boot", 3, 17, 5000, True, "because", Fault("f", "r", 7), {"expired": 2}, {})
finite = st.floats(allow_nan=False, width=64)


def _vector(size: int) -> st.SearchStrategy[np.ndarray]:
    return st.lists(finite, min_size=size, max_size=size).map(np.array)


commands = st.one_of(
    st.builds(EndEffectorCommand, st.integers(0, 2**62), _vector(3), _vector(2)),
    st.builds(
        JointCommand,
        st.integers(0, 2**62),
        _vector(8),
        _vector(8),
        st.floats(1e-6, 10.0),
        _vector(2),
    ),
)


def _same(first: object, second: object) -> None:
    assert type(first) is type(second)
    for field in dataclasses.fields(first):  # type: ignore[arg-type]
        mine, other = getattr(first, field.name), getattr(second, field.name)
        if dataclasses.is_dataclass(mine):
            _same(mine, other)
        else:
            assert_array_equal(mine, other)


@given(command=commands)
def test_a_command_arrives_as_it_was_sent(command: Command) -> None:
    content = {"v": 1, "boot": "b", "token": 1, "n": 2, "answers": command.answers}
    message = unpack_command(pack(content | command_fields(command)))
    received = message.command(message.answers)
    _same(received, command)


@given(command=commands, received_ns=st.integers(0, 2**60))
def test_a_state_arrives_as_it_was_sent_with_its_age(command: Command, received_ns: int) -> None:
    robot = FakeRobot()
    robot.open()
    state = dataclasses.replace(
        robot.measure(),
        mode=Mode.MOVING,
        fault="f",
        applied=AppliedCommand(4, command, ("joint_speed",)),
    )
    received, info = unpack_state(pack_state(state, INFO), robot.spec, received_ns)
    assert info == INFO
    for field in dataclasses.fields(state):
        if field.name in ("applied", "objects", "stamp_ns"):
            continue
        assert_array_equal(getattr(received, field.name), getattr(state, field.name))
    assert received.applied is not None
    assert (received.applied.tick, received.applied.clipped) == (4, ("joint_speed",))
    _same(received.applied.command, command)
    assert received_ns - received.stamp_ns == INFO.now_ns - state.stamp_ns
    for name, pose in state.objects.items():
        _same(dataclasses.replace(received.objects[name], stamp_ns=pose.stamp_ns), pose)
        assert received_ns - received.objects[name].stamp_ns == INFO.now_ns - pose.stamp_ns


def test_a_state_of_another_robot_is_refused() -> None:
    robot, other = FakeRobot(), make_driver("mujoco", scene="push")
    robot.open()
    with pytest.raises(WireError, match="shape"):
        unpack_state(pack_state(robot.measure(), INFO), other.spec, 0)


def test_a_description_arrives_as_it_was_sent_and_a_changed_one_is_noticed() -> None:
    spec = make_driver("mujoco", scene="push").spec
    sent = msgpack.unpackb(msgpack.packb(spec.to_dict()))
    assert read_spec(sent).to_dict() == spec.to_dict()
    sent["limits"]["max_ee_speed_m_s"] *= 2
    with pytest.raises(Exception, match="body_digest"):
        read_spec(sent)


@given(data=st.binary(max_size=300))
def test_bytes_that_are_no_message_raise_nothing_else(data: bytes) -> None:
    for decode in (unpack_map, unpack_command):
        with pytest.raises(WireError):
            decode(data)


@given(cut=st.integers(0, 10_000), bit=st.integers(0, 7), flip=st.booleans())
def test_a_damaged_state_is_refused_or_of_the_right_shapes(cut: int, bit: int, flip: bool) -> None:
    robot = FakeRobot()
    robot.open()
    data = bytearray(pack_state(robot.measure(), INFO))
    place = cut % len(data)
    if flip:
        data[place] ^= 1 << bit
    else:
        del data[place:]
    try:
        state, _ = unpack_state(bytes(data), robot.spec, 0)
    except WireError:
        return
    assert flip, "a truncated message is no message"
    assert state.q.shape == (len(robot.spec.joint_names),)


def test_a_message_that_is_too_long_is_not_read() -> None:
    with pytest.raises(WireError) as refused:
        unpack_map(pack({"v": 1, "x": bytes(MAX_BYTES)}))
    assert refused.value.reason == "too_long"


@pytest.mark.parametrize("name", ["", "Fetch", "a/b", "a*", "-a", "a" * 65, "ä"])
def test_an_invalid_name_makes_no_key(name: str) -> None:
    with pytest.raises(InvalidSpec, match="robot name"):
        robot_key(name, "cmd")
