"""Programs that need not load torch and MuJoCo again: forks of a process that has.

A fork is a process like any other: it may be killed, and has its own output and environment.
"""

from __future__ import annotations

import functools
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.repository import ROOT

_SERVER = """
import json, os, sys
import matplotlib.figure, matplotlib.backends.backend_agg, torch.utils.tensorboard
import drivers.mujoco, iher_robot.cli.app, iher_robot.training.train, tests.small_runs

for line in sys.stdin:
    request = json.loads(line)
    child = os.fork()
    if child == 0:
        for number, name in ((0, os.devnull), (1, request["stdout"]), (2, request["stderr"])):
            os.dup2(os.open(name, os.O_RDWR | os.O_CREAT), number)
        os.environ |= request["environment"]
        sys.argv[1:] = request["arguments"]
        exec(compile(request["program"], "<forked>", "exec"), {"__name__": "__main__"})
        sys.exit()
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


def run_forked(
    program: str, *arguments: str, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run a program, as ``python -c`` does, and wait for it.

    Args:
        program: Its text.
        arguments: What follows in ``sys.argv``.
        environment: Variables that are set for it.
    """
    server = _server()
    assert server.stdin is not None
    assert server.stdout is not None
    with tempfile.TemporaryDirectory() as folder:
        outputs = {name: str(Path(folder) / name) for name in ("stdout", "stderr")}
        request = outputs | {"program": program, "arguments": arguments, "environment": environment}
        server.stdin.write(json.dumps(request) + "\n")
        server.stdin.flush()
        answer = server.stdout.readline()
        assert answer, "the server has ended"
        stdout, stderr = (Path(outputs[name]).read_text() for name in ("stdout", "stderr"))
    return subprocess.CompletedProcess(arguments, int(answer), stdout, stderr)


@functools.cache
def _server() -> subprocess.Popen[str]:
    """Started once in a process of pytest, with which its input ends and so does it."""
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [sys.executable, "-c", _SERVER], cwd=ROOT, stdin=pipe, stdout=pipe, text=True
    )
