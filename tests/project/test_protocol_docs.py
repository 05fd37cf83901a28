"""The page of the protocol says what the messages hold, and its examples are messages."""

from __future__ import annotations

import json
import multiprocessing
import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import msgpack  # type: ignore[import-untyped]
import numpy as np
import pytest

from drivers import DriverError, Refusal, SimulatedClock, errors, spec
from drivers.limits import Box, GripperLimits, JointLimits, Limits
from drivers.remote import link_options, messages, state_message
from drivers.remote.keys import REQUESTS, robot_key
from drivers.remote.link import client_config
from drivers.remote.messages import Empty, Reply, check_command, unpack_command
from drivers.wire import VERSION, Message, Part, check, pack, pack_array, unpack, unpack_map
from iher_robot.host.control_loop import ControlLoop
from iher_robot.host.heartbeat import Heartbeat
from iher_robot.host.network.access import FOR_EVERYBODY, FOR_MOVERS, FOR_OPERATORS
from iher_robot.host.network.channels import Channel, channel_ends
from iher_robot.host.persistence import RobotMemory, RobotTotal
from iher_robot.host.served_robot import ServedRobot
from iher_robot.host.settings import HostSettings
from tests.drivers.fake_robot import FakeRobot, fake_spec
from tests.repository import ROOT

PAGE = (ROOT / "docs" / "protocol.md").read_text()
PARTS = {
    name: model
    for module in (messages, state_message)
    for name, model in vars(module).items()
    if isinstance(model, type) and issubclass(model, Part) and model.__module__ == module.__name__
}
WHOLE = {name: model for name, model in PARTS.items() if issubclass(model, Message)}


def section(heading: str) -> str:
    """Return what stands below a heading, up to the next one."""
    (start,) = re.finditer(rf"^#+ {re.escape(heading)}$", PAGE, flags=re.MULTILINE)
    return re.split(r"^##", PAGE[start.end() :], maxsplit=1, flags=re.MULTILINE)[0]


def listed(heading: str) -> set[str]:
    """Return the names in the first column of a section's table."""
    rows = re.findall(r"^\| (`.*?) \|", section(heading), flags=re.MULTILINE)
    return {name for row in rows for name in re.findall(r"`(\w+)`", row)} - {"field"}


def words(text: str) -> set[str]:
    return {word for span in re.findall(r"`([^`]+)`", text) for word in re.findall(r"\w+", span)}


def example(name: str) -> dict[str, Any]:
    """Return the example of a message as it would be decoded."""
    (text,) = re.findall(r"```json\n(.*?)```", section(f"`{name}`"), flags=re.DOTALL)
    content = _decoded(json.loads(text))
    assert isinstance(content, dict)
    return content


def _decoded(value: Any) -> Any:
    if isinstance(value, str) and value.startswith("hex:"):
        return bytes.fromhex(value.removeprefix("hex:"))
    if isinstance(value, list) and value[:1] == ["<f8"]:
        dtype, shape, numbers = value
        assert shape == [len(numbers)]
        return pack_array(np.array(numbers, dtype=dtype))
    if isinstance(value, dict):
        return {key: _decoded(item) for key, item in value.items()}
    return value


def _fields_of_its_own(model: type[Part]) -> set[str]:
    return set(vars(model).get("__annotations__", {}))


@pytest.mark.parametrize("name", PARTS)
def test_every_field_is_on_the_page_and_no_other(name: str) -> None:
    assert listed(f"`{name}`") == _fields_of_its_own(PARTS[name])


@pytest.mark.parametrize("name", PARTS)
def test_a_message_names_the_one_that_it_extends(name: str) -> None:
    base = PARTS[name].__base__
    if base is not None and base.__name__ in PARTS:
        assert f"The fields of `{base.__name__}`" in section(f"`{name}`").replace("the", "The")


@pytest.mark.parametrize("name", WHOLE)
def test_every_example_is_a_message(name: str) -> None:
    content = example(name)
    read = check(WHOLE[name], content)
    assert content.keys() == WHOLE[name].model_fields.keys(), "an example shows every field"
    assert unpack_map(pack(read)) == content, "it travels as it stands there"


def test_what_was_applied_has_the_form_of_a_command() -> None:
    applied = example("StateMessage")["applied"]
    assert check_command(applied["command"]).answers == applied["tick"] - 1


def test_the_bytes_on_the_page_are_the_example() -> None:
    (text,) = re.findall(r"```hex\n(.*?)```", PAGE, flags=re.DOTALL)
    data = bytes.fromhex(text)
    assert msgpack.unpackb(data) == example("EndEffectorMessage")
    assert unpack_command(data).n == 41


def test_every_request_is_on_the_page_with_its_message() -> None:
    table = section("What can be asked")
    rows = re.findall(r"^\| (`[\w`, ]+`) \| `(\w+)` \|", table, flags=re.MULTILINE)
    of_request = {name: kind for names, kind in rows for name in re.findall(r"\w+", names)}
    assert set(of_request) == set(REQUESTS)
    assert set(of_request.values()) < set(WHOLE)


def test_every_role_may_do_what_the_page_says() -> None:
    heading = next(line for line in PAGE.splitlines() if line.startswith("| | state, fault, alive"))
    everybody, movers, operators, _ = heading.strip("| ").split("|")
    assert set(FOR_EVERYBODY) == set(re.findall(r"`(\w+)`", everybody))
    assert set(FOR_MOVERS) | {"cmd"} == set(re.findall(r"`(\w+)`", movers))
    assert set(FOR_OPERATORS) == set(re.findall(r"`(\w+)`", operators))


def test_every_key_is_on_the_page() -> None:
    keys = set(re.findall(r"`(iher/[^`]+)`", section("Keys")))
    names = ["state", "fault", "cmd", "stop", "object/<name>", "rpc/<request>"]
    names += ["alive/<session>", "alive/host"]
    assert keys == {robot_key("fetch", name).replace("fetch", "<robot>") for name in names}
    assert f"`v{VERSION}`" in section("Versions")


def test_every_setting_of_a_session_is_the_one_that_is_used() -> None:
    config = client_config(link_options({}))
    lines = [line for line in section("Transport").splitlines() if line.count("|") == 4]
    checked = 0
    for names, host, client in (map(str.strip, line.split("|")[1:4]) for line in lines):
        said = host if client == "the same" else client
        value = re.match(r"`(.*)`|(\d+) ", said)
        for name in re.findall(r"`([\w/]+/[\w/]+|mode)`", names):
            if value is not None:
                found = json.loads(config.get_json(name))
                written = value[1] or value[2]
                assert found == (written if name == "mode" else json.loads(written)), name
                checked += 1
    assert checked >= 9


def test_every_reason_of_a_refusal_is_on_the_page() -> None:
    of_the_host = {"too_long", "malformed", "version", "wrong_boot", "wrong_token", "repeated"}
    of_the_host |= {"expired", "invalid", "failed", "overrun"}
    of_the_host |= {"object_overrun", "object_invalid", "request_malformed", "request_refused"}
    assert of_the_host | set(map(str, Refusal)) <= words(section("What is refused"))


def test_every_error_is_on_the_page() -> None:
    kinds = {
        name
        for name, kind in vars(errors).items()
        if isinstance(kind, type) and issubclass(kind, DriverError)
    }
    unasked = {"DriverError", "UnknownDriver", "InvalidCommand"}  # no request is answered so
    assert listed("Errors") - {"error"} == kinds - unasked


def test_every_field_of_a_description_is_on_the_page() -> None:
    heading = "The description of a robot"
    assert listed(heading) == set(fake_spec().to_dict())
    parts = {spec.ActionSpec, spec.ObjectSource, spec.Home, Limits}
    parts |= {JointLimits, GripperLimits, Box}
    for part in parts:
        assert {field.name for field in fields(part)} <= words(section(heading))
    nested = {hint for part in parts for hint in _dataclasses_in(part)}
    assert nested <= parts, "a part of the description that this test does not know"


def _dataclasses_in(part: type) -> set[type]:
    hints = get_type_hints(part).values()
    return {kind for hint in hints for kind in (hint, *get_args(hint)) if is_dataclass(kind)}  # type: ignore[misc]


def test_every_field_of_a_status_is_on_the_page(tmp_path: Path) -> None:
    clock, (one, other) = SimulatedClock(10**9), channel_ends()
    served = ServedRobot(lambda _: FakeRobot(), "push", RobotMemory(tmp_path), (), clock)
    settings = HostSettings("fake", "fake", {}, ("tcp/127.0.0.1:1",), tmp_path)
    heartbeat = Heartbeat(multiprocessing.get_context("spawn"))
    with one, other, RobotTotal(tmp_path, "fake") as total:
        loop = ControlLoop(
            settings, served, total, RobotMemory(tmp_path), Channel(other), heartbeat, clock
        )
        served.open()
        reply = unpack(Reply, loop._requests.answer("status", pack(Empty())))
        served.close()
    assert reply.ok, reply.message
    assert listed("The status of a host") == set(reply.result)


def test_every_time_is_the_default() -> None:
    table = section("Times")
    settings = HostSettings("fake", "fake", {}, (), Path())
    options = link_options({})
    for value in (
        f"{settings.command_age_ticks:g} control periods",
        f"{settings.deadman_s:g} s",
        f"{settings.lease_s:g} s",
        f"{options.timeout_s:g} s | client, `timeout_s`",
        f"{options.reset_timeout_s:g} s | client, `reset_timeout_s`",
        f"{options.connect_timeout_s:g} s | client, `connect_timeout_s`",
    ):
        assert f"| {value}" in table
