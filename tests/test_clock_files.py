"""Which tests go by the clock: --clock-files leaves none out, and no other opens a socket or starts a program."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.clock

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
        done = run_pytest("--collect-only", *options, tmp_path)
        return done.returncode, set(re.findall(r"::(\w+)", done.stdout)), done.stderr

    return collect


@pytest.fixture
def ran(tmp_path):
    """Runs the text of a file of tests; returns the exit code and what was printed."""

    def run(text):
        (tmp_path / "test_a.py").write_text(text)
        done = run_pytest(tmp_path / "test_a.py")
        return done.returncode, done.stdout

    return run


def run_pytest(*arguments):
    """Runs pytest with the project's conftest.py and settings."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "conftest", "-c", ROOT / "pyproject.toml", f"--rootdir={ROOT}",
         *arguments],
        cwd=ROOT, env=environment, capture_output=True, text=True,
    )  # fmt: skip


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


@pytest.mark.parametrize(
    ("text", "event"),
    [
        ("import socket\ndef test_a():\n    socket.socket().bind(('127.0.0.1', 0))\n", "socket.bind"),
        ("import subprocess\ndef test_a():\n    subprocess.run(['true'])\n", "subprocess.Popen"),
        (
            "import os, pytest\n@pytest.fixture\ndef made():\n    os.system('true')\ndef test_a(made):\n    pass\n",
            "os.system",
        ),
        (
            "import os, pytest\n@pytest.fixture\ndef made():\n    yield\n    os.system('true')\n"
            f"def test_a(made):\n    pass\n{PURE}",
            "os.system",
        ),
        ("import os\ndef test_a():\n    os.posix_spawn('/bin/true', ['true'], {})\n", "os.posix_spawn"),
        ("import time\ndef test_a():\n    time.sleep(0.001)\n", "time.sleep"),
        ("from common import clock\ndef test_a():\n    clock.sleep(0.001)\n", "time.sleep"),
    ],
)
def test_a_test_that_leaves_its_process_must_be_marked(ran, text, event):
    code, said = ran(text)
    assert code == pytest.ExitCode.TESTS_FAILED and event in said and "1 error" in said
    assert ran(f"{text}import pytest\npytestmark = pytest.mark.clock\n")[0] == pytest.ExitCode.OK


def test_who_only_gives_way_or_sleeps_in_virtual_time_needs_no_mark(ran):
    code, said = ran(
        "import time\nfrom common import clock\nfrom simulated.clock import virtual_time\n"
        "def test_a():\n    time.sleep(0)\n    with virtual_time():\n        clock.sleep(1.0)\n"
    )
    assert code == pytest.ExitCode.OK, said


def test_what_another_test_did_is_not_its_own(ran):
    shared = "import os, pytest\n@pytest.fixture(scope='session')\ndef shared():\n    yield\n    os.system('true')\n"
    code, said = ran(shared + "@pytest.mark.clock\ndef test_a(shared):\n    os.system('true')\n" + PURE)
    assert code == pytest.ExitCode.OK, said


@pytest.mark.parametrize(
    "text",
    [
        "import pytest\n@pytest.mark.rig\ndef test_a():\n    pass\n",
        "import pytest\n@pytest.fixture\ndef ros_master():\n    pass\ndef test_a(ros_master):\n    pass\n",
        "def test_a(processes):\n    pass\n",
        "def test_a(wait_until):\n    pass\n",
    ],
    ids=["rig", "ros_master", "processes", "wait_until"],
)
def test_rigs_nodes_and_programs_go_by_the_clock(collected, text):
    assert collected("-m", "clock", test_a=text)[1] == {"test_a"}
