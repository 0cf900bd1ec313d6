#!/usr/bin/env python3
"""`make bench`: measures speed on this machine and prints one table; of all benchmarks as JSON to build/bench.json too.

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
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NAMES = ("kinematics", "control", "leap", "client", "lag", "shaping", "grasping", "demo")


def main(argv: list[str] | None = None) -> int:
    """Runs the benchmarks; returns 0, 1 if one of them could not run, 2 if none can."""
    parser = argparse.ArgumentParser(prog="run.py", description="Measures speed on this machine.")
    parser.add_argument("--only", choices=NAMES, action="append", help="this one; may be given more than once")
    parser.add_argument("--quick", action="store_true", help="few samples: shows that it runs, not how fast")
    arguments = parser.parse_args(argv)
    if importlib.util.find_spec("common") is None:
        print("bench: the workspace is not sourced; use `make bench`, or source devel/setup.bash", file=sys.stderr)
        return 2
    from bench.measure import text
    from common.errors import RigError

    machine = {
        "machine": f"{_processor()}, {os.cpu_count()} CPUs, Python {platform.python_version()}",
        "load_before": os.getloadavg()[0],
        "quick": arguments.quick,
    }
    rows, failed = [], []
    for name in arguments.only or NAMES:
        print(f"bench: {name}", file=sys.stderr, flush=True)
        try:
            rows += importlib.import_module(f"bench.bench_{name}").rows(arguments.quick)
        except (RigError, ImportError, OSError) as error:
            failed.append(f"{name}: {error}")
    machine["load_after"] = os.getloadavg()[0]

    lines = [("what", "median", "p99", "unit", "how")]
    lines += [(r.what, text(r.median), text(r.p99), r.unit, r.how) for r in rows]
    wide = [max(len(line[i]) for line in lines) for i in range(4)]
    print(f"{machine['machine']}, load {machine['load_before']:.1f} before and {machine['load_after']:.1f} after")
    for what, median, p99, unit, how in lines:
        print(f"{what:<{wide[0]}}  {median:>{wide[1]}}  {p99:>{wide[2]}}  {unit:<{wide[3]}}  {how}")
    for sentence in failed:
        print(f"NOT RUN  {sentence}")
    if not arguments.only:
        (ROOT / "build").mkdir(exist_ok=True)
        result = {**machine, "rows": [dataclasses.asdict(r) for r in rows], "not_run": failed}
        (ROOT / "build" / "bench.json").write_text(json.dumps(result, indent=2) + "\n")
    return 1 if failed else 0


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


if __name__ == "__main__":
    sys.path[0] = str(ROOT)  # bench is a package there
    sys.exit(main())
