"""The process of the window that shows image topics."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.ros

LONG_S = 15.0


def test_it_ends_with_the_rig_and_at_a_signal(ros, processes, wait_until):
    import rosgraph

    node = ros.run("grasping", "image_viewer.py", "image:=/viewer/red")
    wait_until(lambda: ros.names("/image_viewer")["hears"] == {"/viewer/red"}, LONG_S, "the window")
    assert processes.end(node) == 0, node.log_path.read_text()
    assert "Traceback" not in node.log_path.read_text() and rosgraph.is_master_online()
