"""The node leap_teleop: driver, teleoperation of the arm and of the hand in one process."""

from __future__ import annotations

import signal

import pytest
import yaml

pytestmark = pytest.mark.ros
ARM = {
    "robot": "LBR7R800",
    "center_line": [1, 0, 0],
    "z_lower_limit": 0.2,
    "tool_length": 0.106,
    "ws_center": [0.5, 0, 0.4],
}


@pytest.fixture
def rig(ros, processes, wait_until):
    """The parameters, the hand's services, and a Leap service that plays; yields its port."""
    import rospkg
    import rospy
    from std_srvs.srv import Empty, EmptyResponse

    packages = rospkg.RosPack()
    for name, file in (("leap", "leap_kuka/config/leap_params"), ("leap_hand", "leap_hand/config/leap_hand")):
        package, _, path = file.partition("/")
        with open(f"{packages.get_path(package)}/{path}.yaml") as text:
            rospy.set_param(name, yaml.safe_load(text))
    rospy.set_param("kuka", ARM)
    names = ("calibrate_fingers", "calibrate_tactile")
    services = [rospy.Service(f"reflex_takktile/{name}", Empty, lambda _: EmptyResponse()) for name in names]
    leapd = processes.start("rosrun", "rig_simulation", "leapd.py", "--port", "0", "--control-port", "0")
    wait_until(lambda: "control port" in leapd.log_path.read_text(), 30.0, "the Leap service")
    yield int(leapd.log_path.read_text().split("listening on ")[1].split(",")[0].rsplit(":", 1)[1])
    for service in services:
        service.shutdown()


def test_each_frame_reaches_arm_and_hand_and_the_topics_are_there(ros, rig, wait_until):
    from sensor_msgs.msg import TimeReference
    from tf2_msgs.msg import TFMessage

    from leap_motion.msg import Human
    from reflex_msgs.msg import RadianServoCommands

    tf, times = ros.record("/tf", TFMessage), ros.record("rig/stage_times", TimeReference)
    humans = ros.record("leap_motion/leap_device", Human)
    commands = ros.record("reflex_takktile/radian_hand_command", RadianServoCommands)
    node = ros.run("leap_rig", "leap_teleop.py", f"_driver/port:={rig}", "_hand/hand_only:=true")

    def frames_of(stage):
        return {time.header.stamp for time in times if time.source == stage}

    wait_until(
        lambda: frames_of("leap_motion") & frames_of("leap_kuka") & frames_of("leap_hand"), 60.0, "one frame in all"
    )
    wait_until(lambda: commands, 20.0, "a command to the hand")
    wait_until(
        lambda: {human.header.stamp for human in humans} & {t.header.stamp for m in tf for t in m.transforms},
        20.0,
        "a frame on both topics",
    )
    node.send_signal(signal.SIGINT)
    assert node.wait(20.0) == 0, node.log_path.read_text()
    assert "Traceback" not in node.log_path.read_text()


@pytest.mark.parametrize(
    ("argument", "sentence"), [("_driver/port:=0", "~driver/port is 0"), ("_hand/only:=1", "only")]
)
def test_bad_parameters_are_one_sentence(ros, argument, sentence):
    node = ros.run("leap_rig", "leap_teleop.py", argument, "_hand/hand_only:=true")
    assert node.wait(30.0) == 1
    log = node.log_path.read_text()
    assert sentence in log and "Traceback" not in log
