"""Runs once more, at the end, what failed and goes by the clock; counts it and prints its name.

A plugin of pytest notes the failures: `-p tools.second_try --failures FILE`; `python -m tools.second_try FILE` is the
second try. Other tests have none.
"""

from __future__ import annotations

import sys
from collections.abc import Generator, Sequence
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


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Says in each report whether the test goes by the clock."""
    report = yield
    report.timed = any(item.get_closest_marker(mark) for mark in TIMED)  # type: ignore[attr-defined]
    return report


class Failures:
    """Which tests failed; the run succeeds if each of them gets a second try."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._failed: dict[str, bool] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Notes a failure; a crashed worker says nothing of marks."""
        if report.failed:
            self._failed[report.nodeid] = getattr(report, "timed", False)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """A file that cannot be imported has no second try."""
        if report.failed:
            self._failed[report.nodeid] = False

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Writes the names."""
        with open(self._path, "a") as file:
            file.writelines(f"{name}\n" for name, timed in self._failed.items() if timed)
        whole = not (session.shouldfail or session.shouldstop)
        if session.exitstatus == pytest.ExitCode.TESTS_FAILED and whole and all(self._failed.values()):
            session.exitstatus = pytest.ExitCode.OK


class Passes:
    """The names of the tests that pass."""

    def __init__(self) -> None:
        self.names: set[str] = set()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Notes a test that has run and passed."""
        if report.when == "call" and report.passed:
            self.names.add(report.nodeid)


def main(arguments: Sequence[str]) -> int:
    """Returns the exit code of the second try; arguments: the file of names, then options of pytest."""
    path, *options = arguments
    names = list(dict.fromkeys(Path(path).read_text().splitlines()))
    if not names:
        return 0
    print(f"\nTests that go by the clock and failed: {len(names)}", *names, sep="\n  ")
    if len(names) > MOST:
        print(f"They are too many for a second try; at most {MOST} get one.")
        return 1
    print("Their second try, with no other tests beside them:", flush=True)
    passes = Passes()
    code = int(pytest.main([*options, *names], plugins=[passes]))
    left = [name for name in names if name not in passes.names]
    print(f"Second try: {len(names) - len(left)} passed, {len(left)} did not.", flush=True)
    return code or int(bool(left))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
