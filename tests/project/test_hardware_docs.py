"""The page for owners of robots: its commands exist, and its perception node publishes poses."""

from __future__ import annotations

import re

import numpy as np
import pytest
import typer
import yaml
import zenoh

from drivers import LinkLost
from drivers.remote import link_options
from drivers.remote.messages import ObjectMessage
from drivers.wire import unpack
from iher_robot.cli.app import app
from iher_robot.env.goal_env import LinkTooSlow
from iher_robot.host.network.access import gateway_config
from tests.repository import ROOT
from tests.served.served_robot import eventually, free_port

PAGE = (ROOT / "docs" / "hardware.md").read_text()


def blocks(language: str) -> list[str]:
    fenced = re.findall(r"^```(\w*)\n(.*?)^```$", PAGE, flags=re.DOTALL | re.MULTILINE)
    return [text for found, text in fenced if found == language]


COMMANDS = [
    line for block in blocks("") for line in block.splitlines() if line.startswith("iher-robot ")
]


def test_there_are_commands() -> None:
    assert len(COMMANDS) >= 8


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_can_be_read(line: str) -> None:
    _, name, *words = line.split()
    command = typer.main.get_command(app).commands[name]  # type: ignore[attr-defined]
    command.make_context(name, list(words))


def test_every_command_in_a_sentence_exists() -> None:
    names = set(re.findall(r"`iher-robot ([a-z-]+)", PAGE))
    assert names <= set(typer.main.get_command(app).commands)  # type: ignore[attr-defined]


def test_every_error_in_a_sentence_exists() -> None:
    named = set(re.findall(r"`(\w*(?:Lost|Slow|Refused|Latched))`", PAGE))
    assert named == {LinkLost.__name__, LinkTooSlow.__name__}


def test_every_message_of_troubleshooting_exists() -> None:
    table = PAGE.split("## Troubleshooting")[1]
    cells = re.findall(r"^\| (`.*?) \| ", table, flags=re.MULTILINE)
    messages = [text for cell in cells for text in re.findall(r"`([^`]+)`", cell)]
    messages = [text for text in messages if " " in text]
    code = "".join(
        file.read_text()
        for name in ("iher_robot", "drivers")
        for file in (ROOT / name).rglob("*.py")
    )
    code = re.sub(r"[\"']\s*f?[\"']", "", code)  # literals that Python joins
    parts = [
        part.strip() for message in messages for part in re.split(r"\.\.\.|object0|'|0\.3", message)
    ]
    assert len(messages) >= 9
    assert [part for part in parts if part not in code] == []


def test_the_robot_file_of_a_client_is_one() -> None:
    (text,) = blocks("yaml")
    options = yaml.safe_load(text)
    assert options.pop("driver") == "zenoh"
    assert link_options(options).robot == "my-robot"


class Seen(Exception):
    """The tracker is asked no more."""


def test_the_perception_node_publishes_poses() -> None:
    (node,) = (block for block in blocks("python") if "ObjectMessage" in block)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    received: list[ObjectMessage] = []
    with zenoh.open(gateway_config("my-robot", [endpoint], None, insecure=False)) as host:
        host.declare_subscriber(
            "iher/v1/my-robot/object/object0",
            lambda sample: received.append(unpack(ObjectMessage, sample.payload.to_bytes())),
        )
        tracker = (
            "def see():\n"
            "    if enough():\n"
            "        raise Seen\n"
            "    return np.array([1.3, 0.75, 0.42])\n"
        )
        begin, end = re.search(r"def see\(\).*?\n\n\n", node, flags=re.DOTALL).span()  # type: ignore[union-attr]
        program = node[:begin] + tracker + node[end:]
        program = program.replace("tcp/127.0.0.1:7447", endpoint)
        namespace = {"Seen": Seen, "enough": lambda: len(received) > 3}
        with pytest.raises(Seen):
            exec(compile(program, "the node", "exec"), namespace)
        assert eventually(lambda: len(received) > 3)
    assert np.array_equal(received[0].pos, [1.3, 0.75, 0.42])
    assert [pose.n for pose in received] == sorted({pose.n for pose in received})
