"""The whole simulated rig beside other work: a program that fills one processor, and RViz with the camera."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator

from bench.bench_demo import GOALS, DemoRun, run_demo
from bench.measure import BenchError, Goal, Row, number

BUSY = (sys.executable, "-c", "while True: pass")
SCREEN = ("-screen", "0", "1280x1024x24", "-nolisten", "tcp")
SCREEN_S = 10.0
BUSY_GOAL = Goal(None, 25.0)
STAGE = next(iter(GOALS))


def rows(quick: bool) -> list[Row]:
    """Returns how often the stream was lost, and the delay from a frame to the goal, under each load.

    Raises:
        BenchError: a demo did not run to its end, or there is no virtual screen.
    """
    table = _rows("busy core", run_demo(4 if quick else 22, beside=[BUSY]), "one process that computes without end")
    with virtual_screen() as display:
        table += _rows(
            "RViz", run_demo(4 if quick else 52, display=display), "RViz, panel and camera, drawn by software"
        )
    return table


def _rows(name: str, run: DemoRun, what: str) -> list[Row]:
    how = f"beside a demo of {run.report['duration_s']:.0f} s: {what}"
    delay = run.report["delay_ms"][STAGE]
    return [
        number(f"{name}: streams lost", run.lost, "", how, Goal(0.0)),
        Row(f"{name}: frame to goal on the wire", delay["p50"], delay["p99"], "ms", how, BUSY_GOAL),
        number(f"{name}: CPU, the rig", run.busy, "%", how),
        number(f"{name}: real-time factor", run.report["real_time_factor"], "", how, Goal(1.0, at_least=True)),
    ]


@contextlib.contextmanager
def virtual_screen() -> Iterator[str]:
    """Runs Xvfb on a free display; yields the display's name."""
    if shutil.which("Xvfb") is None:
        raise BenchError("There is no virtual screen: install xvfb.")
    process = subprocess.Popen(
        ["Xvfb", "-displayfd", "1", *SCREEN], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    try:
        number_ = process.stdout.readline().strip()
        if not number_:
            raise BenchError("The virtual screen did not start.")
        time.sleep(0.2)
        yield f":{number_}"
    finally:
        process.terminate()
        process.wait(SCREEN_S)
        process.stdout.close()
