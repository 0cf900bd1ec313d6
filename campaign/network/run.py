"""`make networks`: the rig on bad links, cell by cell, on two rigs; a line as each cell ends, JSON, the page."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys

import conftest  # noqa: F401 - sets the path of the packages
from campaign.network import cells
from campaign.network.wire import ROOT, in_own_network
from campaign.run import INTERRUPTED, exit_code, ran
from tools.options import new_file, number

RESULTS, PAGE = ROOT / "docs" / "bad-networks.json", ROOT / "docs" / "reference" / "bad-networks.md"


def main(argv: list[str] | None = None) -> int:
    """Runs the cells; returns the exit code, 0 if none failed."""
    parser = argparse.ArgumentParser(prog="python -m campaign.network.run", description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="cells, wires or conditions, such as arm:loss_5, leap, rate_256")
    parser.add_argument("--rigs", type=number(1, 16, int), default=2, help="how many rigs run at once")
    parser.add_argument("--json", type=new_file, help="file for the results")
    parser.add_argument("--page", action="store_true", help="store the results and make the handbook's page from them")
    options = parser.parse_args(argv)
    entries = cells.chosen(options.only)
    device = [sys.executable, "-c", "from campaign.network.wire import Wire; Wire('arm').close()"]
    if subprocess.run(in_own_network(device), cwd=ROOT, capture_output=True).returncode:
        print("This machine lets nobody make a network device (/dev/net/tun, unshare --net): nothing was measured.")
        return 1

    def take(cell: cells.Cell, result: dict) -> None:
        if options.page:
            store({cell.number: result})

    results = ran(entries, options.rigs, lambda cell, result: cells.line(cell.number, result), take)
    if results is None:
        return INTERRUPTED
    print("\n" + "\n".join(cells.line(name, results[name]) for name in cells.CELLS if name in results))
    return exit_code(results, options.json, cells.as_json(results))


def store(results: dict[str, dict]) -> None:
    """Adds results to the stored ones and makes the handbook's page from all."""
    stored = {**(json.loads(RESULTS.read_text()) if RESULTS.exists() else {}), **results}
    RESULTS.write_text(cells.as_json(stored))
    PAGE.write_text(cells.page(json.loads(RESULTS.read_text())))


if __name__ == "__main__":
    sys.exit(main())
