"""A processor that many programs share with one of the rig."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from pathlib import Path


@contextlib.contextmanager
def burners(count: int, core: int):
    """So many processes that do nothing but calculate, all on one core."""
    work = f"import os\nos.sched_setaffinity(0, [{core}])\nwhile True: pass"
    running = [subprocess.Popen([sys.executable, "-c", work]) for _ in range(count)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


@contextlib.contextmanager
def bound(pid: int, core: int):
    """Binds all threads of a process to one core."""
    threads = {int(task.name): os.sched_getaffinity(int(task.name)) for task in Path(f"/proc/{pid}/task").iterdir()}
    for thread in threads:
        os.sched_setaffinity(thread, [core])
    try:
        yield
    finally:
        for thread, cores in threads.items():
            with contextlib.suppress(ProcessLookupError):
                os.sched_setaffinity(thread, cores)
