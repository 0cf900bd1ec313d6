"""The process of the node ggcnn: what Ctrl-C does while torch and the networks load, and while it works."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

pytest.importorskip("rig_msgs.srv")


pytest.importorskip("rospy")
pytestmark = pytest.mark.ros

PATIENCE_S = 60.0


@pytest.mark.parametrize(
    "moment",
    [
        pytest.param("its libraries load", marks=pytest.mark.real),
        pytest.param("its networks load", marks=pytest.mark.long),
    ],
)
def test_interrupted_while_it_loads_it_ends(ros, wait_until, moment):
    process = ros.run("grasping", "ggcnn.py")
    condition = {
        "its libraries load": lambda: "libtorch" in Path(f"/proc/{process.pid}/maps").read_text(),
        "its networks load": lambda: "tool: hand" in process.log_path.read_text(),
    }[moment]
    wait_until(condition, PATIENCE_S, moment)
    process.send_signal(signal.SIGINT)
    code = process.wait(PATIENCE_S)
    assert code == 0 or (code == -signal.SIGINT and moment == "its libraries load")
    assert "Traceback" not in process.log_path.read_text()
