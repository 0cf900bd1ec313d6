"""What lerobot_server.py answers by what the rig publishes, and what it publishes itself."""

import signal
from types import SimpleNamespace

import numpy as np
import pytest

from common import clock
from common.errors import DeviceError, RigError
from leap_rig.lerobot.actions import ACTION

pytest.importorskip("reflex_msgs.msg")
import rospy
import tf2_ros
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from std_srvs.srv import SetBool

from kuka_msgs.msg import jointPositions, jointTorquesExternal
from leap_rig.lerobot.ros import server_program
from leap_rig.lerobot.ros.server_program import RigDesk, _parser
from reflex_msgs.msg import Finger, Hand, Motor, RadianServoCommands
from rig_msgs.msg import PolicyActions, TeleopState

pytestmark = pytest.mark.ros
DESIRED, MEASURED = "kuka/tool_frame/desired", "kuka/tool_frame/measured"
LATE_S = 0.1


class PublishedRig:
    """Publishes what the rig does; `without` it leaves out."""

    def __init__(self, of=""):
        self.of = of
        self.topics = {
            topic: rospy.Publisher(of + topic if topic[:6] != "camera" else topic, type(message), queue_size=10)
            for topic, message in self.messages().items()
        }
        self.tf = tf2_ros.TransformBroadcaster()

    def messages(self):
        return {
            "kuka/joint_positions": jointPositions(Header(), *np.arange(7.0)),
            "kuka/joint_torques_external": jointTorquesExternal(Header(), *np.arange(7.0)),
            "reflex_takktile/hand_state": Hand(
                motor=[Motor(joint_angle=0.1 * i) for i in range(4)], finger=[Finger() for _ in range(3)]
            ),
            "camera/rgb/image_raw": Image(Header(), 48, 64, "rgb8", 0, 192, bytes([200, 60, 30]) * (48 * 64)),
        }

    def publish(self, *without, tool=0.5):
        for topic, message in self.messages().items():
            if topic not in without:
                self.topics[topic].publish(message)
        if MEASURED not in without:
            self.place(self.of + MEASURED, tool, f"{self.of}kuka/base_frame")
        clock.sleep(LATE_S)

    def place(self, frame, x, parent="kuka/base_frame", q=(0.0, 0.0, 0.0, 1.0)):
        at = Transform(Vector3(x, 0.0, 0.4), Quaternion(*q))
        self.tf.sendTransform(TransformStamped(Header(0, rospy.Time.now(), parent), frame, at))


@pytest.fixture
def published(virtual_graph):
    return PublishedRig()


def desk(moves=True):
    made = RigDesk({"color": "/camera/rgb/image_raw"}, 90, moves)
    clock.sleep(LATE_S)
    return made


def action(x=0.5):
    return dict(zip(ACTION, (x, 0.0, 0.4, 0.0, 0.0, 0.0, 1.0, 0.5, 0.5, 0.5, 0.0)))


def test_an_observation_is_what_came_last(published):
    rig = desk()
    published.publish()
    said, images = rig.answer({"do": "observe"}, 1)
    state = said["state"]
    assert [state[f"kuka_joint_{i}.pos"] for i in range(1, 8)] == list(range(7)) and state["kuka_joint_7.torque"] == 6.0
    assert state["spread.pos"] == pytest.approx(0.3) and state["tool.x"] == 0.5 and state["tool.qw"] == 1.0
    assert images["color"].startswith(b"\xff\xd8")


@pytest.mark.parametrize(
    "silent", ["kuka/joint_positions", "kuka/joint_torques_external", "reflex_takktile/hand_state", MEASURED]
)
def test_of_a_device_that_is_silent_there_is_no_observation(published, silent):
    rig = desk()
    published.publish(silent)
    with pytest.raises(DeviceError, match=f"{silent} has said nothing"):
        rig.answer({"do": "observe"}, 1)
    published.publish()
    rig.answer({"do": "observe"}, 1)
    for _ in range(32 if "torques" in silent else 6):
        published.publish(silent)
    with pytest.raises(DeviceError, match=f"{silent} has said nothing"):
        rig.answer({"do": "observe"}, 1)


def test_a_camera_that_is_silent_is_named(published):
    rig = desk()
    published.publish("camera/rgb/image_raw")
    with pytest.raises(DeviceError, match="color has said nothing yet"):
        rig.answer({"do": "observe"}, 1)


def test_the_intent_is_what_the_hand_commands_else_where_the_rig_is(published):
    rig, fingers = desk(), rospy.Publisher("reflex_takktile/radian_hand_command", RadianServoCommands, queue_size=1)
    with pytest.raises(DeviceError, match="where the tool is"):
        rig.answer({"do": "intent"}, 1)
    published.publish()
    found = rig.answer({"do": "intent"}, 1)[0]["action"]
    assert (found["tool.x"], found["spread.pos"]) == (0.5, pytest.approx(0.3)) and found.keys() == set(ACTION)
    published.place(DESIRED, 0.6)
    fingers.publish(RadianServoCommands([0.75] * 4))
    clock.sleep(LATE_S)
    found = rig.answer({"do": "intent"}, 1)[0]["action"]
    assert (found["tool.x"], found["spread.pos"]) == (0.6, 0.75)
    published.place(DESIRED, 0.6, q=(0.0, -1.0, 0.0, 0.0))
    clock.sleep(LATE_S)
    found = rig.answer({"do": "intent"}, 1)[0]["action"]
    assert [found[f"tool.q{axis}"] for axis in "xyzw"] == [0.0, 1.0, 0.0, 0.0], "as in a dataset"


def test_actions_go_to_who_leads_the_tool_which_says_why_it_does_not(published, virtual_graph):
    rig, sent = desk(), virtual_graph.record("leap_kuka/policy_actions", PolicyActions)
    states = rospy.Publisher("leap_kuka/state", TeleopState, queue_size=1)
    rospy.Service("leap_kuka/run_policy", SetBool, lambda request: (True, ""))

    def acted(**state):
        if state:
            states.publish(TeleopState(**state))
        clock.sleep(0.1)
        return rig.answer({"do": "act", "action": action(0.52)}, 1)[0]["refused"]

    assert [acted() for _ in range(4)] == [""] * 4, "leap_kuka needs a moment"
    for _ in range(2):
        said = acted()
    assert said == "The action moves nothing: leap_kuka says nothing."
    assert acted(hold="led", reason="a program steers the tool") == ""
    assert acted(hold="none", reason="right hand 8 is followed") == (
        "The action moves nothing: right hand 8 is followed."
    )
    later = [acted() for _ in range(35)]
    assert later[15] == "The action moves nothing: right hand 8 is followed."
    assert later[-1] == "The action moves nothing: leap_kuka says nothing."
    clock.sleep(1.0)
    assert acted() == "", "a new beginning"
    message = sent[-1]
    assert (message.header.frame_id, message.period) == ("kuka/base_frame", 0.3) and len(message.tool) == 1
    assert (message.tool[0].position.x, message.tool[0].orientation.w, message.fingers[0]) == (0.52, 1.0, 0.5)


def test_each_program_may_steer_from_its_first_action_but_not_again_once_it_was_stopped(published):
    """The permission of the server's start has ended long before LeRobot acts."""
    asked, rig = [], desk()
    rospy.Service("leap_kuka/run_policy", SetBool, lambda r: asked.append(r.data) or (len(asked) < 2, "Not now."))
    act = {"do": "act", "action": action()}
    for program, said in enumerate(("", "Not now."), 1):
        rig.answer({"do": "hello"}, program)
        assert len(asked) == program - 1, "it may look first"
        assert rig.answer(act, program)[0]["refused"] == said
        rig.answer(act, program)
        assert asked == [True] * program
        clock.sleep(2.0)
    rig.answer({"do": "hello"}, 3)
    rig.answer(act, 2)
    assert len(asked) == 2, "another program that comes lets the one that was stopped steer no more"
    reading = desk(moves=False)
    reading.answer({"do": "hello"}, 4)
    reading.answer(act, 4)
    assert len(asked) == 2


def acted(rig, client, x, after=0.3):
    clock.sleep(after)
    return rig.answer({"do": "act", "action": action(x)}, client)[0]["refused"]


def test_of_two_programs_one_moves_the_tool_and_the_other_connects_again_first(published, virtual_graph):
    asked, rig = [], desk()
    sent = virtual_graph.record("leap_kuka/policy_actions", PolicyActions)
    rospy.Service("leap_kuka/run_policy", SetBool, lambda request: asked.append(request.data) or (True, ""))
    for said in ("stop it, then connect again", *["does not move the tool: connect again"] * 3):
        assert acted(rig, 1, 0.51) == "" and said in acted(rig, 2, 0.52)
    assert "connect again" in acted(rig, 2, 0.52, after=2.0), "not by itself once the other one has stopped"
    assert acted(rig, 3, 0.53) == ""
    for after in (0.0, 5.0):
        assert "connect again" in acted(rig, 1, 0.54, after), "nor the one that was first"
    assert acted(rig, 3, 0.55) == "" and asked == [True, True]
    rig.left(3)
    assert acted(rig, 4, 0.56, after=0.0) == "", "nobody waits for a program that has ended"
    clock.sleep(LATE_S)
    assert [one.tool[0].position.x for one in sent] == [0.51] * 4 + [0.53, 0.55, 0.56]


def test_a_program_that_may_not_takes_the_tool_from_nobody(published, virtual_graph):
    rig, says = desk(), [True]
    sent = virtual_graph.record("leap_kuka/policy_actions", PolicyActions)
    service = rospy.Service("leap_kuka/run_policy", SetBool, lambda request: (says[0], "Not now."))
    assert acted(rig, 1, 0.51) == ""
    says[0] = False
    assert acted(rig, 2, 0.52, after=2.0) == "Not now." and "connect again" in acted(rig, 2, 0.52)
    service.shutdown()
    with pytest.raises(RigError, match="run_policy"):
        acted(rig, 3, 0.53)
    assert "connect again" in acted(rig, 3, 0.53)
    assert acted(rig, 1, 0.54) == ""
    clock.sleep(LATE_S)
    assert [one.tool[0].position.x for one in sent] == [0.51, 0.54]


def test_of_two_programs_that_ask_at_once_the_newer_one_moves_the_tool(published, virtual_graph):
    rig, said = desk(), {}
    sent = virtual_graph.record("leap_kuka/policy_actions", PolicyActions)

    def slowly(request):
        clock.sleep(1.5)
        return True, ""

    rospy.Service("leap_kuka/run_policy", SetBool, slowly)
    programs = [clock.Thread(target=lambda n=n: said.update({n: acted(rig, n, 0.5, 0.1 * n)})) for n in (1, 2)]
    for each in programs:
        each.start()
    for each in programs:
        each.join()
    clock.sleep(LATE_S)
    assert said[2] == "" and "Another LeRobot program moves the tool" in said[1] and len(sent) == 1


def test_a_second_program_that_steers_is_told_who_does_and_a_reading_one_is_not(virtual_graph, monkeypatch):
    monkeypatch.setattr(server_program, "LerobotServer", lambda *_: SimpleNamespace(close=lambda: None))
    rospy.Service("leap_kuka/run_policy", SetBool, lambda request: (True, ""))
    first = virtual_graph.run("leap_rig", "lerobot_server.py", "--moves")
    clock.sleep(1.0)
    second = virtual_graph.run("leap_rig", "lerobot_server.py", "--moves")
    assert second.wait(5.0) == 1 and "sends actions already, and two programs cannot steer" in second.log
    assert "/lerobot_server_" in second.log
    reading = virtual_graph.run("leap_rig", "lerobot_server.py")
    elsewhere = virtual_graph.run("leap_rig", "lerobot_server.py", "--moves", "__ns:=left", "--socket", "/x")
    clock.sleep(1.0)
    assert [one.poll() for one in (first, reading, elsewhere)] == [None] * 3
    for one in (first, reading):
        one.send_signal(signal.SIGINT)
        assert one.wait(5.0) == 0, one.log
    assert elsewhere.wait(30.0) == 1 and "is not offered" in elsewhere.log, "its own arm has no such service"


def test_where_no_program_can_steer_the_server_says_so(virtual_graph, monkeypatch):
    monkeypatch.setattr(server_program, "LerobotServer", lambda *_: SimpleNamespace(close=lambda: None))
    rospy.Service("leap_kuka/run_policy", SetBool, lambda request: (not request.data, "A program needs more."))
    refused = virtual_graph.run("leap_rig", "lerobot_server.py", "--moves")
    assert refused.wait(5.0) == 1 and "A program needs more." in refused.log


def test_of_two_arms_the_one_of_its_namespace_is_served(virtual_graph):
    rospy.set_param("/left/tf_prefix", "left")
    found, sent = [], virtual_graph.record("left/leap_kuka/policy_actions", PolicyActions)
    rig = PublishedRig("left/")

    def serve():
        rospy.init_node("lerobot_server")
        made = desk()
        rospy.Service("leap_kuka/run_policy", SetBool, lambda request: (True, ""))
        for _ in range(4):
            clock.sleep(0.5)
            made.answer({"do": "act", "action": action()}, 1)
            found.append(made.answer({"do": "observe"}, 1)[0]["state"])

    server = virtual_graph.start("lerobot_server.py", serve, "lerobot_server.py", "__ns:=left")
    while server.poll() is None:
        rig.place("left/kuka/base_frame", 5.0, "world")
        rig.publish()
    assert server.wait(1.0) == 0 and len(found) == 4, server.log
    assert found[-1]["tool.x"] == 0.5 and found[-1]["kuka_joint_3.pos"] == 2.0
    assert sent[-1].header.frame_id == "left/kuka/base_frame" and sent[-1].tool[0].position.x == 0.5


def test_what_is_no_action_is_refused_and_not_sent(published, virtual_graph):
    sent = virtual_graph.record("leap_kuka/policy_actions", PolicyActions)
    assert "not a finite number" in desk().answer({"do": "act", "action": action(float("nan"))}, 1)[0]["refused"]
    assert "without --moves" in desk(moves=False).answer({"do": "act", "action": action()}, 1)[0]["refused"]
    clock.sleep(LATE_S)
    assert not sent


@pytest.mark.parametrize("request_", [{}, {"do": "stop"}, {"do": "act"}, {"do": "act", "action": [1.0]}])
def test_another_request_is_refused(published, request_):
    with pytest.raises(DeviceError, match="must be hello"):
        desk().answer(request_, 1)
    assert desk(False).answer({"do": "hello"}, 1)[0] == {"moves": False, "action": ACTION, "cameras": ["color"]}


def test_the_options_have_defaults():
    options = _parser().parse_args([])
    assert (options.moves, options.camera, options.quality) == (False, ["/camera/rgb/image_raw"], 90)
