"""The plugin of pytest that records which lines each test covers, and that runs a list of tests in its order."""

from __future__ import annotations

import json
import os
from pathlib import Path

import coverage
import pytest

LIST = "MUTATE_TESTS"  # environment variable: the file with the tests to run
TIMES = "MUTATE_TIMES"  # environment variable: the file for the times of the tests that passed


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keeps the tests of the list, in its order."""
    if LIST in os.environ:
        places = {name: i for i, name in enumerate(json.loads(Path(os.environ[LIST]).read_text()))}
        items[:] = sorted((item for item in items if item.nodeid in places), key=lambda item: places[item.nodeid])


def pytest_runtest_setup(item: pytest.Item) -> None:
    if TIMES in os.environ:
        running = coverage.Coverage.current()
        assert running is not None
        running.switch_context(item.nodeid)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.when == "setup" and report.passed:
        _set_up[report.nodeid] = report.duration
    if report.when == "call" and report.passed:
        _times[report.nodeid] = report.duration + _set_up[report.nodeid]


def pytest_sessionfinish() -> None:
    if TIMES in os.environ:
        Path(os.environ[TIMES]).write_text(json.dumps(_times))


_set_up: dict[str, float] = {}
_times: dict[str, float] = {}
