"""Tells what a stored trace of a row saw, in the order of time: `python -m campaign.story FILE`; see run --traces."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from campaign.judge import REST


def story(seen: dict) -> list[str]:
    """Returns the lines; times count from the fault [s]."""
    fault, steps = seen["fault"], np.array(seen["steps"])
    lines = [(when, f"{who}: {text}") for when, who, text in seen["said"]]
    lines += [(when, f"the arm {text}") for when, text in seen["events"]]
    lines += [(seen[name], f"--- {name} ---") for name in ("fault", "mended", "operator", "end") if seen[name]]
    before = None
    for when, mode, on in seen["statuses"]:
        if (mode, on) != before:
            lines.append((when, f"mode {mode}, control {'on' if on else 'off'}"))
        before = (mode, on)
    if len(steps):
        moves = np.max(np.abs(steps[:, 8:15]), axis=1) > REST
        for i in np.flatnonzero(np.diff(moves.astype(int))):
            lines.append((steps[i + 1, 0], "the arm moves" if moves[i + 1] else "the arm rests"))
    return [f"{when - fault:8.3f} {text}" for when, text in sorted(lines)]


def main(argv: list[str] | None = None) -> None:
    """Tells the story of a file."""
    parser = argparse.ArgumentParser(prog="python -m campaign.story", description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, help="row_N.json of a folder that run --traces wrote")
    file = parser.parse_args(argv).file
    try:
        print("\n".join(story(json.loads(file.read_text()))))
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        sys.exit(f"story: {file} is no trace of a row ({error}); python -m campaign.run --traces FOLDER writes them.")


if __name__ == "__main__":
    main()
