"""`python -m tools.mutate`: plants faults with cosmic-ray and prints which ones a package's own tests do not find.

It works on a copy of the last commit with the tests without real time, and can be interrupted: the next call goes on.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import sqlite3
import subprocess
import sys
import venv
from collections import Counter
from pathlib import Path

from tools.options import number

ROOT = Path(__file__).parents[1]
TOOL = "cosmic-ray==8.3.15"  # the last release for Python 3.8
LEFT_OUT = {"tests", "scripts", "lab"}
"""Folders of tests, and the programs of the laboratory."""

OPERATORS = (
    *(f"ReplaceComparisonOperator_{a}_{b}" for a in ("Lt", "LtE", "Gt", "GtE") for b in ("Lt", "LtE", "Gt", "GtE")),
    *("ReplaceBinaryOperator_Add_Sub", "ReplaceBinaryOperator_Sub_Add", "ReplaceBinaryOperator_Mul_Div"),
    *("AddNot", "NumberReplacer", "ReplaceAndWithOr", "ReplaceOrWithAnd", "ReplaceUnaryOperator_Delete_USub"),
    *("ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceBreakWithContinue"),
)
LIMIT_S = 900.0
"""The longest tests of one fault [s]."""

TESTS = r"""
. devel/setup.bash
file=$(git diff --name-only | head -n 1)
exec .venv/bin/python -m pytest -x -q -p no:cacheprovider -m "not (real or long)" \
  "${file%/src/*}/tests" tests/test_golden.py
"""


def main(argv: list[str] | None = None) -> int:
    """Chooses places, tries each, and prints the table."""
    parser = argparse.ArgumentParser(prog="python -m tools.mutate", description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=number(1, 100_000, int), default=100, help="number of faults (default: 100)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the choice (default: 0)")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "mutants", help="copy of the tree, and results")
    parser.add_argument("--only", default="", metavar="FOLDER", help="a part of the source, such as src/leap_kuka")
    options = parser.parse_args(argv)
    folder = options.folder.resolve()
    commit = _git(ROOT, "rev-parse", "HEAD").strip()
    session, tree, begun = folder / "session.sqlite", folder / "tree", folder / "begun"
    asked = f"{commit} {options.count} {options.seed} {options.only}"
    if not begun.is_file() or begun.read_text() != asked:
        shutil.rmtree(folder, ignore_errors=True)
        copy_of_the_tree(tree, commit)
        (folder / "tests.sh").write_text(TESTS)
        venv.create(folder / "venv", with_pip=True)
        subprocess.run([folder / "venv" / "bin" / "pip", "install", "-q", TOOL], check=True)
        (folder / "config.toml").write_text(configuration(sources(tree, options.only), folder / "tests.sh"))
        _cosmic_ray(folder, "init")
        keep_some(session, options.count, options.seed)
        begun.write_text(asked)
    _cosmic_ray(folder, "exec")
    print(report(session))
    return 0


def copy_of_the_tree(tree: Path, commit: str) -> None:
    """Copies a commit and the build, whose files name the folder that they are in."""
    tree.mkdir(parents=True)
    files = subprocess.run(["git", "-C", ROOT, "archive", commit], check=True, capture_output=True).stdout
    subprocess.run(["tar", "-x", "-C", tree], input=files, check=True)
    for file in (ROOT / "devel").rglob("*"):
        if file.is_file() and file.suffix != ".pyc":
            copy, data = tree / file.relative_to(ROOT), file.read_bytes()
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(file, copy)
            for name in ("src", "devel"):
                data = data.replace(f"{ROOT}/{name}".encode(), f"{tree}/{name}".encode())
            copy.write_bytes(data)
    (tree / ".venv").symlink_to(ROOT / ".venv")
    (tree.parent / "shared").symlink_to(ROOT.parent / "shared")
    _git(tree, "init", "-q")  # which tells the tests what file has the fault
    _git(tree, "add", "src")


def sources(tree: Path, only: str) -> list[str]:
    """Returns the modules of the packages in a tree, below `only`."""
    files = (path.relative_to(tree) for path in tree.glob("src/**/src/*/**/*.py"))
    return sorted(str(file) for file in files if str(file).startswith(only) and not LEFT_OUT & {*file.parts})


def configuration(files: list[str], tests: Path) -> str:
    """Returns the configuration of cosmic-ray."""
    settings = {"module-path": files, "timeout": LIMIT_S, "excluded-modules": [], "test-command": f"bash '{tests}'"}
    lines = [f"{name} = {json.dumps(value)}" for name, value in settings.items()]
    return "\n".join(["[cosmic-ray]", *lines, "[cosmic-ray.distributor]", 'name = "local"', ""])


def keep_some(session: Path, count: int, seed: int) -> None:
    """Leaves `count` faults in a session, each in another line."""
    with sqlite3.connect(session) as database:
        rows = database.execute("SELECT job_id, operator_name, module_path, start_pos_row FROM mutation_specs")
        lines: dict[tuple[str, int], list[str]] = {}
        for job, operator, file, line in rows:
            if operator.split("/")[-1] in OPERATORS:
                lines.setdefault((file, line), []).append(job)
        chance = random.Random(seed)
        kept = [chance.choice(lines[line]) for line in chance.sample(sorted(lines), min(count, len(lines)))]
        database.execute("CREATE TEMP TABLE kept (job_id)")
        database.executemany("INSERT INTO kept VALUES (?)", [(job,) for job in kept])
        for table in ("mutation_specs", "work_items"):
            database.execute(f"DELETE FROM {table} WHERE job_id NOT IN (SELECT job_id FROM kept)")


def report(session: Path) -> str:
    """Returns the faults that no test found, and how many were found by package."""
    with sqlite3.connect(session) as database:
        rows = list(
            database.execute(
                "SELECT module_path, start_pos_row, test_outcome, worker_outcome, diff "
                "FROM mutation_specs JOIN work_results USING (job_id) ORDER BY module_path, start_pos_row"
            )
        )
    total: Counter[str] = Counter()
    found: Counter[str] = Counter()
    lines = []
    for file, line, outcome, _, diff in rows:
        package = file.split("/src/")[0].rpartition("/")[2]
        total[package] += 1
        found[package] += outcome != "SURVIVED"
        if outcome == "SURVIVED":
            changed = [text for text in diff.splitlines() if text[:1] in "+-" and text[:3] not in ("+++", "---")]
            lines.append(f"{file}:{line}\n    " + "\n    ".join(changed))
    lines += [f"{name:18}{found[name]:4} of {total[name]:3} found" for name in sorted(total)]
    return "\n".join([*lines, f"{sum(found.values())} of {len(rows)} faults found"])


def _cosmic_ray(folder: Path, command: str) -> None:
    program = folder / "venv" / "bin" / "cosmic-ray"
    subprocess.run(
        [program, command, folder / "config.toml", folder / "session.sqlite"], cwd=folder / "tree", check=True
    )


def _git(root: Path, *arguments: str) -> str:
    return subprocess.run(["git", "-C", root, *arguments], check=True, capture_output=True, text=True).stdout


if __name__ == "__main__":
    sys.exit(main())
