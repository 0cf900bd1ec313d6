"""The process of the program that shows grasps, and its keyboard."""

from __future__ import annotations

import os

import pytest

pytest.importorskip("rig_msgs.srv")
from grasping.lab.ros.shown_grasp_program import Enters

pytest.importorskip("rospy")
pytestmark = [pytest.mark.ros, pytest.mark.real]

LONG_S = 60.0


def test_without_a_master_it_ends_with_a_sentence_and_enter_comes_through_a_pipe(processes, wait_until):
    command = ("rosrun", "grasping", "collect_shown_grasp.py", "cup")
    process = processes.start(*command, env={"ROS_MASTER_URI": "http://localhost:9"})
    assert process.wait(LONG_S) == 1
    assert "There is no ROS master" in process.log_path.read_text() and "Traceback" not in process.log_path.read_text()

    reader, writer = os.pipe()
    with os.fdopen(reader) as keyboard:
        enters = Enters(keyboard)
        assert not enters.pressed() and not enters.ended
        os.write(writer, b"\n")
        wait_until(enters.pressed, LONG_S, "Enter")
        assert not enters.pressed()
        os.close(writer)
        wait_until(lambda: enters.ended, LONG_S, "the end of the pipe")
