"""A program that is forked from the fork server is what a plain start would make of it."""

from __future__ import annotations

import json
import signal
import sys

import pytest

from tools.fork_server import ForkServer

SHOW = """#!{python}
import argparse, atexit, json, os, signal, sys, threading
atexit.register(print, "at exit")
print(json.dumps(dict(
    argv=sys.argv, name=__name__, file=__file__, path=sys.path, folder=os.getcwd(),
    main=sys.modules["__main__"].__file__,
    environment={{k: v for k, v in os.environ.items() if k != "LC_CTYPE"}},
    session=os.getsid(0) == os.getpid() == os.getpgid(0), descriptors=sorted(map(int, os.listdir("/proc/self/fd")))[:3],
    command=[word for word in open("/proc/self/cmdline").read().split("\\0")[1:] if word],
    interrupt=signal.getsignal(signal.SIGINT) is signal.default_int_handler, pipe=int(signal.getsignal(signal.SIGPIPE)),
    threads=threading.active_count(), terminal=sys.stdin.isatty(), stdin=sys.stdin.read(),
)))
print("errors", file=sys.stderr)
{end}
"""


@pytest.fixture
def program(tmp_path):
    def write(end: str = ""):
        file = tmp_path / "show.py"
        file.write_text(SHOW.format(python=sys.executable, end=end))
        file.chmod(0o755)
        return str(file)

    return write


@pytest.fixture(autouse=True)
def own_server(processes, monkeypatch):
    """A server for this test, whatever earlier ones have left in the environment."""
    process = processes.start("true")
    server = ForkServer(process._environment)
    monkeypatch.setattr(type(process), "_server", server)
    yield
    server._server.communicate()


@pytest.mark.parametrize(
    ("end", "code"),
    [
        ("", 0),
        ("sys.exit(3)", 3),
        ("sys.exit('a sentence')", 1),
        ("1 / 0", 1),
        ("os.kill(os.getpid(), signal.SIGINT)", -signal.SIGINT),
        ("os.kill(os.getpid(), signal.SIGKILL)", -signal.SIGKILL),
        ("threading.Timer(0.1, print, ['a thread ends first']).start()", 0),
    ],
)
def test_it_is_as_a_plain_start(processes, program, end, code):
    outputs = []
    for interpreter, fork in (((), False), ((), True), ((sys.executable,), True)):
        words = *interpreter, program(end), "-x", "a b", "__name:=c"
        process = processes.start(*words, env={"ROS_TEST": "1"}, fork=fork)
        assert process.wait(20.0) == code, process.log_path.read_text()
        lines = process.log_path.read_text().splitlines()
        first = json.loads(lines[0])
        first["environment"].pop("PYTEST_CURRENT_TEST", None)
        # A traceback of the fork also names the server's own lines.
        outputs.append((first, [line for line in lines[1:] if not line.startswith(" ")]))
    assert outputs[0] == outputs[1] == outputs[2]
    assert outputs[1][0]["environment"]["ROS_TEST"] == "1"


@pytest.mark.parametrize("interpreter", [(), (sys.executable,)])
def test_it_is_forked(processes, program, wait_until, interpreter):
    process = processes.start(*interpreter, program("threading.Event().wait(20.0)"))
    wait_until(lambda: "errors" in process.log_path.read_text(), 10.0, "the program")
    with open(f"/proc/{process._server._server.pid}/stat") as server, open(f"/proc/{process.pid}/stat") as forked:
        assert server.read().split()[25:28] == forked.read().split()[25:28], "one memory image"
    process.send_signal(signal.SIGINT)
    assert process.wait(10.0) == -signal.SIGINT


def test_what_another_environment_needs_starts_plainly(processes, program):
    process = processes.start(program(), env={"MUJOCO_GL": "none"})
    server = process._server
    usual = {name: value for name, value in process._environment.items() if name != "MUJOCO_GL"}
    assert server.fits([program()], usual) and not server.fits([program()], process._environment)
    for command in (["roscore"], [sys.executable], [sys.executable, "-c", "import x.py"]):
        assert not server.fits(command, usual)
    assert process.wait(20.0) == 0
