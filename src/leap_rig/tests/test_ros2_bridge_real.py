"""The bridge to ROS 2 with real nodes on both sides. `make ros2` installs what they need."""

import contextlib
import json
import math
import os
import random
import shlex
import signal
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rig_msgs.srv")
import actionlib
import rosgraph
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TransformStamped, Vector3, Vector3Stamped
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from common.ros.images import image_message
from kuka_msgs.msg import MoveAction, MoveFeedback, MoveResult
from leap_rig.ros2.config import LOCALHOST, SUBNET
from leap_rig.ros2.variables import side_variables
from rig_msgs.msg import KukaStatus, TeleopState

ROOT = Path(__file__).parents[3]
PYTHON = ROOT / ".venv-ros2" / "bin" / "python"
PEER = Path(__file__).with_name("ros2_peer.py")

pytestmark = [pytest.mark.ros, pytest.mark.long]
needs_ros2 = pytest.mark.skipif(not PYTHON.is_file(), reason="ROS 2 is not installed: make ros2")
DESIRED = "kuka/tool_frame/desired"
TWO_MACHINES = """
mount -t tmpfs tmpfs /run && ip netns add other && ip link add one type veth peer name two netns other || exit 77
ip link set lo up && ip addr add 10.35.0.1/24 dev one && ip link set one up
ip -n other link set lo up && ip -n other addr add 10.35.0.2/24 dev two && ip -n other link set two up
"""


def test_without_ros2_the_node_says_how_to_get_it(ros):
    bridge = ros.run("leap_rig", "ros2_bridge.py", "_python:=/nowhere/python", "__name:=no_bridge")
    assert bridge.wait(30.0) == 1
    assert "make ros2" in bridge.log_path.read_text()


@needs_ros2
@pytest.mark.parametrize("discovery", [LOCALHOST, SUBNET])
def test_another_machine_reaches_the_rig_only_with_discovery_subnet(discovery):
    def on_its_own(variables, *words):
        """A process on a machine of its own: nothing of the memory that Fast DDS shares."""
        command = shlex.join(["env", *(f"{k}={v}" for k, v in variables.items()), str(PYTHON), str(PEER), *words])
        return f"unshare --mount --ipc sh -c {shlex.quote(f'mount -t tmpfs tmpfs /dev/shm && exec {command}')}"

    rig = side_variables({}, discovery, str(ROOT / "src/leap_rig/config/ros2_loopback.xml"))
    theirs = {"ROS_STATIC_PEERS": "10.35.0.1", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    listener, publisher = on_its_own(rig, "listen"), on_its_own(theirs, "publish", "good")
    script = f"{TWO_MACHINES}timeout 25 {listener} &\nsleep 5; timeout 15 ip netns exec other {publisher}; wait"
    environment = {"PATH": os.environ["PATH"], "HOME": os.environ["HOME"]}
    done = subprocess.run(
        ["unshare", "--net", "--mount", "--map-root-user", "sh", "-c", script],
        env=environment, capture_output=True, text=True, timeout=120.0,
    )  # fmt: skip
    if done.returncode == 77 or "unshare failed" in done.stderr:
        pytest.skip("this machine lets nobody make networks (unshare, ip)")
    assert (DESIRED in done.stdout) is (discovery == SUBNET), done.stdout + done.stderr


@pytest.fixture
def peer(processes, monkeypatch):
    """Starts nodes of ROS 2 in a domain of the test's own."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(random.SystemRandom().randrange(1, 100)))

    def start(*words):
        own = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "PYTHONPATH": ""}
        process = processes.start(str(PYTHON), str(PEER), *words, env=own)
        process.lines = lambda: [json.loads(x) for x in process.log_path.read_text().splitlines() if x.endswith("}")]
        return process

    return start


@pytest.fixture
def bridge(ros, peer, wait_until):
    """The bridge, once ROS 2 is there."""
    node = ros.run("leap_rig", "ros2_bridge.py")
    states = ros.record("/diagnostics", DiagnosticArray)
    wait_until(lambda: states or node.poll() is not None, 30.0, "the bridge")
    assert node.poll() is None, node.log_path.read_text()
    yield node


class Rig:
    """Publishes ten times a second what the rig does, or one `arm` of several, until it is stopped."""

    def __init__(self, arm=""):
        kinds = {
            "joint_states": JointState(Header(), [f"{arm}kuka/joint_1"], [0.5], [], []),
            "/tf": TFMessage([self.transform("kuka/link_1")]),
            "kuka/flange_force": Vector3Stamped(Header(), Vector3(1.5, 0.0, 0.0)),
            "kuka/flange_torque": Vector3Stamped(Header(), Vector3(0.0, 0.0, 2.5)),
            "camera/rgb/image_raw": image_message(np.zeros((48, 64, 3), np.uint8), "rgb8", "camera", rospy.Time(1)),
            "camera/rgb/camera_info": CameraInfo(height=48, width=64, K=[50.0, *[0.0] * 8]),
            "leap_kuka/stream": DiagnosticStatus(message=f"{arm or 'a'} hand is followed"),
            "leap_kuka/state": TeleopState(state="running", follows=True, limits=["yaw"]),
            "kuka/status": KukaStatus(mode="stopped", reason="It stands."),
        }
        self.publishers = {
            rospy.Publisher(topic if topic.startswith(("/", "camera")) else arm + topic, type(m), queue_size=1): m
            for topic, m in kinds.items()
        }
        self.static = [rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)]
        self.static[0].publish(TFMessage([self.transform("kuka/flange")]))
        rospy.set_param(f"{arm}robot_description", f"<robot name='{arm}'/>")
        self.stop = threading.Event()
        threading.Thread(target=self.run, daemon=True).start()

    @staticmethod
    def transform(child):
        message = TransformStamped(child_frame_id=child)
        message.header.frame_id = "kuka/base_frame"
        message.transform.rotation.w = 1.0
        return message

    def run(self):
        while not self.stop.wait(0.1):
            for publisher, message in self.publishers.items():
                for stamped in (*getattr(message, "transforms", ()), message):
                    if hasattr(stamped, "header"):
                        stamped.header.stamp = rospy.Time.now()
                publisher.publish(message)


@pytest.fixture
def rig(ros):
    made = Rig()
    yield made
    made.stop.set()


@needs_ros2
def test_ros2_hears_the_rig(bridge, rig, peer, wait_until, ros):
    unheard = ros.record("/diagnostics", DiagnosticArray)
    listener = peer("listen")
    wanted = {
        "joint_states": ["kuka/joint_1", 0.5],
        "tf": ["kuka/link_1"],
        "tf_static": ["kuka/flange"],
        "robot_description": "<robot name=''/>",
        "kuka/flange_wrench": [1.5, 2.5],
        "camera/rgb/image_raw/compressed": ["rgb8; jpeg compressed bgr8", True],
        "camera/rgb/camera_info": [48, 64, 50.0],
        "leap_kuka/stream": "a hand is followed",
    }

    def heard():
        return {line["topic"]: line["value"] for line in listener.lines()}

    wait_until(lambda: wanted.items() <= heard().items() and len(heard()) == 11, 30.0, f"all of {heard()}")
    assert heard()["leap_kuka/state"]["limits"] == "yaw" and heard()["leap_kuka/state"]["follows"] == "true"
    level, values = heard()["kuka/status"]
    assert level == DiagnosticStatus.ERROR[0] if isinstance(DiagnosticStatus.ERROR, bytes) else level == 2
    assert values["mode"] == "stopped"
    late = peer("listen")
    wait_until(lambda: any(line["topic"] == "tf_static" for line in late.lines()), 30.0, "the latched transforms")
    image = rospy.Publisher("camera/rgb/image_raw", Image, queue_size=1)
    assert image.get_num_connections() > 0
    os.killpg(listener.pid, signal.SIGINT)
    os.killpg(late.pid, signal.SIGINT)
    wait_until(lambda: image.get_num_connections() == 0, 30.0, "nobody who needs images")
    assert unheard


@needs_ros2
def test_who_expects_another_type_is_told(bridge, peer, wait_until):
    peer("mistake")
    said = "expects std_msgs/msg/String on /kuka/status, which is diagnostic_msgs/msg/DiagnosticStatus"
    wait_until(lambda: said in bridge.log_path.read_text(), 30.0, "the sentence")


@needs_ros2
def test_the_desired_tool_of_ros2_reaches_tf_and_nothing_else(bridge, peer, wait_until, ros):
    heard = ros.record("/tf", TFMessage)
    rig = rospy.Publisher("/tf", TFMessage, queue_size=1)
    peer("publish", "nan", "kuka/link_3")
    publisher = peer("publish", "good")
    listener = peer("listen")  # the bridge passes tf to ROS 2, and must not take it back
    heard.wait(20)
    assert {t.child_frame_id for message in heard for t in message.transforms} == {DESIRED}
    assert {message.transforms[0].transform.translation.x for message in heard} == {0.125}
    os.killpg(publisher.pid, signal.SIGINT)
    publisher.wait(30.0)
    own = Rig.transform(DESIRED)
    own.header.frame_id = "a frame of ROS 1"
    wait_until(rig.get_num_connections, 30.0, "listeners of tf")

    def in_ros2():
        own.header.stamp = rospy.Time.now()
        rig.publish(TFMessage([own]))
        return sum(line["value"] == [DESIRED] for line in listener.lines() if line["topic"] == "tf") > 30

    wait_until(in_ros2, 30.0, "the frame in ROS 2")
    nodes = {m._connection_header["callerid"] for m in heard if m.transforms[0].header.frame_id == own.header.frame_id}
    assert nodes == {rospy.get_name()}


@needs_ros2
@pytest.mark.parametrize("kind", ["nan", "static", "two"])
def test_a_desired_tool_that_is_not_right(bridge, peer, wait_until, ros, kind):
    heard = ros.record("/tf", TFMessage)
    first = peer("publish", "good" if kind == "two" else kind)
    if kind == "nan":  # is the controller's to refuse
        heard.wait(3)
        assert math.isnan(heard[0].transforms[0].transform.translation.x)
        return
    if kind == "two":
        heard.wait(3)
        peer("publish", "good")
    wait_until(lambda: "is refused" in bridge.log_path.read_text(), 30.0, "the refusal")
    assert first.poll() is None and (heard or kind == "static")
    assert kind == "two" or not heard


class Server:
    """A controller's kuka/move: `home` succeeds, what is called `cancelled` or `lost` runs until it is cancelled."""

    def __init__(self, arm=""):
        self.cancelled = threading.Event()
        self.started = threading.Event()
        self._server = actionlib.SimpleActionServer(f"{arm}kuka/move", MoveAction, self._run, auto_start=False)
        self._server.start()

    def close(self):
        self._server.action_server.status_timer.shutdown()
        self._server.action_server.status_timer.join()
        self._server.need_to_terminate = True

    def _run(self, goal):
        self._server.publish_feedback(MoveFeedback(0.5, 0.1, [0.0] * 7))
        self.started.set()
        while goal.name != "home" and not self._server.is_preempt_requested():
            rospy.sleep(0.02)
        if goal.name == "home":
            self._server.set_succeeded(MoveResult(True, "At home.", [0.0] * 7))
        else:
            self.cancelled.set()
            self._server.set_preempted(MoveResult(False, "Cancelled.", [0.0] * 7))


@pytest.fixture
def server(ros):
    made = Server()
    yield made
    made.close()


SUCCEEDED, CANCELLED, ABORTED = 4, 5, 6  # action_msgs/GoalStatus


@needs_ros2
@pytest.mark.parametrize("name, status", [("home", SUCCEEDED), ("cancelled", CANCELLED)])
def test_ros2_moves_the_arm(bridge, peer, server, name, status):
    client = peer("move", name)
    assert client.wait(60.0) == 0
    accepted, *feedback, result = client.lines()
    assert accepted == {"accepted": True} and result["status"] == status
    assert result["message"] == ("At home." if name == "home" else "Cancelled.")
    assert all(line == {"feedback": 0.5} for line in feedback)
    assert server.cancelled.is_set() is (name != "home")


@needs_ros2
def test_a_goal_without_a_controller_ends(bridge, peer):
    client = peer("move", "home")
    assert client.wait(60.0) == 0
    assert client.lines()[-1]["status"] == ABORTED and "Nobody offers" in client.lines()[-1]["message"]


@needs_ros2
@pytest.mark.parametrize("who", ["client", "side", "node", "interrupt"])
def test_who_ends_in_a_motion_cancels_it(bridge, peer, server, wait_until, who):
    client = peer("move", "lost")
    wait_until(server.started.is_set, 30.0, "the motion")
    (side,) = Path(f"/proc/{bridge.pid}/task/{bridge.pid}/children").read_text().split()
    ends = {"client": (client.pid, signal.SIGINT), "side": (int(side), signal.SIGKILL)}
    ends.update(node=(bridge.pid, signal.SIGKILL), interrupt=(bridge.pid, signal.SIGINT))
    os.kill(*ends[who])
    wait_until(server.cancelled.is_set, 30.0, "the cancellation")
    if who in ("side", "interrupt"):
        assert bridge.wait(30.0) == (1 if who == "side" else 0)
    if who != "client":
        wait_until(lambda: not Path("/proc", side).exists(), 30.0, "the end of the ROS 2 side")


@needs_ros2
def test_each_of_two_arms_has_its_own_door(ros, peer, wait_until):
    for arm in ("left", "right"):
        rospy.set_param(f"{arm}/tf_prefix", arm)
    node = ros.run("leap_rig", "ros2_bridge.py", "_arms:=[left, right]")
    heard = ros.record("/tf", TFMessage)
    servers = {arm: Server(arm) for arm in ("left/", "right/")}
    try:
        peer("publish", "good", f"left/{DESIRED}")
        peer("publish", "good", DESIRED)  # the topic of a rig with one arm, which this is not
        client = peer("move", "cancelled", "right/")
        assert client.wait(90.0) == 0 and client.lines()[-1]["status"] == CANCELLED
        assert servers["right/"].started.is_set() and not servers["left/"].started.is_set()
        wait_until(lambda: len(heard) > 20, 30.0, "the left arm's frame")
        peer("publish", "good", f"right/{DESIRED}")  # beside that of the left one, which continues
        names = lambda: {t.child_frame_id for message in heard for t in message.transforms}  # noqa: E731
        wait_until(lambda: f"right/{DESIRED}" in names(), 30.0, "the right arm's frame")
        assert names() == {f"left/{DESIRED}", f"right/{DESIRED}"}
        assert "refused" not in node.log_path.read_text()
    finally:
        for server in servers.values():
            server.close()
        for arm in ("left", "right"):
            rospy.delete_param(f"{arm}/tf_prefix")


@needs_ros2
def test_ros2_hears_each_of_two_arms_by_its_name(ros, peer, wait_until):
    ros.run("leap_rig", "ros2_bridge.py", "_arms:=[left, right]")
    rigs = {arm: Rig(arm) for arm in ("left/", "right/")}
    try:
        for arm, listener in {arm: peer("listen", arm) for arm in rigs}.items():
            wanted = {
                "joint_states": [f"{arm}kuka/joint_1", 0.5],
                "robot_description": f"<robot name='{arm}'/>",
                "kuka/flange_wrench": [1.5, 2.5],
                "leap_kuka/stream": f"{arm} hand is followed",
            }
            heard = lambda of=listener: {line["topic"]: line["value"] for line in of.lines()}  # noqa: E731
            wait_until(lambda: wanted.items() <= heard().items() and len(heard()) == 11, 60.0, f"all of {arm}")  # noqa: B023
    finally:
        for rig in rigs.values():
            rig.stop.set()


@needs_ros2
def test_after_a_restart_of_nodes_it_goes_on_and_after_one_of_the_master_it_says_what_to_do(
    processes, peer, free_port, wait_until, tmp_path
):
    uri = f"http://localhost:{free_port()}"
    own = {"ROS_MASTER_URI": uri, "ROS_HOME": str(tmp_path), "ROS_LOG_DIR": str(tmp_path / "log")}

    def begin():
        core = processes.start("rosmaster", "--core", "-p", uri.rpartition(":")[2], env=own)
        master = rosgraph.Master("/test", uri)

        def answers():
            with contextlib.suppress(OSError):
                return master.getPid()

        wait_until(answers, 30.0, "the master")
        return core

    def node(says):
        kind, value = "diagnostic_msgs/DiagnosticStatus", f"{{message: {says}}}"
        return processes.start("rostopic", "pub", "-r", "10", "leap_kuka/stream", kind, value, env=own)

    core, first = begin(), node("first")
    bridge = processes.start("rosrun", "leap_rig", "ros2_bridge.py", env=own)
    listener = peer("listen")

    def heard(text):
        assert bridge.poll() is None, bridge.log_path.read_text()
        return any(line["topic"] == "leap_kuka/stream" and line["value"] == text for line in listener.lines())

    wait_until(lambda: heard("first"), 60.0, "the node")
    processes.end(first)
    node("second")
    wait_until(lambda: heard("second"), 60.0, "the node that was started anew")
    core.kill()
    wait_until(lambda: "start it again" in bridge.log_path.read_text(), 30.0, "the sentence")
    assert bridge.poll() is None
    begin()
    assert bridge.wait(60.0) == 1
    assert "was started anew and does not know this node" in bridge.log_path.read_text()
