#!/usr/bin/env python3
"""`make fuzz MINUTES=60`: tests/test_fuzz.py tries new inputs on every target, each for its share of the time, and
tests/test_fuzz_rig.py random messages and calls on the rig.

pytest shows a finding with its smallest input, which hypothesis keeps in .hypothesis, and names a target whose process
died or hung. Exit code 1 if anything was found.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.extend([str(ROOT), *(str(setup.parent / "src") for setup in sorted(ROOT.glob("src/**/setup.py")))])

from fuzz.targets import TARGETS  # noqa: E402 - needs the path above
from tools.options import number  # noqa: E402

INTERRUPTED = 130  # exit code after Ctrl-C or SIGTERM
MINUTES = number(0.01, 100_000.0)
HANGS_S = 600.0
"""Real time after which an input hangs [s]."""


def main(argv: list[str] | None = None) -> int:
    """Fuzzes; returns 1 if something was found."""
    parser = argparse.ArgumentParser(prog="fuzz", description="Input that nobody meant, for every parser and border.")
    parser.add_argument("--minutes", type=MINUTES, default=60.0, help="of processor time, all targets together")
    parser.add_argument("--only", nargs="*", choices=TARGETS, default=[], metavar="TARGET", help=", ".join(TARGETS))
    options = parser.parse_args(argv)
    names = options.only or [name for name, t in TARGETS.items() if not t.ros or "ROS_PACKAGE_PATH" in os.environ]
    share = 60.0 * options.minutes / len(names)
    # One worker of xdist: if it dies, the target is named and the next one has a new worker.
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-n",
        "1",
        "-v",
        "--timeout-method=thread",
        "--timeout",
        str(8 * share + HANGS_S),
    ]
    tests = [f"tests/test_fuzz.py::test_nothing_is_found[{name}]" for name in names]
    tests += [] if options.only or "ROS_PACKAGE_PATH" not in os.environ else ["tests/test_fuzz_rig.py"]
    changes = {"FUZZ_SECONDS": str(share), "HYPOTHESIS_SEARCH": "1"}
    try:
        return subprocess.run([*command, *tests], cwd=ROOT, env={**os.environ, **changes}, check=False).returncode
    except KeyboardInterrupt:
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
