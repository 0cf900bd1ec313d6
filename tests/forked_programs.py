"""Runs programs by forks of a process that has imported their libraries, which is what takes their time: `make test`
tries 69 for 24 s of processor time so, for 53 s as processes of their own, which on a busy machine only import in 6 s.

    python forked_programs.py [--bare] < jobs.json > ends.json

With `--bare` each program imports its own, in its surroundings, as it does on its own.
A job has "script", "arguments", "environment", "folder", "log", "encoding", "user" and "seconds". An end is the exit
code, the negative number of the signal that ended the program, or null for one that still ran after so many seconds.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import runpy
import signal
import sys
import time
from pathlib import Path

import rosgraph.names

LIBRARIES = ("numpy", "scipy.optimize", "scipy.spatial", "cv2", "rospy", "tf2_ros", "actionlib", "roslaunch", "tqdm",
             "yaml", "matplotlib.pyplot", "python_qt_binding.QtWidgets", "torch", "visualization_msgs.msg",
             "sensor_msgs.msg", "diagnostic_msgs.msg", "rig_msgs.msg", "kuka_msgs.msg")  # fmt: skip
AT_ONCE = 10
POLL_S = 0.05


def fork(job: dict) -> int:
    """Starts the program of a job; returns its process."""
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        os.setsid()
        for stream, name in ((0, os.devnull), (1, job["log"]), (2, job["log"])):
            file = os.open(name, os.O_RDONLY if stream == 0 else os.O_WRONLY | os.O_APPEND)
            os.dup2(file, stream)
        sys.stdout.reconfigure(encoding=job["encoding"], errors="strict")
        os.environ.clear()
        os.environ.update(job["environment"])
        time.tzset()
        os.chdir(job["folder"])
        if not os.path.lexists(job["folder"]) or job["folder"].endswith("gone"):
            os.rmdir(job["folder"])
        if job["user"]:
            os.setgid(job["user"])
            os.setuid(job["user"])
        sys.argv = [job["script"], *job["arguments"]]
        sys.path.insert(0, str(Path(job["script"]).parent))
        if names := sys.modules.get("rospy.names"):  # which reads both as it is imported
            names._caller_namespace = rosgraph.names.get_ros_namespace()
            names._caller_id = f"{names._caller_namespace}unnamed"
            names.reload_mappings(sys.argv)
        runpy.run_path(job["script"], run_name="__main__")
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        with contextlib.suppress(Exception):
            import threading

            threading._shutdown()
            import atexit

            atexit._run_exitfuncs()
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code & 255)


def main() -> None:
    """Runs the jobs, some at once."""
    for name in () if "--bare" in sys.argv else LIBRARIES:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    jobs = json.load(sys.stdin)
    waiting, running, ends = list(enumerate(jobs)), {}, [None] * len(jobs)
    while waiting or running:
        while waiting and len(running) < AT_ONCE:
            number, job = waiting.pop(0)
            running[fork(job)] = number, time.monotonic() + job["seconds"]
        time.sleep(POLL_S)
        for pid, (number, until) in list(running.items()):
            ended, status = os.waitpid(pid, os.WNOHANG)
            if ended:
                ends[number] = os.WEXITSTATUS(status) if os.WIFEXITED(status) else -os.WTERMSIG(status)
            elif time.monotonic() < until:
                continue
            del running[pid]
            with contextlib.suppress(ProcessLookupError):
                os.killpg(pid, signal.SIGKILL)
            if not ended:
                os.waitpid(pid, 0)
    json.dump(ends, sys.stdout)


if __name__ == "__main__":
    main()
