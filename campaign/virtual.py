"""`python -m campaign.virtual`: the rows in virtual time, each on a rig of its own; prints what came of each.

A seed makes one run, to the last bit: the order of ready threads, the delays of messages. With `--seeds 20` each row
runs with twenty. `--page` stores the reaction times with the first seed, which are exact, for the handbook's page and
for the tests. The exit code is 0 if no row failed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import conftest  # noqa: F401 - sets the path of the packages
from campaign import page, rows, run, trial
from campaign.judge import Verdict
from campaign.trial import Row
from simulated.graph import Graph
from simulated.rig import VirtualRig
from tools.options import number


def judged(entry: Row, seed: int = 0, traces: Path | None = None) -> Verdict:
    """Runs a row and returns its verdict; stores what was seen in the folder `traces`."""
    with Graph(seed) as graph, VirtualRig(graph, entry.variant) as rig:
        rig.calm()
        return trial.run(rig, entry, traces)


def main(argv: list[str] | None = None) -> int:
    """Runs rows; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m campaign.virtual", description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="numbers of rows, such as 14,33 or 1-15; or `dangerous`")
    parser.add_argument("--seeds", type=number(1, 1000, int), default=1, help="how many seeds each row runs with")
    parser.add_argument("--page", action="store_true", help="store the reaction times and make the handbook's page")
    options = parser.parse_args(argv)
    failed = False
    for entry in run.chosen(rows.load(), options.only):
        if entry.real:
            print(f"{entry.number:>10} runs on the real rig only: {entry.real}", flush=True)
            continue
        for seed in range(options.seeds):
            verdict = judged(entry, seed)
            failed |= verdict.result != "passed"
            print(f"seed {seed}: {page.line(entry, vars(verdict))}", flush=True)
            if options.page and seed == 0:
                run.store({}, {str(entry.number): verdict.reaction_s})
    return int(failed)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(run.INTERRUPTED)
