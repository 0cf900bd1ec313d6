#!/usr/bin/env python3
"""`make bench`: measures speed on this machine and prints one table, at most 100 columns wide.

Nothing here is a pass or a fail. Numbers compare within one run; on a busy machine read the medians.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import importlib.util
import json
import os
import platform
import signal
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the launch file of the controller, before numpy is loaded
INTERRUPTED = 130  # exit code after Ctrl-C or SIGTERM
NAMES = (
    "kinematics", "control", "leap", "filter", "client", "shaping", "stopping", "robot_stop", "contact", "compliance",
    "grasping", "policy", "vision", "demo", "views", "pictures",
)  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    """Runs the benchmarks; returns 0, 1 if one of them could not run, 2 if none can, 130 after Ctrl-C."""
    from tools.options import is_written, new_file

    parser = argparse.ArgumentParser(prog="run.py", description="Measures speed on this machine.")
    parser.add_argument("--only", choices=NAMES, action="append", help="this one; may be given more than once")
    parser.add_argument(
        "--json", type=new_file, metavar="FILE", help="write all figures there too, with how they were made"
    )
    parser.add_argument("--quick", action="store_true", help="few samples: shows that it runs, not how fast")
    arguments = parser.parse_args(argv)
    if importlib.util.find_spec("common") is None:
        print("bench: the workspace is not sourced; use `make bench`, or source devel/setup.bash", file=sys.stderr)
        return 2
    from bench.measure import HEAD, aligned, cells
    from common.errors import RigError

    result = {
        "machine": f"{_processor()}, {os.cpu_count()} CPUs, Python {platform.python_version()}",
        "date": time.strftime("%Y-%m-%d"),
        "quick": arguments.quick,
        "load_before": os.getloadavg()[0],
        "python_loop_ms": python_loop_ms(),
    }
    rows, failed, names, code = [], [], list(arguments.only or NAMES), 0
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    for i, name in enumerate(names):
        print(f"bench: {name}", file=sys.stderr, flush=True)
        try:
            rows += importlib.import_module(f"bench.bench_{name}").rows(arguments.quick)
        except (RigError, ImportError, OSError) as error:
            failed.append(f"{name}: {error}")
            code = 1
        except KeyboardInterrupt:
            failed.append(f"{', '.join(names[i:])}: interrupted")
            code = INTERRUPTED
            break
    result.update(load_after=os.getloadavg()[0], not_run=failed, rows=[dataclasses.asdict(row) for row in rows])

    print(headline(result))
    print("\n".join(aligned([HEAD, *map(cells, rows)], right=(1, 2, 6))))
    for sentence in failed:
        print(f"NOT RUN  {sentence}")
    kept = arguments.json is None or is_written(arguments.json, json.dumps(result, indent=2) + "\n")
    return code if kept else 1


def headline(result: dict) -> str:
    """Returns what the machine was."""
    return (
        f"{result['machine']}; a loop of a million additions takes {result['python_loop_ms']:.0f} ms; "
        f"load {result['load_before']:.1f} before, {result['load_after']:.1f} after"
    )


def python_loop_ms() -> float:
    """Returns how long a loop of a million additions takes [ms], which tells slow machines and hours from fast ones."""
    times = []
    for _ in range(5):
        begin, total = time.perf_counter(), 0
        for i in range(1_000_000):
            total += i
        times.append(1e3 * (time.perf_counter() - begin))
    return sorted(times)[2]


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


if __name__ == "__main__":
    sys.path[0] = str(ROOT)  # bench is a package there
    sys.exit(main())
