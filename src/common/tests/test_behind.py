"""The program that starts others behind the control loops."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.clock

BEHIND = Path(__file__).parents[1] / "shell" / "behind.sh"
SESSION = Path("/proc/self/autogroup")
"""Name and niceness of the session as the kernel shares the processor; empty where it does not look at sessions."""
NICER = str(min(os.nice(0) + 7, 19))
TELL = f"import os; print(os.nice(0)); print(open('{SESSION}').read())"


def priority_of(new_session: bool, how: str = "7") -> tuple[str, str]:
    """Returns what a program started behind the others sees: its niceness, and its session."""
    command = [str(BEHIND), how, sys.executable, "-c", TELL]
    result = subprocess.run(command, capture_output=True, text=True, start_new_session=new_session, check=True)
    niceness, _, session = result.stdout.partition("\n")
    return niceness, session.strip()


@pytest.fixture(autouse=True)
def with_autogroups():
    if not SESSION.exists():
        pytest.skip("this kernel shares the processor among processes, not among sessions")


def test_a_session_of_its_own_stands_behind_the_others():
    niceness, session = priority_of(new_session=True)
    if not session:
        pytest.skip("this machine shares the processor among processes, not among sessions")
    assert (niceness, session.split()[1:]) == (NICER, ["nice", "7"])


def test_idle_gets_only_what_the_others_leave():
    command = [str(BEHIND), "idle", sys.executable, "-c", "import os; print(os.sched_getscheduler(0) == os.SCHED_IDLE)"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "True\n"
    session = priority_of(new_session=True, how="idle")[1]
    assert not session or session.split()[1:] == ["nice", "19"]


def test_the_session_of_others_stays_as_it_is():
    assert priority_of(new_session=False) == (NICER, SESSION.read_text().strip())


def test_the_exit_code_is_the_program_s():
    assert subprocess.run([BEHIND, "1", "sh", "-c", "exit 3"], check=False).returncode == 3
