"""Runs tests on a copy of the tree: once with coverage, then once for each mutant."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from coverage.numbits import numbits_to_nums, register_sqlite_functions

from tools.mutate import plugin
from tools.mutate.places import Place

GOLDEN = "tests/test_golden.py"
MARKS = "not (real or long)"
SOURCED = (
    'command=("$@"); set --; [ ! -d devel ] || . devel/setup.bash; PYTHONPATH="$PYTHONPATH:$0" exec "${command[@]}"'
)
UNSOURCED = ("ROS", "PYTHONPATH", "CMAKE_PREFIX_PATH", "LD_LIBRARY_PATH", "PKG_CONFIG_PATH")
START_S, PATIENCE = 60.0, 4.0
"""A trial may take as long as pytest needs to start, and this many times the recorded duration of its tests."""


@dataclass(frozen=True)
class Covering:
    """The tests that reach a place, and the sum of their durations [s]: file by file, those of the package first."""

    tests: list[str]
    duration: float


class Trials:
    """The copy of a tree's last commit with its build, and what is known about its tests.

    Args:
        root: the tree.
        folder: the copy and the records; they are used again if they are of the same commit.
        tests: files and folders with tests.
    """

    def __init__(self, root: Path, folder: Path, tests: list[str]) -> None:
        self._tree, self._folder, self._tests = folder / "tree", folder, tests
        commit = _git(root, "rev-parse", "HEAD").strip()
        stamp = folder / "commit"
        if not (stamp.is_file() and stamp.read_text() == commit):
            shutil.rmtree(self._tree, ignore_errors=True)
            self._tree.mkdir(parents=True)
            archive = ["git", "-C", str(root), "archive", commit]
            files = subprocess.run(archive, check=True, capture_output=True).stdout
            subprocess.run(["tar", "-x", "-C", str(self._tree)], input=files, check=True)
            self._copy_build(root)
            (folder / "times.json").unlink(missing_ok=True)
            stamp.write_text(commit)
        shutil.copy(plugin.__file__, folder / "mutate_plugin.py")  # an older tree may have none
        self.commit = commit

    def _copy_build(self, root: Path) -> None:
        """Copies the built workspace, whose files name the folder that they are in; links the environment and data."""
        for file in (root / "devel").rglob("*"):
            if file.is_file() and file.suffix != ".pyc":
                copy, data = self._tree / file.relative_to(root), file.read_bytes()
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(file, copy)
                for name in ("src", "devel"):
                    data = data.replace(f"{root}/{name}".encode(), f"{self._tree}/{name}".encode())
                copy.write_bytes(data)
        for link, target in ((self._tree / ".venv", root / ".venv"), (self._folder / "shared", root.parent / "shared")):
            link.unlink(missing_ok=True)
            link.symlink_to(target)

    def files(self) -> list[str]:
        """Returns the sources of the packages in the copy."""
        return sorted(str(path.relative_to(self._tree)) for path in self._tree.glob("src/**/src/*/**/*.py"))

    def source(self, file: str) -> str:
        """Returns the text of a file of the copy."""
        return (self._tree / file).read_text()

    def record_coverage(self) -> None:
        """Runs all tests that compute or are in virtual time with coverage, unless this was done before."""
        if (self._folder / "times.json").is_file():
            return
        settings = self._folder / "coverage.ini"
        settings.write_text(f"[run]\ndata_file = {self._folder / 'coverage.db'}\nsource = src\nomit = */tests/*\n")
        (self._folder / "coverage.db").unlink(missing_ok=True)
        command = [sys.executable, "-m", "coverage", "run", f"--rcfile={settings}", "-m"]
        times = self._folder / "times.partial"
        self._pytest([*command, *_pytest(*self._tests)], {plugin.TIMES: str(times)}, None)
        times.rename(self._folder / "times.json")

    def covering(self, limit: float) -> CoverageTable:
        """Returns what tells the tests of a place; more than `limit` seconds of tests are not run for one."""
        return CoverageTable(self._folder, self._tree, limit)

    def is_found(self, place: Place, covering: Covering) -> bool:
        """Returns whether a test fails on the mutant, or takes too long."""
        file = self._tree / place.file
        source = file.read_text()
        (self._folder / "tests.json").write_text(json.dumps(covering.tests))
        files = sorted({_file(test) for test in covering.tests})
        try:
            file.write_text(place.mutated(source))
            self._forget_compiled(file)
            shutil.rmtree(self._tree / ".hypothesis", ignore_errors=True)
            code = self._pytest(
                [sys.executable, "-m", *_pytest("-x", *files)],
                {plugin.LIST: str(self._folder / "tests.json")},
                START_S + PATIENCE * covering.duration,
            )
        finally:
            file.write_text(source)
            self._forget_compiled(file)
        return code not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)

    def _pytest(self, command: list[str], environment: dict[str, str], timeout: float | None) -> int:
        kept = {name: value for name, value in os.environ.items() if not name.startswith(UNSOURCED)}
        with open(self._folder / "pytest.log", "wb") as log:
            process = subprocess.Popen(
                ["bash", "-c", SOURCED, str(self._folder), *command],
                cwd=self._tree,
                env={**kept, **environment},
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
            try:
                return process.wait(timeout)
            except subprocess.TimeoutExpired:
                return -1
            finally:
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)
                    process.wait()

    def _forget_compiled(self, file: Path) -> None:
        Path(importlib.util.cache_from_source(str(file))).unlink(missing_ok=True)


class CoverageTable:
    """The tests that cover a line, read from coverage.py's database."""

    def __init__(self, folder: Path, tree: Path, limit: float) -> None:
        self._tree, self._limit = tree, limit
        self._times: dict[str, float] = json.loads((folder / "times.json").read_text())
        self._order = {test: i for i, test in enumerate(self._times)}
        self._lines: dict[str, set[int]] = {}
        self._database = sqlite3.connect(folder / "coverage.db")
        register_sqlite_functions(self._database)

    def reaches(self, place: Place) -> bool:
        """Returns whether the line of a place runs at all."""
        if place.file not in self._lines:
            query = "SELECT numbits FROM line_bits JOIN file ON file.id = file_id WHERE path = ?"
            rows = self._database.execute(query, [str(self._tree / place.file)])
            self._lines[place.file] = {line for (bits,) in rows for line in numbits_to_nums(bits)}
        return place.line in self._lines[place.file]

    def of(self, place: Place, lines: dict[str, set[int]] | None = None) -> Covering:
        """Returns the tests of a place, or of lines by their files.

        What runs when the module is imported, such as a constant, belongs to no test or to the first one: then those
        of the whole file are taken. Those of a file of parameters are the tests of its package, and the golden ones.
        """
        if lines is None:
            lines = {place.file: {place.line}} if place.function else {}
        found = set().union(*(self._tests(file, line) for file, numbers in lines.items() for line in numbers))
        own = re.split("/src/|/config/", place.file)[0] + "/tests/"
        if place.file.endswith(".yaml"):
            found = {test for test in self._times if test.startswith((own, GOLDEN))}
        found = found or self._tests(place.file, None)
        tests: list[str] = []
        duration = 0.0
        for test in sorted(found & self._times.keys(), key=lambda name: (not name.startswith(own), self._times[name])):
            if tests and duration + self._times[test] > self._limit:
                break
            tests.append(test)
            duration += self._times[test]
        of_file: dict[str, float] = {}
        for test in tests:
            of_file[_file(test)] = of_file.get(_file(test), 0.0) + self._times[test]
        tests.sort(key=lambda test: (not test.startswith(own), of_file[_file(test)], self._order[test]))
        return Covering(tests, duration)

    def _tests(self, file: str, line: int | None) -> set[str]:
        condition = "" if line is None else "AND num_in_numbits(?, line_bits.numbits)"
        query = (
            "SELECT DISTINCT context.context FROM line_bits JOIN file ON file.id = line_bits.file_id "
            f"JOIN context ON context.id = line_bits.context_id WHERE file.path = ? {condition}"
        )
        values = (str(self._tree / file), *(() if line is None else (line,)))
        return {name for (name,) in self._database.execute(query, values) if name}


def _file(test: str) -> str:
    return test.split("::")[0]


def _pytest(*arguments: str) -> list[str]:
    return ["pytest", "-q", "-p", "mutate_plugin", "-p", "no:cacheprovider", "-m", MARKS, *arguments]


def _git(root: Path, *arguments: str) -> str:
    return subprocess.run(["git", "-C", str(root), *arguments], check=True, capture_output=True, text=True).stdout
