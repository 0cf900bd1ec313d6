"""`make test-long`: what takes hours and goes by the real clock, before a release. Runs each part, also after one that
failed, and prints a table of them at the end; it belongs into the changelog."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
PARTS = {
    "laws, ten times the examples": ["env", "HYPOTHESIS_TIMES=10", "make", "test-fast"],
    "make test, beside eight busy processes": [sys.executable, "-m", "tools.under_load", "--stops", "make", "test"],
    "make ros2": ["make", "ros2"],
    "tests marked `long`": ["tools/test.sh", "--long"],
    "make networks": ["make", "networks"],
    "make fuzz": ["make", "fuzz", "MINUTES=20"],
    "make soak": ["make", "soak", "HOURS=1"],
    "python -m tools.mutate": [sys.executable, "-m", "tools.mutate"],
}


def main(parts: dict[str, list[str]]) -> int:
    """Runs the parts; returns 1 if one failed."""
    rows = []
    for name, command in parts.items():
        print(f"\n=== {name} ===", flush=True)
        began = time.monotonic()
        code = subprocess.run(command, cwd=ROOT, check=False).returncode
        rows.append((name, "passed" if code == 0 else f"failed ({code})", (time.monotonic() - began) / 60.0))
    print("\n| part | result | min |\n|---|---|---|")
    for name, result, minutes in rows:
        print(f"| {name} | {result} | {minutes:.0f} |")
    return int(any(result != "passed" for _, result, _ in rows))


if __name__ == "__main__":
    sys.exit(main(PARTS))
