"""The program that starts others behind the control loops."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

BEHIND = Path(__file__).parents[1] / "shell" / "behind.sh"
TELL = "import os; print(os.nice(0)); print(open('/proc/self/autogroup').read())"


def told(new_session: bool) -> list[str]:
    command = [str(BEHIND), "7", sys.executable, "-c", TELL]
    result = subprocess.run(command, capture_output=True, text=True, start_new_session=new_session, check=True)
    return result.stdout.split()


@pytest.fixture(autouse=True)
def with_autogroups():
    if not Path("/proc/self/autogroup").exists():
        pytest.skip("this kernel shares the processor among processes, not among sessions")


def test_a_session_of_its_own_stands_behind_the_others():
    niceness, _, _, niceness_of_session = told(new_session=True)
    assert (niceness, niceness_of_session) == ("7", "7")


def test_the_session_of_others_stays_as_it_is():
    niceness, _, _, niceness_of_session = told(new_session=False)
    assert (niceness, niceness_of_session) == ("7", "0")


def test_the_exit_code_is_the_program_s():
    assert subprocess.run([BEHIND, "1", "sh", "-c", "exit 3"], check=False).returncode == 3
