"""The node leap_teleop: driver, teleoperation of the arm and of the hand in one process, with a simulated tracker."""

from __future__ import annotations

import re
import signal
from pathlib import Path

import pytest
import yaml

from common import clock
from rig_simulation.operator import motion
from rig_simulation.operator.guided import GuidedOperator
from rig_simulation.operator.sources import BothHands, Playback, ScriptedOperator
from simulated.leap_wire import LeapWire

pytest.importorskip("rig_msgs.srv")
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import TimeReference
from std_msgs.msg import String
from std_srvs.srv import Empty, EmptyResponse
from tf2_msgs.msg import TFMessage

from common.ros.node import repeat
from leap_motion.msg import Human
from reflex_msgs.msg import RadianServoCommands
from rig_msgs.msg import KukaStatus
from rig_msgs.srv import ChooseArm

pytestmark = pytest.mark.ros
ARM = {
    "robot": "LBR7R800",
    "center_line": [1, 0, 0],
    "z_lower_limit": 0.2,
    "tool_length": 0.106,
    "ws_center": [0.5, 0, 0.4],
}
PACKAGES = Path(__file__).parents[2]
LEAP = yaml.safe_load((PACKAGES / "leap_kuka" / "config" / "leap_params.yaml").read_text())
HAND = yaml.safe_load((PACKAGES / "leap_hand" / "config" / "leap_hand.yaml").read_text())
ARMS = ("left", "right")
APART_M = 0.32


@pytest.fixture
def teleop(ros):
    """Sets the parameters of arms in these namespaces, offers their hands' services, starts a Leap service with these
    hands, and the node; returns it.
    """

    def start(*arms: str, operator=None, leap=lambda arm: {}):
        for arm in arms or ("",):
            of = f"{arm}/" if arm else ""
            rospy.set_param(f"{of}leap", {**LEAP, **leap(arm)})
            rospy.set_param(f"{of}leap_hand", HAND)
            rospy.set_param(f"{of}kuka", ARM)
            if arm:
                rospy.set_param(f"{of}tf_prefix", arm)
            for name in ("calibrate_fingers", "calibrate_tactile"):
                rospy.Service(f"{of}reflex_takktile/{name}", Empty, lambda _: EmptyResponse())
        if arms:
            rospy.set_param("/leap_teleop/arms", list(arms))
        port = wire.play(Playback(operator or ScriptedOperator(motion.Script()))).port
        return ros.run("leap_rig", "leap_teleop.py", f"_driver/port:={port}", "_hand/hand_only:=true")

    with LeapWire() as wire:
        yield start


def ends(node):
    node.send_signal(signal.SIGINT)
    assert node.wait(5.0) == 0, node.log_path.read_text()
    assert "Traceback" not in node.log_path.read_text()


def test_each_frame_reaches_arm_and_hand_and_the_topics_are_there(ros, teleop):
    tf, times = ros.record("/tf", TFMessage), ros.record("rig/stage_times", TimeReference)
    humans = ros.record("leap_motion/leap_device", Human)
    commands = ros.record("reflex_takktile/radian_hand_command", RadianServoCommands)
    node = teleop()
    ros.wait_until(lambda: commands, 10.0, "a command to the hand")
    clock.sleep(1.0)
    begun = len(humans)
    clock.sleep(3.0)
    stamps = [human.header.stamp for human in humans[begun:]]
    clock.sleep(0.2)  # in which the stage times come
    assert len(stamps) > 300
    assert set(stamps) <= {t.header.stamp for m in tf for t in m.transforms}
    done = {}
    for time in times:
        done.setdefault(time.source, {})[time.header.stamp] = time.time_ref
    for stage in ("leap_motion", "leap_kuka", "leap_hand"):
        assert done[stage].keys() >= set(stamps), stage
        assert max((done[stage][stamp] - done["received"][stamp]).to_sec() for stamp in stamps) < 0.002, stage
    ends(node)


def test_of_two_arms_each_follows_the_hand_of_its_side_with_names_of_its_own(ros, teleop):
    tf, diagnostics = ros.record("/tf", TFMessage), ros.record("/diagnostics", DiagnosticArray)
    humans = ros.record("leap_motion/leap_device", Human)
    streams = {arm: ros.record(f"{arm}/leap_kuka/stream", DiagnosticStatus) for arm in ARMS}
    commands = {arm: ros.record(f"{arm}/reflex_takktile/radian_hand_command", RadianServoCommands) for arm in ARMS}
    shift = {"left": -APART_M / 2.0, "right": APART_M / 2.0}
    hands = [ScriptedOperator(motion.Script(), arm, centre=(1e3 * x, 350.0, 0.0)) for arm, x in shift.items()]
    node = teleop(*ARMS, operator=BothHands(tuple(hands)), leap=lambda arm: {"hand": arm, "box_offset": shift[arm]})

    def steering(arm: str) -> set[str]:
        return {value.value for message in streams[arm] for value in message.values if value.key == "hand_side"}

    ros.wait_until(lambda: all(arm in steering(arm) for arm in ARMS), 30.0, "each arm's hand to steer it")
    ros.wait_until(lambda: all(commands.values()), 10.0, "commands to both robot hands")

    def followed() -> set[tuple[str, str]]:
        said = re.findall(r"(left|right): Hand following: (left|right) hand", node.log_path.read_text())
        return set(said)

    ros.wait_until(lambda: len(followed()) == 2, 10.0, "both robot hands to follow")
    assert humans and all(steering(arm) <= {"", arm} for arm in ARMS)
    children = {transform.child_frame_id for message in tf for transform in message.transforms}
    assert {f"{arm}/kuka/tool_frame/desired" for arm in ARMS} <= children
    assert all(child.split("/")[0] in ARMS for child in children)
    assert followed() == {("left", "left"), ("right", "right")}
    names = {f"{arm}/{name}" for arm in ARMS for name in ("leap_kuka", "leap_hand")} | {"leap_motion"}
    assert names == {status.name for message in diagnostics for status in message.status}
    ends(node)


def test_one_hand_steers_the_arm_that_the_service_names_and_the_other_one_waits(ros, teleop):
    homes = [rospy.Publisher(f"{arm}/kuka/status", KukaStatus, queue_size=10) for arm in ARMS]
    streams = {arm: ros.record(f"{arm}/leap_kuka/stream", DiagnosticStatus) for arm in ARMS}
    chosen = ros.record("leap_kuka/chosen_arm", String)
    settings = {"arm_choice": "service", "engagement": "relative", "hold_time": 30.0}
    operator = GuidedOperator(ScriptedOperator(motion.Script()))
    operator.show(back=0.25)
    node = teleop(*ARMS, operator=operator, leap=lambda arm: {**settings, "hand": arm})
    status = KukaStatus(mode="home", control_on=True, scaling_factor=1.0)
    repeat(lambda: [home.publish(status) for home in homes], 0.1, "arms")
    clock.sleep(5.0)
    choose = rospy.ServiceProxy("leap_kuka/choose_arm", ChooseArm)
    for own, other in (ARMS, ARMS[::-1]):
        answer = choose(own)
        assert answer.success and answer.message == f"The hand steers the {own} arm; the others hold their tools."
        for back in (0.25, 0.0):
            operator.reach(back=back)
            clock.sleep(2.0)
        assert f"the hand steers the {own} arm" in streams[other][-1].message
        reason = streams[own][-1].message
        assert "right hand" in reason and "steers" not in reason, "it takes any hand"
    refused = choose("middle")
    clock.sleep(0.1)
    assert not refused.success and "'middle', but must be left, right or both" in refused.message
    assert [message.data for message in chosen] == ["both", "left", "right"]
    ends(node)


@pytest.mark.parametrize(
    ("argument", "sentence"), [("_driver/port:=0", "~driver/port is 0"), ("_hand/only:=1", "only")]
)
def test_bad_parameters_are_one_sentence(ros, argument, sentence):
    node = ros.run("leap_rig", "leap_teleop.py", argument, "_hand/hand_only:=true")
    assert node.wait(5.0) == 1
    log = node.log_path.read_text()
    assert sentence in log and "Traceback" not in log
