"""What run_policy.py publishes by what the rig publishes, and why it waits."""

import signal

import numpy as np
import pytest

pytest.importorskip("reflex_msgs.msg")
pytest.importorskip("torch")
import rospy
import torch
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from test_lerobot_server import LATE_S, MEASURED, PublishedRig
from tf2_msgs.msg import TFMessage

from common import clock
from leap_rig.policy.network import PolicyAbout, PolicyNetwork, saved
from leap_rig.policy.ros.run_program import PolicyRunner
from rig_msgs.msg import PolicyActions

pytestmark = pytest.mark.ros
HAND, DEPTH, INFO = "reflex_takktile/hand_state", "camera/depth/image", "camera/depth/camera_info"
AHEAD_M = 0.02


class SeenRig(PublishedRig):
    """Publishes what a policy sees, too: a camera that hangs 1 m above the base's origin and looks down on a table."""

    def __init__(self, of="", camera_in="kuka/base_frame"):
        super().__init__(of)
        self.depth, self.width, self.K = 0.9, 64, [60.0, 0, 31.5, 0, 60.0, 23.5, 0, 0, 1.0]
        self.angle = 0.1
        self.static = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        at = Transform(Vector3(5.0 * bool(of) + 0.5, 0.0, 1.0), Quaternion(1.0, 0.0, 0.0, 0.0))
        self.static.publish(TFMessage([TransformStamped(Header(0, rospy.Time.now(), camera_in), "camera", at)]))

    def messages(self):
        found = super().messages()
        if not hasattr(self, "depth"):
            return {**found, DEPTH: Image(), INFO: CameraInfo()}
        found[HAND].motor[0].joint_angle = self.angle
        stamp = Header(0, rospy.Time.now(), "camera")
        data = np.full((48, self.width), self.depth, "<f4").tobytes()
        found[DEPTH] = Image(stamp, 48, self.width, "32FC1", 0, 4 * self.width, data)
        info = CameraInfo(header=stamp, height=48, width=self.width, distortion_model="plumb_bob", K=self.K)
        info.D, info.R = [0.0] * 5, np.eye(3).ravel().tolist()
        info.P = [*self.K[:3], 0.0, *self.K[3:6], 0.0, *self.K[6:], 0.0]
        return {**found, INFO: info}

    def publish_for(self, s, *without):
        for _ in range(round(s / LATE_S)):
            self.publish(*without)


@pytest.fixture
def file(tmp_path):
    """A policy that always goes straight ahead."""
    network = PolicyNetwork(PolicyAbout("go", 10, 4, 1, True, True))
    with torch.no_grad():
        for one in network.parameters():
            one.zero_()
    network.action_mean.copy_(torch.tensor([AHEAD_M, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.4, 0.4, 0.4, 0.1]))
    path = tmp_path / "ahead.pt"
    path.write_bytes(saved(network))
    return path


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
        ({"depth": float("nan")}, "/camera/depth/image shows nothing at 0.3 to 2 m"),
        ({"depth": 900.0}, "the median of the depth is 900 m"),
        ({"K": [0.0] * 9}, "the camera is not calibrated"),
        ({"K": [float("nan")] * 9}, "the numbers of the camera_info are not finite"),
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
    rig.width = 72
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
