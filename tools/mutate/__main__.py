"""`python -m tools.mutate`: mutates places of the source and prints which mutants the tests without real time find.

It works on a copy of the last commit and can be interrupted: the next call with the same folder continues.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections import Counter
from dataclasses import asdict, fields
from pathlib import Path

from tools.mutate import places, times
from tools.mutate.places import Place
from tools.mutate.trials import CoverageTable, Trials
from tools.options import number

ROOT = Path(__file__).parents[2]
LEFT_OUT = {"tests", "scripts", "lab", "training", "evaluation"}
"""Folders with tests, and the programs of the laboratory."""


def main(argv: list[str] | None = None) -> int:
    """Chooses places, or finds saved ones again, tries each, and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--count", type=number(1, 100_000, int), default=100, help="number of places (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the choice (default: %(default)s)")
    parser.add_argument("--root", type=tree, default=ROOT, help="the tree to mutate (default: this one)")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "mutants", help="copy of the tree and records")
    parser.add_argument(
        "--places", type=result_file, help="result of another tree: its places are found again in this one"
    )
    parser.add_argument("--result", type=Path, help="JSON of the result (default: result.json in the folder)")
    parser.add_argument(
        "--limit", type=number(1.0, 86_400.0), default=120.0, help="longest tests of one place [s] (default: 120)"
    )
    parser.add_argument("--times", action="store_true", help="double and quadruple the times of times.py")
    parser.add_argument("--tests", nargs="+", default=["src", "tests"], help="files and folders (default: all)")
    arguments = parser.parse_args(argv)

    arguments.folder.mkdir(parents=True, exist_ok=True)
    trials = Trials(arguments.root.resolve(), arguments.folder.resolve(), arguments.tests)
    trials.record_coverage()
    table = trials.covering(arguments.limit)
    file = arguments.result or arguments.folder / ("times.result.json" if arguments.times else "result.json")
    result = json.loads(file.read_text()) if file.is_file() else {}
    if result.get("commit") != trials.commit:
        mutants = _times(trials) if arguments.times else _chosen(arguments, trials, table)
        result = {"commit": trials.commit, "seed": arguments.seed, "mutants": mutants}
    sources = {file: trials.source(file) for file in trials.files()}
    for mutant in result["mutants"]:
        if mutant["found"] is None:
            place, begin = _place(mutant), time.monotonic()
            covering = table.of(place, times.uses(place, sources) if arguments.times else None)
            mutant["found"] = bool(covering.tests) and trials.is_found(place, covering)
            mutant["tests"], mutant["seconds"] = len(covering.tests), round(time.monotonic() - begin, 1)
            file.write_text(json.dumps(result, indent=1))
            print(_row(mutant), flush=True)
    print(_table(result["mutants"]))
    return 0


def tree(text: str) -> Path:
    """The type of a tree of which git has a commit."""
    head = ["git", "-C", text, "rev-parse", "--verify", "--quiet", "HEAD"]
    if subprocess.run(head, capture_output=True).returncode:
        raise argparse.ArgumentTypeError(f"{text!r} is no tree with a commit of git")
    return Path(text)


def result_file(text: str) -> dict:
    """The type of an earlier result."""
    try:
        result = json.loads(Path(text).read_text())
        [_place(mutant) for mutant in result["mutants"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise argparse.ArgumentTypeError(f"{text!r} holds no result: {error!r}") from error
    return result


def _chosen(arguments: argparse.Namespace, trials: Trials, table: CoverageTable) -> list[dict]:
    candidates = []
    for file in map(Path, trials.files()):
        inner = file.parts[len(file.parts) - 1 - file.parts[::-1].index("src") + 1 :]
        if not LEFT_OUT & set(inner[1:-1]):
            found = places.find(trials.source(str(file)), inner[0], str(file))
            candidates += [place for place in found if table.reaches(place)]
    if arguments.places:
        saved = [_place(mutant) for mutant in arguments.places["mutants"]]
        chosen = places.find_again(saved, candidates, arguments.seed)
    else:
        chosen = [(place, True) for place in places.choose(candidates, arguments.count, arguments.seed)]
    return _untried(chosen)


def _times(trials: Trials) -> list[dict]:
    found = []
    for file, names in times.TIMES.items():
        path = f"src/{file}"
        package = path.split("/src/")[0].rpartition("/")[2]
        found += times.find(trials.source(path), package, path, names)
    return _untried([(place, True) for place in found])


def _untried(chosen: list[tuple[Place, bool]]) -> list[dict]:
    return [{**asdict(place), "same": same, "found": None, "tests": 0, "seconds": 0.0} for place, same in chosen]


def _place(mutant: dict) -> Place:
    return Place(**{field.name: mutant[field.name] for field in fields(Place)})


def _row(mutant: dict) -> str:
    outcome = "found" if mutant["found"] else "SURVIVED"
    change = f"{mutant['before']} -> {mutant['after']}".replace("\n", " ")
    where = f"{mutant['file']}:{mutant['line']}"
    return f"{outcome:9} {where} {mutant['operator']}: {change[:60]}  in  {mutant['statement'][:80]}"


def _table(mutants: list[dict]) -> str:
    """Returns the numbers of found mutants by package and by operator."""
    lines = []
    for key in ("package", "operator"):
        total = Counter(mutant[key] for mutant in mutants)
        found = Counter(mutant[key] for mutant in mutants if mutant["found"])
        lines += [f"{name:18}{found[name]:4} of {total[name]:3} found" for name in sorted(total)] + [""]
    same = sum(mutant["same"] for mutant in mutants)
    found = sum(mutant["found"] for mutant in mutants)
    return "\n".join([*lines, f"{found} of {len(mutants)} mutants found; {same} places are those that were asked for"])


if __name__ == "__main__":
    sys.exit(main())
