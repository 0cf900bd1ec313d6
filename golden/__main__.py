"""`make golden`: renews what is stored where a new trace differs, and draws both for a person to judge."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from golden.chain import PureChain, World
from golden.picture import draw
from golden.runs import RUNS, Missing
from golden.stored import TOLERANCE, TOLERANCES, Stored, differences, stored

PICTURES = Path(__file__).resolve().parents[1] / "build" / "golden"


def main(argv: list[str] | None = None) -> None:
    argparse.ArgumentParser(prog="python -m golden", description=__doc__).parse_args(argv)
    try:
        renew()
    except KeyboardInterrupt:
        print("\nInterrupted; what was not named is as it was.")
        sys.exit(130)


def renew() -> None:
    for name, make in RUNS.items():
        try:
            new = stored(PureChain(World(make())).run())
        except Missing as missing:
            print(missing)
            continue
        old = Stored.read(name)
        tolerance = TOLERANCES.get(name, TOLERANCE)
        sentences = differences(old, new, tolerance)
        if not sentences:
            print(f"{name}: as stored.")
            continue
        picture = PICTURES / f"{name}.png"
        draw(name, old, new, picture, tolerance)  # first: what nobody can look at is not renewed
        new.write(name)
        print("\n  ".join([f"{name}: renewed; look at {picture}", *sentences]))


if __name__ == "__main__":
    main()
