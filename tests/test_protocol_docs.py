"""The page of the protocol names everything that the messages hold."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from drivers.remote import messages, state_message
from drivers.remote.keys import REQUESTS
from drivers.wire import Part, unpack_map
from iher_robot.host.access import FOR_EVERYBODY, FOR_MOVERS, FOR_OPERATORS

PAGE = (Path(__file__).parents[1] / "docs" / "protocol.md").read_text()
CODE = set(re.findall(r"`([^`]+)`", PAGE))
NAMED = {word for span in CODE for word in re.findall(r"\w+", span)}

MODELS = [
    model
    for module in (messages, state_message)
    for model in vars(module).values()
    if isinstance(model, type) and issubclass(model, Part)
]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_every_field_is_on_the_page(model: type[Part]) -> None:
    assert model.model_fields.keys() <= NAMED


def test_every_request_is_on_the_page_with_who_may_make_it() -> None:
    rows = re.findall(r"^\| (`[\w`, ]+`) \|", PAGE.split("## Requests")[1], flags=re.MULTILINE)
    listed = {name for row in rows for name in re.findall(r"\w+", row)}
    assert set(REQUESTS) <= listed
    heading = next(line for line in PAGE.splitlines() if line.startswith("| | state, fault, alive"))
    everybody, movers, operators, _ = heading.strip("| ").split("|")
    assert set(FOR_EVERYBODY) == set(re.findall(r"`(\w+)`", everybody))
    assert set(FOR_MOVERS) | {"cmd"} == set(re.findall(r"`(\w+)`", movers))
    assert set(FOR_OPERATORS) == set(re.findall(r"`(\w+)`", operators))


def test_every_key_is_on_the_page() -> None:
    for key in ("state", "fault", "cmd", "stop", "object/<name>", "rpc/<request>"):
        assert f"iher/v1/<robot>/{key}" in CODE


def test_the_example_of_a_message_is_one() -> None:
    (example,) = re.findall(r"in hexadecimal `([0-9a-f]+)`", PAGE)
    assert unpack_map(bytes.fromhex(example)) == {"v": 1}
