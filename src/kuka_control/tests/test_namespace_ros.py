"""The names of a controller: as the contract has them with one arm, and all in its namespace where there are two."""

from __future__ import annotations

import socket

import numpy as np
import pytest
from test_controllers_ros import CONFIG, MOVE_S, QUICK, RATES, REAL_TIME, robot  # noqa: F401 - a fixture

from common.poses import pose

pytestmark = pytest.mark.ros

ARMS = {"margin": 0.3, "left": {"position": [0.0, 0.5, 0.0]}, "right": {"position": [0.0, -2.0, 0.0]}}


def set_params(namespace, prefix, port):
    import rospy
    import yaml

    values = yaml.safe_load((CONFIG / "kuka_params_rt.yaml").read_text())
    address = {"ip": "127.0.0.1", "port": port, "tool_mass": 0.0}
    rospy.set_param(f"{namespace}/kuka", {**values, **QUICK[REAL_TIME], **RATES, **address})
    if prefix:
        rospy.set_param(f"{namespace}/tf_prefix", prefix)
        rospy.set_param("/right/kuka", values)
        rospy.set_param("/arms", ARMS)


class Desired:
    """Publishes a desired tool frame of the arm `of`, 60 mm above its home, until it is stopped."""

    def __init__(self, of, centre):
        import rospy
        import tf2_ros

        from common.ros.conversions import stamped_transform

        c = np.sqrt(0.5)
        T = pose([[-c, c, 0.0], [c, c, 0.0], [0.0, 0.0, -1.0]], np.add(centre, (0.0, 0.0, 0.06)))
        broadcaster = tf2_ros.TransformBroadcaster()
        names = f"{of}kuka/base_frame", f"{of}kuka/tool_frame/desired"
        self._timer = rospy.Timer(
            rospy.Duration(0.02), lambda _: broadcaster.sendTransform(stamped_transform(T, *names, rospy.Time.now()))
        )

    def stop(self):
        self._timer.shutdown()
        self._timer.join()


def frames_of(recordings, node):
    """The tf edges (parent, child) that a node has published."""
    return {
        (transform.header.frame_id, transform.child_frame_id)
        for recording in recordings
        for message in list(recording)
        if message._connection_header["callerid"] == node
        for transform in message.transforms
    }


@pytest.mark.parametrize("namespace, prefix", [("", ""), ("/left", "left")], ids=["one arm", "left of two"])
def test_the_names_of_a_controller(ros, robot, wait_until, names_on_the_page, namespace, prefix):  # noqa: F811
    import rospy
    from diagnostic_msgs.msg import DiagnosticArray
    from std_msgs.msg import String
    from tf2_msgs.msg import TFMessage
    from visualization_msgs.msg import MarkerArray

    from kuka_msgs.msg import jointPositions
    from kuka_msgs.srv import setKukaControl

    of, node = f"{prefix}/" if prefix else "", f"{namespace}/kuka_real_time_node"
    set_params(namespace, prefix, robot.port)
    modes = ros.record(f"{namespace}/kuka/mode", String)
    edges = ros.record("/tf", TFMessage), ros.record("/tf_static", TFMessage)
    joints = ros.record(f"{namespace}/kuka/joint_positions", jointPositions)
    markers = ros.record(f"{namespace}/kuka/workspace", MarkerArray)
    diagnostics = ros.record("/diagnostics", DiagnosticArray)
    remapped = [f"__ns:={namespace}"] if namespace else []
    process = ros.run("kuka_control", REAL_TIME, *remapped)

    def mode(name):
        wait_until(lambda: (modes and modes[-1].data == name) or process.poll() is not None, MOVE_S, name)
        assert process.poll() is None, process.log_path.read_text()

    mode("home")
    centre = rospy.get_param(f"{namespace}/kuka/ws_center")
    assert len(rospy.get_param(f"{namespace}/kuka/joints_home")) == 7
    expected = names_on_the_page("kuka_real_time_node", namespace)
    assert len(expected["publishes"]) > 20 and len(expected["offers"]) == 7
    wait_until(lambda: ros.names(node) == expected, 10.0, "all names")
    # The frame of another arm does not move this one, its own does.
    other = Desired("right/" if prefix else "left/", centre)
    set_control = rospy.ServiceProxy(f"{namespace}/kuka/kuka_control", setKukaControl)
    assert set_control(True).success
    rospy.sleep(1.0)
    other.stop()
    assert modes[-1].data == "home"
    mine = Desired(of, centre)
    mode("servo")
    base = f"{of}kuka/base_frame"
    shown = {(base, f"{of}kuka/{name}") for name in ("flange_frame/home", "flange_frame/measured", "tool_frame/home")}
    shown |= {(base, f"{of}kuka/tool_frame/commanded"), *([("world", base)] if prefix else [])}
    wait_until(lambda: frames_of(edges, node) == shown, 10.0, f"the frames {shown}")
    wait_until(lambda: np.linalg.norm(flange(robot) - np.add(centre, (0.0, 0.0, 0.06 + 0.106))) < 5e-3, 10.0, "the arm")
    assert {message.header.frame_id for message in joints} == {base}
    assert {status.name for message in diagnostics for status in message.status} == {f"{of}kuka_control"}
    assert {marker.header.frame_id for message in markers for marker in message.markers} == {base}
    mine.stop()
    mode("home")
    target = [f"{x:.3f}" for x in np.add(centre, (0.0, 0.0, 0.03))]
    program = ros.run("kuka_control", "move.py", "pose", *target, "135", "0", "180", *remapped)
    wait_until(lambda: program.poll() is not None, MOVE_S, "the end of move.py")
    assert program.returncode == 0, program.log_path.read_text()


@pytest.mark.parametrize(
    "prefix, arms, options, words",
    [
        ("left", {**ARMS, "right": {"position": [0.0, 0.0, 0.0]}}, (), "left and right are 0.000 m apart, but arms/"),
        ("left", {**ARMS, "margin": 0.1}, (), "arms/margin is 0.1"),
        ("middle", ARMS, (), "tf_prefix is 'middle', but arms/ places only left, right"),
        ("left", ARMS, ("--lift-workspace",), "places another arm beside this one"),
    ],
)
def test_an_arm_that_may_not_move_beside_the_other_exits_before_it_connects(
    ros, wait_until, prefix, arms, options, words
):
    import rospy

    with socket.create_server(("127.0.0.1", 0)) as server:
        set_params("/left", prefix, server.getsockname()[1])
        rospy.set_param("/arms", arms)
        process = ros.run("kuka_control", REAL_TIME, *options, "__ns:=/left")
        wait_until(lambda: process.poll() is not None, 30.0, "the end of the controller")
        said = process.log_path.read_text()
        assert process.returncode != 0 and words in said and "Traceback" not in said, said
        server.settimeout(0.2)
        with pytest.raises(socket.timeout):
            server.accept()


def flange(robot):  # noqa: F811
    return np.array(robot.ask()["flange"])[:3, 3]
