"""The client of the hand on the loopback interface, with the simulated hand as a program of its own."""

import re
import sys
import threading
from pathlib import Path

import pytest

from reflex import HandSettings, HandStatus, ReflexHand
from reflex.calibration_files import CalibrationFiles
from rig_simulation.control_port import ControlClient

HAND = Path(__file__).parents[2] / "rig_simulation" / "scripts" / "reflex_hand.py"
PATIENT = HandSettings(silence_time=60.0, calibration_max_time=60.0)
"""Hand and client may get no processor for seconds."""


@pytest.mark.real
def test_calibrates_closes_and_lets_go(processes, wait_until, tmp_path):
    process = processes.start(sys.executable, str(HAND), "--port", "0", "--control-port", "0", "--seed", "4")
    ready = re.compile(r"UDP port (\d+), control port 127\.0\.0\.1:(\d+)\n")
    found = wait_until(lambda: ready.search(process.log_path.read_text()), 20.0, "the simulated hand")
    control = ControlClient("127.0.0.1", int(found[2]), 60.0)
    files = CalibrationFiles(str(tmp_path / "hand"))
    with ReflexHand("lo", int(found[1]), files=files, settings=PATIENT) as hand:
        hand.calibrate_fingers()
        assert hand.calibrated and hand.status is HandStatus.READY
        hand.command((2.5, 2.5, 2.5, 0.0))
        wait_until(lambda: min(control.ask("state")["angles"][:3]) > 2.0, 10.0, "the closed hand")
    wait_until(lambda: control.ask("state")["torque"] == [False] * 4, 10.0, "torque off")
    assert not [thread for thread in threading.enumerate() if thread.name == "reflex hand"]
    assert processes.end(process) == 0 and process.log_path.read_text().count("\n") == 1
