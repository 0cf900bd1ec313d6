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
def rig_of(ros, processes, wait_until):
    """Sets the parameters of arms in these namespaces, offers their hands' services, and starts a Leap service that
    plays; returns its port.
    """
    import rospkg
    import rospy
    from std_srvs.srv import Empty, EmptyResponse

    packages, services = rospkg.RosPack(), []

    def start(*namespaces: str, arguments: tuple[str, ...] = ()) -> int:
        for of in namespaces:
            for name, file in (("leap", "leap_kuka/config/leap_params"), ("leap_hand", "leap_hand/config/leap_hand")):
                package, _, path = file.partition("/")
                with open(f"{packages.get_path(package)}/{path}.yaml") as text:
                    rospy.set_param(of + name, yaml.safe_load(text))
            rospy.set_param(f"{of}kuka", ARM)
            for name in ("calibrate_fingers", "calibrate_tactile"):
                service = f"{of}reflex_takktile/{name}"
                services.append(rospy.Service(service, Empty, lambda _: EmptyResponse()))
        ports = ("--port", "0", "--control-port", "0")
        leapd = processes.start("rosrun", "rig_simulation", "leapd.py", *ports, *arguments)
        wait_until(lambda: "control port" in leapd.log_path.read_text(), 30.0, "the Leap service")
        return int(leapd.log_path.read_text().split("listening on ")[1].split(",")[0].rsplit(":", 1)[1])

    yield start
    for service in services:
        service.shutdown()


@pytest.fixture
def rig(rig_of):
    """The rig of an only arm; the port of its Leap service."""
    return rig_of("")


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


def test_of_two_arms_each_follows_the_hand_of_its_side_with_names_of_its_own(ros, rig_of, wait_until):
    import rospy
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
    from tf2_msgs.msg import TFMessage

    from leap_motion.msg import Human
    from reflex_msgs.msg import RadianServoCommands

    arms = ("left", "right")
    port = rig_of(*(f"{arm}/" for arm in arms), arguments=("--hand", "both"))
    for arm in arms:
        rospy.set_param(f"{arm}/tf_prefix", arm)
        rospy.set_param(f"{arm}/leap/hand", arm)
        rospy.set_param(f"{arm}/leap/box_offset", -0.16 if arm == "left" else 0.16)
    rospy.set_param("/leap_teleop_test/arms", list(arms))
    tf, diagnostics = ros.record("/tf", TFMessage), ros.record("/diagnostics", DiagnosticArray)
    humans = ros.record("leap_motion/leap_device", Human)
    streams = {arm: ros.record(f"{arm}/leap_kuka/stream", DiagnosticStatus) for arm in arms}
    commands = {arm: ros.record(f"{arm}/reflex_takktile/radian_hand_command", RadianServoCommands) for arm in arms}
    arguments = ("__name:=leap_teleop_test", f"_driver/port:={port}", "_hand/hand_only:=true")
    node = ros.run("leap_rig", "leap_teleop.py", *arguments)

    def steering(arm: str) -> set[str]:
        return {value.value for message in tuple(streams[arm]) for value in message.values if value.key == "hand_side"}

    wait_until(lambda: all(arm in steering(arm) for arm in arms), 90.0, "each arm's hand to steer it")
    assert all(steering(arm) <= {"", arm} for arm in arms)
    wait_until(lambda: all(commands.values()) and humans, 30.0, "commands to both robot hands")
    desired = {f"{arm}/kuka/tool_frame/desired" for arm in arms}

    def children() -> set[str]:
        return {transform.child_frame_id for message in tuple(tf) for transform in message.transforms}

    wait_until(lambda: desired <= children(), 30.0, "both desired tools")
    assert all(child.split("/")[0] in arms for child in children())
    names = {f"{arm}/{name}" for arm in arms for name in ("leap_kuka", "leap_hand")} | {"leap_motion"}
    wait_until(
        lambda: names <= {status.name for message in tuple(diagnostics) for status in message.status},
        20.0,
        "diagnostics",
    )
    node.send_signal(signal.SIGINT)
    assert node.wait(20.0) == 0, node.log_path.read_text()
    assert "Traceback" not in node.log_path.read_text()


def test_one_hand_steers_the_arm_that_the_service_names_and_the_other_one_waits(ros, rig_of, wait_until):
    import rospy
    from diagnostic_msgs.msg import DiagnosticStatus
    from std_msgs.msg import String

    from rig_msgs.msg import KukaStatus
    from rig_msgs.srv import ChooseArm

    arms = ("left", "right")
    port = rig_of(*(f"{arm}/" for arm in arms), arguments=("--hand", "right"))
    homes = {}
    for arm in arms:
        rospy.set_param(f"{arm}/tf_prefix", arm)
        settings = {"hand": arm, "arm_choice": "service", "engagement": "relative", "hold_time": 30.0}
        for key, value in settings.items():
            rospy.set_param(f"{arm}/leap/{key}", value)
        homes[arm] = rospy.Publisher(f"{arm}/kuka/status", KukaStatus, queue_size=10)
    rospy.set_param("/leap_teleop_choice/arms", list(arms))
    streams = {arm: ros.record(f"{arm}/leap_kuka/stream", DiagnosticStatus) for arm in arms}
    chosen = ros.record("leap_kuka/chosen_arm", String)
    arguments = ("__name:=leap_teleop_choice", f"_driver/port:={port}", "_hand/hand_only:=true")
    node = ros.run("leap_rig", "leap_teleop.py", *arguments)
    wait_until(lambda: chosen and chosen[-1].data == "both", 90.0, "the choice at the start")
    rospy.wait_for_service("leap_kuka/choose_arm", 30.0)
    choose = rospy.ServiceProxy("leap_kuka/choose_arm", ChooseArm)

    def reason(arm: str) -> str:
        for home in homes.values():
            home.publish(KukaStatus(mode="home", control_on=True, scaling_factor=1.0))
        return streams[arm][-1].message if streams[arm] else ""

    def check(own: str, other: str) -> None:
        answer = choose(own)
        assert answer.success and answer.message == f"The hand steers the {own} arm; the others hold their tools."
        wait_until(lambda: f"the hand steers the {own} arm" in reason(other), 30.0, "the reason of the other arm")
        wait_until(lambda: "right hand" in reason(own) and "steers" not in reason(own), 30.0, "any hand for this arm")

    check(*arms)
    check(*arms[::-1])
    refused = choose("middle")
    assert not refused.success and "'middle', but must be left, right or both" in refused.message
    assert [message.data for message in chosen] == ["both", "left", "right"]
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
