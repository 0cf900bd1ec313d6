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
PASSES = "import pytest\npytestmark = pytest.mark.{mark}\ndef test_passes():\n    pass\n"
FAILS = "import pytest\npytestmark = pytest.mark.{mark}\ndef test_fails():\n    assert False\n"


@pytest.fixture
def project(tmp_path):
    """Runs files of tests beside one another and gives a second try; returns both exit codes and what the second said.

    Each file is a text with the mark of its tests.
    """

    def run(*files, options=("-n", "2"), parts=1):
        (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers =\n  clock:\n  rig:\n  other:\n")
        names = []
        for i, (text, mark) in enumerate(files):
            names.append(f"test_{i}.py")
            (tmp_path / names[-1]).write_text(text.replace("{mark}", mark))
        codes = []
        for part in range(parts):
            words = ["-p", "tools.second_try", f"--failures={tmp_path / 'failed'}", *options, *names[part::parts]]
            codes.append(subprocess.run([sys.executable, "-m", "pytest", *words], cwd=tmp_path, env=environment()))
        words = [sys.executable, "-m", "tools.second_try", tmp_path / "failed", "-v"]
        second = subprocess.run(words, cwd=tmp_path, env=environment(), capture_output=True, text=True)
        return max(done.returncode for done in codes), second.returncode, second.stdout

    return run


def environment():
    paths = [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


@pytest.mark.parametrize("mark", sorted(second_try.TIMED))
def test_what_passes_alone_passes_and_is_named_and_counted(project, mark):
    first, second, said = project((FAILS_FIRST, mark), (PASSES, mark))
    assert (first, second) == (0, 0)
    assert "failed: 1" in said and "test_fails_first" in said and "test_passes" not in said and "0 did not" in said


def test_what_fails_again_fails(project):
    first, second, said = project((FAILS_FIRST, "clock"), (FAILS, "clock"))
    assert (first, second) == (0, 1) and "failed: 2" in said and "1 passed, 1 did not" in said


def test_it_tries_what_failed_in_any_part(project):
    first, second, said = project((FAILS_FIRST, "clock"), (FAILS_FIRST, "rig"), parts=2)
    assert (first, second) == (0, 0) and "failed: 2" in said


@pytest.mark.parametrize("mark", ["other", "parametrize('name', ['rig', 'clock'])"])
def test_a_test_that_only_computes_has_no_second_try(project, mark):
    text = FAILS_FIRST if mark == "other" else FAILS.replace("test_fails()", "test_fails(name)")
    first, second, said = project((text, mark), (FAILS_FIRST, "clock"))
    assert (first, second) == (1, 0) and "failed: 1" in said and "test_0.py" not in said


@pytest.mark.parametrize(
    "text",
    [
        "import os, pytest\n@pytest.mark.clock\ndef test_kills():\n    os._exit(1)\n",
        "import nowhere\n",
        "import pytest\n@pytest.mark.clock\ndef test_interrupts():\n    pytest.exit('now', 4)\n",
    ],
    ids=["kills its process", "cannot be imported", "ends all tests"],
)
def test_what_is_no_failure_of_a_test_has_none(project, text):
    assert project((text, "clock"), (FAILS_FIRST, "clock"))[0] not in (0, 5)


def test_a_run_that_a_failure_stops_is_not_whole(project):
    assert project((FAILS_FIRST, "clock"), (FAILS, "other"), options=("-x",))[0] == 1


def test_a_second_try_that_skips_is_none(project):
    text = FAILS_FIRST.replace("    tried.touch()", "    tried.touch()\n    if before: pytest.skip('now')")
    first, second, said = project((text, "clock"))
    assert (first, second) == (0, 1) and "0 passed, 1 did not" in said


@pytest.mark.parametrize(("count", "code"), [(20, 0), (21, 1)])
def test_many_failures_have_none(project, count, code):
    text = FAILS_FIRST.replace(
        "def test_fails_first():", f"@pytest.mark.parametrize('i', range({count}))\ndef test_a(i):"
    )
    text = text.replace("__file__).with_suffix(", "__file__).with_suffix(str(i) and f'.{i}' + ")
    assert project((text, "clock"))[:2] == (0, code)


@pytest.mark.parametrize("when", ["setup", "teardown"])
def test_a_fixture_may_fail_too(project, when):
    lines = {"setup": "    fails()\n    yield\n", "teardown": "    yield\n    fails()\n"}[when]
    text = FAILS_FIRST.replace("def test_fails_first", "def fails")
    text += f"@pytest.fixture\ndef made():\n{lines}def test_a(made):\n    pass\n"
    assert project((text, "clock"))[:2] == (0, 0)


def test_where_nothing_failed_nothing_is_said(project):
    assert project((PASSES, "clock")) == (0, 0, "")
