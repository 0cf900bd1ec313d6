"""Runs once more what failed beside other tests, alone, if it goes by the clock; counts it and prints its name.

A plugin of pytest notes the failures: `-p tools.second_try --failures FILE`; `python -m tools.second_try FILE` is the
second try. Other tests have none.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

TIMED = {"clock", "rig"}
"""Marks of tests that a busy machine may fail."""
MOST = 20
"""If more tests failed than this, no pause of the machine was the reason."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds the option --failures."""
    parser.addoption("--failures", type=Path, help="append the names of tests that get a second try to this file")


def pytest_configure(config: pytest.Config) -> None:
    """Notes failures in the process that prints them."""
    if config.getoption("--failures") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Failures(config.getoption("--failures")))


class Failures:
    """Which tests failed; the run succeeds if each of them gets a second try."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._failed: dict[str, bool] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Notes a failure; a crashed worker's has no marks."""
        if report.failed:
            self._failed[report.nodeid] = bool(TIMED & report.keywords.keys())

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """A file that cannot be imported has no second try."""
        if report.failed:
            self._failed[report.nodeid] = False

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Writes the names."""
        with open(self._path, "a") as file:
            file.writelines(f"{name}\n" for name, timed in self._failed.items() if timed)
        if session.exitstatus == pytest.ExitCode.TESTS_FAILED and all(self._failed.values()):
            session.exitstatus = pytest.ExitCode.OK


def main(arguments: Sequence[str]) -> int:
    """Returns the exit code of the second try; arguments: the file of names, then options of pytest."""
    path, *options = arguments
    names = list(dict.fromkeys(Path(path).read_text().splitlines()))
    if not names:
        return 0
    print(f"\nFailed beside other tests: {len(names)}, in all of which time passes.", *names, sep="\n  ")
    if len(names) > MOST:
        print(f"They are too many for a second try; at most {MOST} get one.")
        return 1
    print("Their second try, alone:", flush=True)
    code = subprocess.run([sys.executable, "-m", "pytest", *options, *names]).returncode
    print("All of them pass alone." if code == 0 else "They fail alone, too.", flush=True)
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
