"""What run_policy.py publishes by what the rig publishes, and why it waits."""

import signal
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("reflex_msgs.msg")
pytest.importorskip("torch")
import rospy
import torch
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header, String
from std_srvs.srv import SetBool
from test_lerobot_server import LATE_S, MEASURED, PublishedRig
from tf2_msgs.msg import TFMessage

from common import clock
from common.ros.service_calls import call
from kuka_msgs.srv import setGripperControl, setKukaControl
from leap_rig.policy.network import PolicyAbout, PolicyNetwork, saved
from leap_rig.policy.ros.run_program import PolicyRunner
from rig_msgs.msg import PolicyActions
from rig_simulation.control_port import ControlClient
from simulated.hand_wire import HandNetwork

pytestmark = pytest.mark.ros
HAND, DEPTH, INFO = "reflex_takktile/hand_state", "camera/depth/image", "camera/depth/camera_info"
AHEAD_M = 0.02


def camera_messages(depth=0.9, width=64, K=(60.0, 0, 31.5, 0, 60.0, 23.5, 0, 0, 1.0)):
    """An image of a depth that is everywhere the same, and its camera_info."""
    stamp = Header(0, rospy.Time.now(), "camera")
    info = CameraInfo(header=stamp, height=48, width=width, distortion_model="plumb_bob", K=K)
    info.D, info.R = [0.0] * 5, np.eye(3).ravel().tolist()
    info.P = [*K[:3], 0.0, *K[3:6], 0.0, *K[6:], 0.0]
    data = np.full((48, width), depth, "<f4").tobytes()
    return {DEPTH: Image(stamp, 48, width, "32FC1", 0, 4 * width, data), INFO: info}


def hang_camera(parent, x=0.5):
    """Lets the camera hang 1 m above a frame's plane, and look down; returns who says so."""
    static = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
    at = Transform(Vector3(x, 0.0, 1.0), Quaternion(1.0, 0.0, 0.0, 0.0))
    static.publish(TFMessage([TransformStamped(Header(0, rospy.Time.now(), parent), "camera", at)]))
    return static


class SeenRig(PublishedRig):
    """Publishes what a policy sees, too: a camera over a table."""

    def __init__(self, of="", camera_in="kuka/base_frame"):
        self.camera, self.angle = {}, 0.1
        super().__init__(of)
        self.static = hang_camera(camera_in, 5.0 * bool(of) + 0.5)

    def messages(self):
        found = super().messages()
        found[HAND].motor[0].joint_angle = self.angle
        return {**found, **camera_messages(**self.camera)}

    def publish_for(self, s, *without):
        for _ in range(round(s / LATE_S)):
            self.publish(*without)


def ahead(path, down=False):
    """Writes a policy that always goes straight ahead, and returns its file; `down`: as the tool of a rig points."""
    network = PolicyNetwork(PolicyAbout("go", 10, 4, 1, True, True))
    with torch.no_grad():
        for one in network.parameters():
            one.zero_()
    y = -1.0 if down else 1.0
    network.action_mean.copy_(torch.tensor([AHEAD_M, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, y, 0.0, 0.4, 0.4, 0.4, 0.1]))
    path.write_bytes(saved(network))
    return path


@pytest.fixture
def file(tmp_path):
    return ahead(tmp_path / "ahead.pt")


def start(graph, file, *words):
    return graph.run("leap_rig", "run_policy.py", str(file), "--every", "0.2", *words)


def end(program):
    program.send_signal(signal.SIGINT)
    assert program.wait(5.0) == 0, program.log


def test_actions_are_seen_from_the_tool(virtual_graph, file):
    rig, sent, due = SeenRig(), virtual_graph.record("leap_kuka/policy_actions", PolicyActions), []
    rospy.Subscriber(
        "leap_kuka/policy_actions", PolicyActions,
        lambda message: due.append((message.header.stamp - rospy.Time.now()).to_sec()),
    )  # fmt: skip
    program = start(virtual_graph, file)
    rig.publish_for(2.0)
    end(program)
    message = sent[-1]
    np.testing.assert_allclose(due, message.period, atol=0.01, err_msg="the first one a period after what it saw")
    assert message.header.frame_id == "kuka/base_frame" and len(message.tool) == 4 and message.period == 0.1
    assert [one.position.x for one in message.tool] == pytest.approx([0.5 + AHEAD_M] * 4)
    np.testing.assert_allclose(np.reshape(message.fingers, (4, 4)), [[0.4, 0.4, 0.4, 0.1]] * 4, atol=1e-6)
    gaps = np.diff([one.header.stamp.to_sec() for one in sent])
    np.testing.assert_allclose(gaps, 0.2, atol=0.01)
    assert "was trained on 1 episodes: go" in program.log and "The policy acts." in program.log


def test_of_two_arms_the_one_of_its_namespace_is_steered(virtual_graph, file):
    rospy.set_param("/left/tf_prefix", "left")
    rig, sent = (
        SeenRig("left/", camera_in="world"),
        virtual_graph.record("left/leap_kuka/policy_actions", PolicyActions),
    )
    other = virtual_graph.record("leap_kuka/policy_actions", PolicyActions)
    program = start(virtual_graph, file, "__ns:=left")
    for _ in range(20):
        rig.place("left/kuka/base_frame", 5.0, "world")
        rig.publish()
    end(program)
    assert sent[-1].header.frame_id == "left/kuka/base_frame" and not other
    assert sent[-1].tool[0].position.x == pytest.approx(0.5 + AHEAD_M)


def test_on_a_rig_of_two_arms_it_moves_its_arm_and_hand_and_no_other(virtual_graph, tmp_path):
    arms = ("left", 30011, 11433), ("right", 30012, 11434)  # control ports of arm and hand
    relative = Path(__file__).parents[2] / "leap_kuka" / "config" / "relative_policy.yaml"
    camera = {
        topic: rospy.Publisher(topic, type(message), queue_size=1) for topic, message in camera_messages().items()
    }

    def see(seconds):
        for _ in range(round(seconds / LATE_S)):
            for topic, message in camera_messages().items():
                camera[topic].publish(message)
            clock.sleep(LATE_S)

    def angles():
        ports = [ControlClient("127.0.0.1", port) for _, *ports in arms for port in ports]
        states = [port.ask("state") for port in ports]
        return [np.array(state.get("joints") or state["angles"]) for state in states]

    def moved(since):
        return [np.abs(now - before).max() > 0.05 for now, before in zip(angles(), since)]

    with HandNetwork():
        hidden = dict.fromkeys(("gui", "operator_view", "auto_start"), "false")
        virtual_graph.launch("leap_rig", "demo.launch", robots=2, view="none", leap_overrides=str(relative), **hidden)
        static = hang_camera("left/kuka/base_frame")
        modes = {arm: virtual_graph.record(f"{arm}/kuka/mode", String) for arm, *_ in arms}
        virtual_graph.wait_until(
            lambda: all(said and said[-1].data == "home" for said in modes.values()), 30.0, "both arms at home"
        )
        for arm, *_ in arms:
            assert call(f"{arm}/kuka/kuka_control", setKukaControl, True, timeout=5.0).success
            assert call(f"{arm}/kuka/gripper_control", setGripperControl, True, timeout=5.0).success
        ControlClient("127.0.0.1", 16437).ask("pause")  # no hands
        program, start_angles = start(virtual_graph, ahead(tmp_path / "ahead.pt", down=True), "__ns:=left"), angles()
        see(2.0)
        assert "The policy acts." in program.log and not any(moved(start_angles)), "nobody has said that it may"
        assert call("left/leap_kuka/run_policy", SetBool, True, timeout=5.0).success
        see(3.0)
        assert moved(start_angles) == [True, True, False, False], program.log
        assert [modes[arm][-1].data for arm, *_ in arms] == ["servo", "home"]
        end(program)
    static.unregister()


@pytest.mark.parametrize(
    "silent, after, why",
    [
        (MEASURED, 0.5, f"Nothing says where {MEASURED} is in kuka/base_frame"),
        (HAND, 0.5, f"{HAND} has said nothing for"),
        (DEPTH, 3.5, f"/{DEPTH} has said nothing for"),
        (INFO, 3.5, f"/{INFO} has said nothing for"),
    ],
)
def test_where_something_is_silent_the_policy_waits_and_says_so_once(virtual_graph, file, silent, after, why):
    rig, sent = SeenRig(), virtual_graph.record("leap_kuka/policy_actions", PolicyActions)
    program = start(virtual_graph, file)
    rig.publish_for(1.0)
    rig.publish_for(after, silent)
    count = len(sent)
    rig.publish_for(1.0, silent)
    assert len(sent) == count > 3
    rig.publish_for(1.0)
    assert len(sent) > count, "it continues"
    end(program)
    assert program.log.count(f"The policy waits: {why}") == 1, program.log


@pytest.mark.parametrize(
    "change, why",
    [
        ({"camera": {"depth": float("nan")}}, "/camera/depth/image shows nothing at 0.3 to 2 m"),
        ({"camera": {"depth": 900.0}}, "the median of the depth is 900 m"),
        ({"camera": {"K": [0.0] * 9}}, "the camera is not calibrated"),
        ({"camera": {"K": [float("nan")] * 9}}, "the numbers of the camera_info are not finite"),
        ({"angle": float("nan")}, "the angles of the hand's motors are not all finite"),
    ],
)
def test_what_cannot_be_is_not_acted_on(virtual_graph, file, change, why):
    rig, sent = SeenRig(), virtual_graph.record("leap_kuka/policy_actions", PolicyActions)
    vars(rig).update(change)
    program = start(virtual_graph, file)
    rig.publish_for(1.5)
    end(program)
    assert not sent and f"The policy waits: {why}" in program.log, program.log


def test_a_camera_that_gets_another_size_is_seen_through_its_new_camera_info(virtual_graph, file):
    rig, sent = SeenRig(), virtual_graph.record("leap_kuka/policy_actions", PolicyActions)
    program = start(virtual_graph, file)
    rig.publish_for(1.0)
    rig.camera = {"width": 72}
    rig.publish_for(0.5)
    count = len(sent)
    rig.publish_for(1.0)
    end(program)
    assert len(sent) > count, program.log


def test_a_second_program_is_told_who_steers_and_the_first_one_stays(virtual_graph, file):
    first = start(virtual_graph, file)
    clock.sleep(1.0)
    second = start(virtual_graph, file)
    assert second.wait(5.0) == 1 and "sends actions already, and two programs cannot steer: end it" in second.log
    clock.sleep(1.0)
    assert first.poll() is None, first.log
    end(first)


def test_a_shutdown_while_the_policy_thinks_ends_it_without_a_traceback(virtual_graph, file, monkeypatch):
    def ends(self):
        self._actions.unregister()  # as rospy does then
        rospy.signal_shutdown("now")

    monkeypatch.setattr(PolicyRunner, "_message", ends)
    program = start(virtual_graph, file)
    assert program.wait(5.0) == 0 and "Traceback" not in program.log, program.log


def test_files_and_times_that_do_not_fit_are_refused(virtual_graph, file, tmp_path):
    torn = tmp_path / "torn.pt"
    torn.write_bytes(file.read_bytes()[:1000])
    for words, why in (
        ([str(tmp_path)], f"{tmp_path} cannot be read: Is a directory."),
        ([str(torn)], f"{torn}: The file holds no policy of this release: it is torn"),
        ([str(file), "--every", "0.5"], "--every is 0.5 s, but what the policy says lasts 0.4 s"),
    ):
        program = virtual_graph.run("leap_rig", "run_policy.py", *words)
        assert program.wait(5.0) == 1 and why in program.log, program.log
