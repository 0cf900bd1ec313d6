"""The option --clock-files leaves out no test that goes by the clock or starts nodes."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
HELPERS = """
import pytest

@pytest.fixture
def indirect(wait_until):
    pass
"""


@pytest.fixture
def collected(tmp_path):
    """Collects files, given as texts by their names; returns the exit code, and the names of the tests or the error."""

    def collect(*options, **texts):
        for name, text in {"conftest": HELPERS, **texts}.items():
            (tmp_path / f"{name}.py").write_text(text)
        words = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "--collect-only",
            "-p",
            "conftest",
            "-c",
            ROOT / "pyproject.toml",
        ]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
        done = subprocess.run(
            [*words, f"--rootdir={ROOT}", *options, tmp_path],
            cwd=ROOT, env=environment, capture_output=True, text=True,
        )  # fmt: skip
        return done.returncode, set(re.findall(r"::(\w+)", done.stdout)), done.stderr

    return collect


DIRECT = "def test_direct(wait_until):\n    pass\n"
PURE = "def test_pure():\n    pass\n"


def test_files_without_such_tests_are_left_out(collected):
    files = {
        "test_a": DIRECT,
        "test_b": PURE,
        "test_c": "import pytest\n@pytest.mark.ros\ndef test_marked():\n    pass\n",
    }
    assert collected("--clock-files", **files)[:2] == (0, {"test_direct", "test_marked"})
    assert collected(**files)[:2] == (0, {"test_direct", "test_pure", "test_marked"})


@pytest.mark.parametrize(
    "text",
    [
        "def test_hidden(indirect):\n    pass\n",
        "pytestmark = getattr(__import__('pytest').mark, 'ros')\ndef test_hidden():\n    pass\n",
        "pytestmark = getattr(__import__('pytest').mark, 'clock')\ndef test_hidden():\n    pass\n",
    ],
    ids=["a fixture of a fixture", "ros", "clock"],
)
def test_a_file_that_does_not_show_such_a_test_is_refused(collected, text):
    code, _, error = collected(test_a=text)
    assert code == pytest.ExitCode.USAGE_ERROR and "test_hidden" in error
