"""The process of the node grasp_execution: what Ctrl-C publishes still comes."""

from __future__ import annotations

import signal
import xmlrpc.client

import pytest

pytest.importorskip("rig_msgs.srv")
import rosgraph
import rospy
from std_srvs.srv import Trigger
from test_execution_node import ARM, CONFIG, TOOL_POSE, Rig

from grasp_msgs.msg import GraspOutcome

pytestmark = [pytest.mark.ros, pytest.mark.real]

LONG_S = 60.0


@pytest.fixture
def rig_of_the_test(ros):
    rig = Rig()
    yield rig
    rig.end()


def test_ctrl_c_tells_the_outcome_and_lets_the_tool_go(ros, rig_of_the_test, wait_until):
    outcomes = ros.record("grasping/outcome", GraspOutcome)
    rospy.set_param("kuka", ARM)
    rospy.set_param("grasp_execution", {**CONFIG, "tool_pose": TOOL_POSE, "silence": 10.0})
    rig = rig_of_the_test
    process = ros.run("grasping", "grasp_execution.py")
    rospy.wait_for_service("grasping/execute", LONG_S)
    wait_until(lambda: rospy.ServiceProxy("grasping/execute", Trigger)().success or rig.held, LONG_S, "an execution")
    node = xmlrpc.client.ServerProxy(rosgraph.Master("/test").lookupNode("/grasp_execution"))
    listened = ["o", "TCPROS", "/grasping/outcome"]
    wait_until(lambda: any(bus[2:5] == listened for bus in node.getBusInfo("/test")[2]), LONG_S, "the connection")
    process.send_signal(signal.SIGINT)
    assert process.wait(LONG_S) == 0
    wait_until(lambda: outcomes, LONG_S, "the outcome")
    assert rig.held[-1] is None and "Traceback" not in process.log_path.read_text()
