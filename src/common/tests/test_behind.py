"""The program that starts others behind the control loops."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

BEHIND = Path(__file__).parents[1] / "shell" / "behind.sh"
SESSION = Path("/proc/self/autogroup")
"""Name and niceness of the session as the kernel shares the processor; empty where it does not look at sessions."""
NICER = str(min(os.nice(0) + 7, 19))


def told(how: str, program: str, new_session: bool) -> tuple[str, str]:
    """Returns what a program behind the others prints first, and its session, if that counts."""
    command = [str(BEHIND), how, "sh", "-c", f"{program}; cat {SESSION}; exit 3"]
    done = subprocess.run(command, capture_output=True, text=True, start_new_session=new_session)
    assert done.returncode == 3, "the exit code is the program's"
    first, _, session = done.stdout.partition("\n")
    return first, session.strip()


@pytest.mark.real
def test_a_session_of_its_own_stands_behind_the_others_and_that_of_others_stays_as_it_is():
    if not SESSION.exists():
        pytest.skip("this kernel shares the processor among processes, not among sessions")
    assert told("7", "nice", new_session=False) == (NICER, SESSION.read_text().strip())
    policy, idle = told("idle", "chrt -p $$ | head -1", new_session=True)
    niceness, session = told("7", "nice", new_session=True)
    assert (niceness, policy.endswith("SCHED_IDLE")) == (NICER, True)
    assert not session or (session.split()[1:], idle.split()[1:]) == (["nice", "7"], ["nice", "19"])
