"""Starts Python programs as forks of a process that holds their imports: for tests, which start hundreds of nodes.

A node of this project takes 0.6 s of a processor to import its modules, one with torch 3.6 s. The server imports what a
program imports when that program is first asked for, without running it, and forks: the child is what a plain start
would make (argv, environment, session, output, `__main__`), with the modules already there.
"""

from __future__ import annotations

import ast
import atexit
import contextlib
import ctypes
import gc
import importlib
import io
import json
import os
import signal
import subprocess
import sys
import threading
import types
from pathlib import Path
from typing import Any, NoReturn

PR_SET_CHILD_SUBREAPER = 36
ROOM_FOR_COMMAND = 4096
"""What `/proc/PID/cmdline` of a child can hold [bytes]."""
OWN_VARIABLES = ("ROS", "PYTEST_", "LEAP_RIG_", "DISPLAY", "QT_QPA_PLATFORM", "QT_API", "LD_LIBRARY_PATH")
"""Beginnings of variables that may differ from the server's own: no module reads the first five when it is imported,
and the others are what python_qt_binding and cv2 set in a process that imports them."""


class ForkServer:
    """The client's half, used by one thread. The server ends with this process."""

    def __init__(self, environment: dict[str, str]) -> None:
        self._environment = _fixed(environment)
        self._server = subprocess.Popen(
            [sys.executable, __file__, "x" * ROOM_FOR_COMMAND],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
            start_new_session=True,
        )

    def fits(self, command: list[str], environment: dict[str, str]) -> bool:
        """Returns whether a fork would be the same as a plain start: a program for this Python, in this environment."""
        if self._environment != _fixed(environment):
            return False
        if command[0] == sys.executable:
            return command[1:2] != [] and command[1].endswith(".py")
        if not command[0].endswith(".py"):
            return False
        with contextlib.suppress(OSError), open(command[0], errors="replace") as file:
            interpreter = Path(file.readline().strip()[2:])
            return interpreter.parent.resolve() == Path(sys.executable).parent.resolve()
        return False

    def start(self, command: list[str], environment: dict[str, str], log: Path) -> int:
        """Starts a program in its own session, its output into a file; returns the pid, of a child of the caller."""
        command = command[command[0] == sys.executable :]
        request = {"command": command, "environment": environment, "folder": os.getcwd(), "log": str(log)}
        assert self._server.stdin is not None and self._server.stdout is not None
        # The program's first parent ends at once: meanwhile the kernel gives orphans to this process.
        _adopt_orphans(True)
        try:
            self._server.stdin.write(json.dumps(request) + "\n")
            self._server.stdin.flush()
            pid = int(self._server.stdout.readline())
            self._server.stdout.readline()  # the first parent has ended
        finally:
            _adopt_orphans(False)
        return pid


def _fixed(environment: dict[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if not name.startswith(OWN_VARIABLES)}


def _adopt_orphans(yes: bool) -> None:
    if ctypes.CDLL(None, use_errno=True).prctl(PR_SET_CHILD_SUBREAPER, int(yes), 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_CHILD_SUBREAPER)")


def _serve() -> types.CodeType:
    """Answers requests until the client ends. Returns in the children only: with the program to run."""
    answers = os.dup(1)
    os.dup2(2, 1)  # what modules print when they are imported is no answer
    for line in sys.stdin:
        request: dict[str, Any] = json.loads(line)
        script, source = _source(request["command"][0])
        _import_what_it_imports(source)
        gc.freeze()  # a collection in a child must not copy the shared pages
        first = os.fork()
        if first:
            os.waitpid(first, 0)
            os.write(answers, b"\n")
            continue
        child = os.fork()
        if child:
            os.write(answers, b"%d\n" % child)
            os._exit(0)
        os.close(answers)
        _become(script, **request)
        return compile(source, script, "exec")
    os._exit(0)


def _source(program: str) -> tuple[str, str]:
    """Returns path and text of a program; of catkin's relay in devel/lib those of the script that it stands for."""
    text = Path(program).read_text(encoding="utf-8")
    for line in text.splitlines():
        if line.startswith("python_script = "):
            script = ast.literal_eval(line.partition("= ")[2])
            return script, Path(script).read_text(encoding="utf-8")
    return program, text


def _import_what_it_imports(source: str) -> None:
    for node in ast.parse(source).body:
        names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        for name in names:
            with contextlib.suppress(Exception):  # the program itself says what it misses
                importlib.import_module(name)
    threads = os.listdir("/proc/self/task")
    assert len(threads) == 1, f"a module that {source} imports starts threads, which do not survive a fork"


def _become(script: str, command: list[str], environment: dict[str, str], folder: str, log: str) -> None:
    """Makes this process what a plain start of the command would have made."""
    os.setsid()
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    for path, flags, targets in ((os.devnull, os.O_RDONLY, (0,)), (log, os.O_WRONLY | os.O_APPEND, (1, 2))):
        opened = os.open(path, flags)
        for target in targets:
            os.dup2(opened, target)
        os.close(opened)
    sys.stdin = sys.__stdin__ = open(0)  # type: ignore[misc]  # noqa: SIM115 - open as long as the process
    sys.stdout = sys.__stdout__ = _unbuffered(1, "strict")  # type: ignore[misc]
    sys.stderr = sys.__stderr__ = _unbuffered(2, "backslashreplace")  # type: ignore[misc]
    sys.argv = command
    sys.path.insert(0, str(Path(command[0]).parent))
    _show_command(command)
    if "numpy" in sys.modules:
        sys.modules["numpy"].random.seed()
    if "rospy" in sys.modules:  # reads its command line and namespace when it is imported
        names = sys.modules["rospy.names"]
        names.reload_mappings(sys.argv)
        names._caller_namespace = names.get_ros_namespace()  # type: ignore[attr-defined]
        names._caller_id = names._caller_namespace + "unnamed"  # type: ignore[attr-defined]
    program = types.ModuleType("__main__")
    program.__file__ = script
    sys.modules["__main__"] = program


def _unbuffered(descriptor: int, errors: str) -> io.TextIOWrapper:
    raw = open(descriptor, "wb", buffering=0)  # noqa: SIM115
    return io.TextIOWrapper(raw, encoding="utf-8", errors=errors, write_through=True)


def _show_command(command: list[str]) -> None:
    """Writes the command to /proc/self/cmdline, where the panel's Emergency Stop recognizes a controller."""
    fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
    start, end = int(fields[45]), int(fields[46])  # arg_start, arg_end (proc(5), fields 48 and 49 of stat)
    text = "\0".join([sys.executable, *command]).encode()[: end - start - 1]
    ctypes.memmove(start, text.ljust(end - start, b"\0"), end - start)


def _run(code: types.CodeType) -> NoReturn:
    """Runs a program and exits as Python does, but for the destruction of its objects."""
    status, interrupted = 0, False
    try:
        exec(code, sys.modules["__main__"].__dict__)
    except SystemExit as end:
        if end.code is not None and not isinstance(end.code, int):
            print(end.code, file=sys.stderr)
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException as error:
        sys.excepthook(type(error), error, error.__traceback__)
        status, interrupted = 1, isinstance(error, KeyboardInterrupt)
    threading._shutdown()  # type: ignore[attr-defined]  # waits for the other threads
    atexit._run_exitfuncs()
    if interrupted:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)
    os._exit(status & 0xFF)


if __name__ == "__main__":
    del sys.path[0]  # the tools
    _run(_serve())
