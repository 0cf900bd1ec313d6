"""The program hand_wizard.py with the driver and the simulated Leap service, in virtual time."""

import pytest
import yaml

from rig_simulation.operator.guided import GuidedOperator
from rig_simulation.operator.motion import Script
from rig_simulation.operator.sources import Playback, ScriptedOperator

pytest.importorskip("rig_msgs.srv")
from simulated.leap_wire import LeapWire

pytestmark = pytest.mark.ros


def test_the_wizard_measures_the_hand_that_the_simulated_leap_tracks(virtual_graph, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    person = GuidedOperator(ScriptedOperator(Script()))
    with LeapWire() as wire:
        virtual_graph.run("leap_motion", "leap_driver.py", f"_port:={wire.play(Playback(person)).port}")
        wizard = virtual_graph.run("leap_hand", "hand_wizard.py", "anna")
        person.show()
        for curl, percent in ((0.0, 25), (0.6, 50), (0.0, 75)):
            person.reach(curl=curl, seconds=0.3)
            words = f" {percent} %"
            virtual_graph.wait_until(lambda words=words: words in wizard.log_path.read_text(), 10.0, words)
        person.reach(curl=0.6, seconds=0.3)
        assert wizard.wait(10.0) == 0
    stored = yaml.safe_load((tmp_path / ".config" / "leap_rig" / "operators" / "anna.yaml").read_text())
    assert stored["simulated"] is True
    for finger in ("index", "middle"):
        opened, closed = stored[f"{finger}_human"]
        assert opened - closed > 30.0
