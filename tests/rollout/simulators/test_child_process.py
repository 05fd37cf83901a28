"""Programs in processes of their own end in silence when the run that started them is gone."""

from __future__ import annotations

import signal
import socket
from types import ModuleType
from typing import Any

import pytest

from iher_robot.errors import UserError
from iher_robot.rollout.simulators import worker as simulator_program
from iher_robot.training.learners import async_worker as learner_program


@pytest.mark.parametrize("program", [learner_program, simulator_program])
@pytest.mark.parametrize(
    "error", [EOFError, BrokenPipeError, ConnectionResetError, UserError("nobody hears this")]
)
def test_a_program_ends_without_an_error_when_nobody_is_there_any_more(
    program: ModuleType, error: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def serve(_: object) -> None:
        raise error

    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setattr(program, "exit_on_hangup", lambda _: None)
    monkeypatch.setattr(program, "_serve", serve)
    ours, its = socket.socketpair()
    ours.close()
    program.main(its.detach())
