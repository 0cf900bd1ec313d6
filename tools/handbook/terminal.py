"""A terminal in which a reader of the handbook types: commands that end by themselves, or run until Ctrl-C."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shlex
import signal
import subprocess
import termios
import threading
import time
import uuid
import xmlrpc.client
from collections.abc import Callable
from pathlib import Path
from typing import cast

import psutil

POLL_S, LONG_S, SOON_S = 0.3, 300.0, 45.0
"""How often is looked, and the longest waits [s], on a busy machine: for a command, its start or its end; for what it
started to end after it."""

SETTLED_S = 1.0
"""A node has started when its topics and services have not changed for so long: rospy hangs on a Ctrl-C that comes
while its main thread asks the master."""

DRAINED_S = 1.0
"""The longest wait for the rest of what an ended command printed; what it left behind may keep the terminal open."""

ENDED = (0, 128 + signal.SIGINT, -signal.SIGINT)
"""Exit codes of a clean end by Ctrl-C: the program's own, the shell's for what the signal ended, or make's."""

CTRL_C = b"\x03"
READY = re.compile(r"listening on|UDP port|^world: | s \| arm servo", re.MULTILINE)
"""What programs print when they are ready that are no nodes: simulated devices, and the demo when the arm follows."""

DEVICES = {
    f"rig_simulation/{name}.py" for name in ("world", "sunrise_controller", "reflex_hand", "leapd", "viewer", "record")
}
"""What launch files start that is no node."""
FAULT = re.compile(
    r"Traceback|has died|new node registered with same name|^success: False", re.MULTILINE | re.IGNORECASE
)
"""What no command prints that does what the page says."""

MARK = "HANDBOOK_TERMINAL"  # environment variable of all that a terminal starts


class Terminal:
    """Runs a command with bash, which stops at the first failure, in a terminal of its own. pexpect would read what is
    shown only while somebody waits for it, and a program that nobody reads stands still.

    Attributes:
        command: what was typed.
        log: file with what is shown."""

    def __init__(self, command: str, folder: Path, log: Path, environment: dict[str, str]) -> None:
        self.command = command
        self.log = log
        self._mark = str(uuid.uuid4())
        self._environment = {**os.environ, **environment, MARK: self._mark}
        self._pids: dict[str, tuple[str, int]] = {}
        self._registered: dict[str, tuple[set[tuple[int, str]], float]] = {}
        self._keyboard, inside = os.openpty()
        self._process = subprocess.Popen(
            ["bash", "-euo", "pipefail", "-c", command],
            cwd=folder, env=self._environment, stdin=inside, stdout=inside, stderr=inside,
            start_new_session=True, preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )  # fmt: skip
        os.close(inside)
        log.touch()
        self._shown = threading.Thread(target=self._show, daemon=True)
        self._shown.start()
        os.write(self._keyboard, b"yes\n" * 5)  # the answer to what programs ask

    @property
    def output(self) -> str:
        """What it printed so far."""
        return self.log.read_text(errors="replace").replace("\r\n", "\n")

    def end(self) -> str:
        """Waits until the command has ended by itself, ends what it left in the background, returns what was wrong."""
        ended = _wait(lambda: self._process.poll() is not None, LONG_S)
        fault = self._fault() if ended else f"did not end within {LONG_S:.0f} s"
        self._signal(signal.SIGTERM)
        self._clear()
        return fault

    def start(self) -> str:
        """Waits until the command is ready; returns what was wrong, after it has ended it."""
        came = _wait(lambda: self._process.poll() is not None or bool(self._went_wrong()) or self._ready(), LONG_S)
        fault = self._went_wrong() if came else f"was not ready within {LONG_S:.0f} s"
        if self._process.poll() is not None:
            fault = f"ended with {self._process.returncode}"
        if not fault:
            return ""
        self._signal(signal.SIGTERM)
        self._clear()
        return fault

    def interrupt(self, codes: tuple[int, ...] = ENDED) -> str:
        """Types Ctrl-C; returns what was wrong with the end."""
        if self._process.poll() is not None:
            return f"ended with {self._process.returncode} before Ctrl-C"
        os.write(self._keyboard, CTRL_C)
        ended = _wait(lambda: self._process.poll() is not None, LONG_S)
        fault = self._fault(codes) if ended else f"went on for {LONG_S:.0f} s after Ctrl-C"
        left = self._clear()
        return fault or (f"left behind: {', '.join(left)}" if left else "")

    def _fault(self, codes: tuple[int, ...] = (0,)) -> str:
        self._shown.join(DRAINED_S)  # what it printed last is shown a moment later
        if self._process.returncode not in codes:
            return f"exit code {self._process.returncode}"
        return self._went_wrong()

    def _went_wrong(self) -> str:
        found = FAULT.search(self.output)
        return f"printed {found[0]!r}" if found else ""

    def _ready(self) -> bool:
        if self.command.startswith("make "):
            return bool(READY.search(self.output))
        own = {node.rsplit("/", 1)[-1] for node in self._nodes()}
        if not self.command.startswith("roslaunch"):
            return bool(READY.search(self.output) or own or self._windows())
        nodes = dict(re.findall(r"^    (\S+) \((\S+/\S+)\)$", self.output, re.MULTILINE))
        absent = set(re.findall(r"cannot launch node of type \[(\S+)\]", self.output))  # of a package that is optional
        return bool(nodes) and own >= {name for name, program in nodes.items() if program not in DEVICES | absent}

    def _nodes(self) -> set[str]:
        """Returns the nodes on the master that are processes of this terminal and have settled."""
        own = self._processes()
        master = xmlrpc.client.ServerProxy(self._environment["ROS_MASTER_URI"])
        try:
            state = cast("list", master.getSystemState("/handbook"))[2]
            for node in {node for kind in state for _, nodes in kind for node in nodes}:
                names = {(k, name) for k, kind in enumerate(state) for name, nodes in kind if node in nodes}
                if names != self._registered.get(node, (set(), 0.0))[0]:
                    self._registered[node] = names, time.monotonic()
                uri = str(cast("list", master.lookupNode("/handbook", node))[2])
                if uri not in self._pids:
                    with contextlib.suppress(OSError):  # a node that ends
                        self._pids[uri] = node, int(cast("list", xmlrpc.client.ServerProxy(uri).getPid("/handbook"))[2])
        except OSError:
            return set()
        settled = time.monotonic() - SETTLED_S
        return {node for node, pid in self._pids.values() if pid in own and self._registered[node][1] < settled}

    def _windows(self) -> bool:
        command = ["xdotool", "search", "--onlyvisible", "--name", ".", "getwindowpid", "%@"]
        found = subprocess.run(command, env=self._environment, capture_output=True, text=True, timeout=LONG_S)
        return not self._processes().keys().isdisjoint(int(pid) for pid in found.stdout.split() if pid.isdigit())

    def _show(self) -> None:
        with open(self.log, "wb") as log, contextlib.suppress(OSError):  # an error when the last process has ended
            while text := os.read(self._keyboard, 4096):
                log.write(text)
                log.flush()

    def _signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, number)

    def _clear(self) -> list[str]:
        """Waits until all processes of the terminal have ended, kills the others and returns their commands."""
        _wait(lambda: not self._processes(), SOON_S)
        left = self._processes()
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._process.wait(SOON_S)
        self._shown.join(SOON_S)
        os.close(self._keyboard)
        return list(left.values())

    def _processes(self) -> dict[int, str]:
        found = {}
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error):  # it has just ended, or is another user's
                if process.environ().get(MARK) == self._mark:
                    found[process.pid] = shlex.join(process.cmdline())
        return found


def _wait(condition: Callable[[], bool], seconds: float) -> bool:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(POLL_S)
    return True
