"""The second try: only for tests that go by the clock, once, alone, named and counted."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools import second_try

pytestmark = pytest.mark.clock

FAILS_FIRST = """
import pathlib, pytest
pytestmark = pytest.mark.{mark}
def test_fails_first():
    tried = pathlib.Path(__file__).with_suffix(".tried")
    before = tried.exists()
    tried.touch()
    assert before
"""
FAILS = "import pytest\npytestmark = pytest.mark.{mark}\ndef test_fails():\n    assert False\n"


@pytest.fixture
def project(tmp_path):
    """Runs files of tests beside one another and gives a second try; returns both exit codes and what the second said.

    Each file is a text with the mark of its tests.
    """

    def run(*files):
        (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers =\n  clock:\n  rig:\n  other:\n")
        names = []
        for i, (text, mark) in enumerate(files):
            names.append(f"test_{i}.py")
            (tmp_path / names[-1]).write_text(text.format(mark=mark))
        options = ["-p", "tools.second_try", "--failures", "failed", "-n", "2", *names]
        first = subprocess.run([sys.executable, "-m", "pytest", *options], cwd=tmp_path, env=environment())
        words = [sys.executable, "-m", "tools.second_try", "failed", "-v"]
        second = subprocess.run(words, cwd=tmp_path, env=environment(), capture_output=True, text=True)
        return first.returncode, second.returncode, second.stdout

    return run


def environment():
    paths = [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


@pytest.mark.parametrize("mark", sorted(second_try.TIMED))
def test_what_passes_alone_passes_and_is_named_and_counted(project, mark):
    first, second, said = project((FAILS_FIRST, mark), ("def test_passes():\n    pass\n", mark))
    assert (first, second) == (0, 0)
    assert "beside other tests: 1" in said and "test_fails_first" in said and "test_passes" not in said


def test_what_fails_alone_too_fails(project):
    first, second, said = project((FAILS_FIRST, "clock"), (FAILS, "clock"))
    assert (first, second) == (0, 1) and "beside other tests: 2" in said


def test_a_test_that_only_computes_has_no_second_try(project):
    first, second, said = project((FAILS_FIRST, "other"), (FAILS_FIRST, "clock"))
    assert (first, second) == (1, 0) and "beside other tests: 1" in said and "test_0.py" not in said


def test_a_test_that_kills_its_process_has_none(project):
    killed = "import os, pytest\n@pytest.mark.clock\ndef test_kills():\n    os._exit(1)\n"
    assert project((killed, "clock"))[0] == 1


def test_a_file_that_cannot_be_imported_has_none(project):
    assert project(("import nowhere\n", "clock"), (FAILS_FIRST, "clock"))[0] not in (0, 5)


def test_many_failures_have_none(project):
    many = "import pytest\n@pytest.mark.clock\n@pytest.mark.parametrize('i', range(21))\n"
    assert project((many + "def test_fails(i):\n    assert 0\n", "clock"))[1] == 1


def test_where_nothing_failed_nothing_is_said(project):
    assert project(("def test_passes():\n    pass\n", "clock")) == (0, 0, "")
