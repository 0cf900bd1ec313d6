"""What the simulated operator knows of an arm, from the messages of its controller and its teleoperation."""

import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
from std_msgs.msg import String

from rig_msgs.msg import TeleopState
from rig_simulation.ros.seen_arm import SeenArm

pytestmark = pytest.mark.ros


@pytest.mark.parametrize("arm", ["", "left"])
def test_it_follows_in_servo_mode_and_is_steered_while_nothing_keeps_the_tool(virtual_graph, arm):
    of = f"{arm}/" if arm else ""
    rospy.set_param(f"{of}kuka", {"tool_length": 0.1, "center_line": [1.0, 0.0, 0.0]})
    seen = SeenArm("pick_cup", arm)
    modes = rospy.Publisher(f"{of}kuka/mode", String, queue_size=1)
    states = rospy.Publisher(f"{of}leap_kuka/state", TeleopState, queue_size=1)
    clock.sleep(0.1)
    for mode, follows in [("pick_up", False), ("servo", True), ("servo", False)]:
        modes.publish(mode)
        states.publish(TeleopState(state=TeleopState.RUNNING, follows=follows))
        clock.sleep(0.01)
        assert (seen.following, seen.streams) == (mode == "servo", follows)
