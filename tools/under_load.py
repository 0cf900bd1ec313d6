"""`python -m tools.under_load [--stops] COMMAND...`: runs a command beside eight busy processes.

With --stops one of its processes at a time stands still for 5 s, chosen at random. `make test` must pass so.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import psutil

BUSY, STOP_S, BETWEEN_S = 8, 5.0, 15.0


@contextlib.contextmanager
def load() -> Iterator[None]:
    """Keeps the processors busy."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(BUSY)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()


def workers(root: int) -> list[int]:
    """The Python programs below a process: pytest, and what it starts."""
    found = []
    first = psutil.Process(root)
    for process in (first, *first.children(recursive=True)):
        with contextlib.suppress(psutil.Error):  # it has just ended
            if any("python" in word for word in process.cmdline()):
                found.append(process.pid)
    return found


def main() -> int:
    """Returns the exit code of the command."""
    parser = argparse.ArgumentParser(prog="tools.under_load", description=__doc__)
    parser.add_argument("--stops", action="store_true", help="let processes of the command stand still now and then")
    parser.add_argument("program")
    parser.add_argument("arguments", nargs=argparse.REMAINDER)
    options = parser.parse_args()
    stops = 0
    with load():
        try:
            process = subprocess.Popen([options.program, *options.arguments])
        except OSError as error:
            parser.error(f"{options.program!r} does not start: {error.strerror}.")
        while options.stops and not _ends_within(process, random.uniform(0.0, 2.0 * BETWEEN_S)):
            for pid in random.sample(found := workers(process.pid), min(len(found), 1)):
                stops += _stop(pid)
        code = process.wait()
    if options.stops:
        print(f"{stops} stops of {STOP_S:g} s", flush=True)
    return code


def _ends_within(process: subprocess.Popen[bytes], seconds: float) -> bool:
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(seconds)
    return process.returncode is not None


def _stop(pid: int) -> bool:
    """Lets a process stand still for STOP_S; returns whether it was still there."""
    try:
        os.kill(pid, signal.SIGSTOP)
    except ProcessLookupError:
        return False
    try:
        time.sleep(STOP_S)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
    return True


if __name__ == "__main__":
    sys.exit(main())
