#!/usr/bin/env python3
"""`python -m bench.compare OLD NEW`: two files of `make bench JSON=FILE` side by side, with the ratios of medians."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

from bench.measure import aligned, text
from bench.run import headline

HEAD = ("measure", "old", "new", "ratio", "old p99", "new p99", "unit")


def main(argv: list[str] | None = None) -> int:
    """Prints the table; returns 0, or 2 if a file is not one of figures."""
    argv = sys.argv[1:] if argv is None else argv
    if len(argv) != 2:
        print("usage: python -m bench.compare OLD NEW   (files of `make bench JSON=FILE`)", file=sys.stderr)
        return 2
    try:
        old, new = (_read(Path(name)) for name in argv)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        print(f"bench: cannot read the figures: {error}", file=sys.stderr)
        return 2
    for name, result in zip(("old", "new"), (old, new)):
        print(f"{name}: {headline(result)}")
    print("\n".join(aligned([HEAD, *compared(old["rows"], new["rows"])], right=(1, 2, 3, 4, 5))))
    return 0


def compared(old: list[dict], new: list[dict]) -> list[tuple[str, ...]]:
    """Returns the lines of the measures of both, in the order of the new ones, then of those that only one has."""
    before = {row["what"]: row for row in old}
    lines = []
    for row in new:
        was = before.pop(row["what"], {"median": None, "p99": None})
        a, b = was["median"], row["median"]
        ratio = f"{b / a:.2f}" if a and b is not None else ""
        lines.append((row["what"], text(a), text(b), ratio, text(was["p99"]), text(row["p99"]), row["unit"]))
    lines += [(r["what"], text(r["median"]), "-", "", text(r["p99"]), "-", r["unit"]) for r in before.values()]
    return lines


def _read(path: Path) -> dict:
    result = json.loads(path.read_text())
    headline(result)
    for row in result["rows"]:
        numbers = [number for number in (row["median"], row["p99"]) if number is not None]
        if not all(map(math.isfinite, numbers)) or {type(row["what"]), type(row["unit"])} != {str}:
            raise ValueError(f"{path} has the row {row}")
    return result


if __name__ == "__main__":
    sys.exit(main())
