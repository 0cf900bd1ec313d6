"""The program hand_wizard.py with the driver and the simulated Leap service, as processes."""

import threading

import pytest
import yaml

from rig_simulation.devices.leap.server import SimulatedLeapService
from rig_simulation.operator.guided import GuidedOperator
from rig_simulation.operator.motion import Script
from rig_simulation.operator.sources import Playback, ScriptedOperator

pytestmark = pytest.mark.ros


def test_the_wizard_measures_the_hand_that_the_simulated_leap_tracks(ros, wait_until, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    person = GuidedOperator(ScriptedOperator(Script()))
    service = SimulatedLeapService(Playback(person), "127.0.0.1", 0, 0)
    thread = threading.Thread(target=service.run)
    thread.start()
    try:
        ros.run("leap_motion", "leap_driver.py", f"_port:={service.port}")
        wizard = ros.run("leap_hand", "hand_wizard.py", "anna", "--timeout", "300")
        person.show()
        for curl, percent in ((0.0, 25), (0.6, 50), (0.0, 75)):
            person.reach(curl=curl, seconds=0.3)
            wait_until(lambda percent=percent: f" {percent} %" in wizard.log_path.read_text(), 30.0, f"{percent} %")
        person.reach(curl=0.6, seconds=0.3)
        assert wizard.wait(20.0) == 0
    finally:
        service.stop()
        thread.join()
    stored = yaml.safe_load((tmp_path / ".config" / "leap_rig" / "operators" / "anna.yaml").read_text())
    for finger in ("index", "middle"):
        opened, closed = stored[f"{finger}_human"]
        assert opened - closed > 30.0
