"""The node ggcnn: what it publishes, what it says where there is no grasp, and how it ends."""

from __future__ import annotations

import hashlib
import re
import signal
from pathlib import Path

import numpy as np
import pytest
import torch
from table_scene import CAMERA, depth_picture, looking_at

from common import clock
from common.config import parse
from common.errors import RigError
from common.frames import DEPTH_OPTICAL
from common.numbers import LABEL_M
from common.poses import inverse, pose
from grasping.network.maps import PARALLEL, REFLEX
from grasping.pipeline.settings import AUTO, MUST, NetworkConfig
from grasping.poses import lift_network
from grasping.poses.lift_network import LiftNetwork

pytest.importorskip("rig_msgs.srv")
import roslib.message
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import CameraInfo, Image, TimeReference

from common.ros.conversions import pose_from_message, pose_from_transform, stamped_transform
from common.ros.images import array_from_image, camera_info_message, image_message
from grasp_msgs.msg import GraspList
from grasping.pipeline.pipeline import GraspPipeline
from grasping.pipeline.settings import live_origin, overlaid, settings_from
from grasping.pipeline.tool_pose import ASKED, RETRY_S, SILENT
from grasping.poses.candidates import TASTES
from grasping.poses.hand_view import SCALARS
from grasping.poses.taste import nobody
from grasping.poses.taste_file import Origin, TasteFile, content
from grasping.ros.weight_files import load_lifts, load_network, load_refinement, own_yaml
from rig_msgs.srv import CheckToolPose, CheckToolPoseResponse
from tools import launched

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros

BOX = (0.03, -0.02, 0.3, (0.06, 0.08, 0.08))
ASIDE = looking_at((0.45, 0.1, 0.65), (0.0, 0.0, 0.0))
DOWN = ASIDE[:3, :3].T @ (0.0, 0.0, -1.0)
PERIOD_S = 0.1
LATER_S = 0.01
"""Of the camera's images, and how much later messages come and go."""
DIAGNOSTICS_S, WAIT_S, KIND_PERIOD_S = 0.5, 0.2, 1.0
"""Of the node: time between diagnostics, longest wait for an image, and time between two looks at the kind."""
GRIP = (-0.0152, 0.0, 0.07)  # in the tool, by tool_pose.yaml
R_LINK_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
TYPES = {
    "out/grasps": "grasp_msgs/GraspList",
    "out/command": "std_msgs/Float32MultiArray",
    "out/target_pose": "geometry_msgs/PoseStamped",
    "img/grasp": "sensor_msgs/Image",
    "img/grasp_plain": "sensor_msgs/Image",
    "img/depth": "sensor_msgs/Image",
    "img/ang": "sensor_msgs/Image",
    "img/heat_map": "sensor_msgs/Image",
    "markers": "visualization_msgs/MarkerArray",
}


class Camera:
    """Publishes a depth image ten times a second, with a new stamp each time.

    Attributes:
        period: time between two images [s].
        depth: the image; None: nothing is published.
        late: how much earlier than now its stamp is [s].
        info: whether camera_info comes too.
    """

    def __init__(self, depth):
        self.period, self.depth, self.late, self.info = PERIOD_S, depth, 0.0, True
        self.frame = DEPTH_OPTICAL
        self._image = rospy.Publisher("camera/depth/image", Image, queue_size=1)
        self._info = rospy.Publisher("camera/depth/camera_info", CameraInfo, queue_size=1)
        self._ended = clock.Event()
        self._thread = clock.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def close(self):
        self._ended.set()
        self._thread.join()
        self._image.unregister()
        self._info.unregister()

    def _loop(self):
        while not self._ended.wait(self.period):
            depth = self.depth
            if depth is None:
                continue
            stamp = rospy.Time.now() - rospy.Duration(self.late)
            if self.info:
                self._info.publish(camera_info_message(CAMERA, self.frame, stamp))
            encoding = "16UC1" if depth.dtype == np.uint16 else "32FC1"
            self._image.publish(image_message(depth, encoding, self.frame, stamp))


@pytest.fixture(scope="module")
def depth():
    return depth_picture(ASIDE, [BOX])


@pytest.fixture
def camera(ros, depth):
    made = Camera(depth)
    yield made
    made.close()


@pytest.fixture
def calibrated(ros):
    """The camera's pose in the base, and its own frames, as vision's nodes publish them."""
    broadcaster, now = tf2_ros.StaticTransformBroadcaster(), rospy.Time.now()
    T_link_optical = pose(R_LINK_OPTICAL)
    broadcaster.sendTransform([
        stamped_transform(ASIDE @ inverse(T_link_optical), "kuka/base_frame", "camera_depth_frame", now),
        stamped_transform(T_link_optical, "camera_depth_frame", DEPTH_OPTICAL, now),
    ])  # fmt: skip
    yield
    broadcaster.pub_tf.unregister()


def start(ros, **changes):
    """Starts the node with changes to the package's parameters; a key may be section/name."""
    for key, value in changes.items():
        rospy.set_param(f"ggcnn/{key.replace('__', '/')}", value)
    return ros.run("grasping", "ggcnn.py")


def statuses(ros):
    """Returns a function that gives the message and the values of the node's last status."""
    arrays = ros.record("/diagnostics", DiagnosticArray)

    def read() -> dict:
        found = [s for array in arrays for s in array.status if s.name == "ggcnn"]
        return {"message": found[-1].message, **{v.key: v.value for v in found[-1].values}} if found else {}

    return read


def newest(ros, messages, condition, what, seconds=2 * PERIOD_S):
    """Waits for a message for which the condition holds, among those that come from now on; returns it."""
    seen = len(messages)
    found = lambda: next((m for m in messages[seen:] if condition(m)), None)  # noqa: E731
    return ros.wait_until(found, seconds, what, poll=LATER_S)


def seconds_between(first, second):
    return (second.header.stamp - first.header.stamp).to_sec()


def test_what_it_publishes(ros, camera, calibrated):
    classes = {name: roslib.message.get_message_class(kind) for name, kind in TYPES.items()}
    got = {name: ros.record(f"ggcnn/{name}", kind) for name, kind in classes.items()}
    times, status = ros.record("rig/stage_times", TimeReference), statuses(ros)
    buffer = tf2_ros.Buffer()
    tf2_ros.TransformListener(buffer)
    process = start(ros, reach__ask=False)
    clock.sleep(2 * DIAGNOSTICS_S + 2 * PERIOD_S)

    stamps = {m.header.stamp for m in got["out/target_pose"]}
    found = next(m for m in got["out/grasps"] if m.grasps and m.header.stamp in stamps)
    best, stamp = found.grasps[0], found.header.stamp
    assert (found.header.frame_id, found.reason) == (DEPTH_OPTICAL, "")
    assert (best.reachable, best.reason) == (True, "")
    T_base, T_camera = pose_from_message(best.pose_base.pose), pose_from_message(best.pose_camera)
    assert (best.pose_base.header.frame_id, best.pose_base.header.stamp) == ("kuka/base_frame", stamp)
    np.testing.assert_allclose(ASIDE @ T_camera, T_base, atol=1e-6)
    assert np.hypot(*(T_base[:2, 3] - BOX[:2])) < 0.03
    assert T_base[2, 3] == pytest.approx(0.08, abs=0.01)
    assert 0.05 < best.width < 0.12
    np.testing.assert_allclose(CAMERA.project(T_camera[:3, 3]), best.pixel, atol=1e-2)

    target = next(m for m in got["out/target_pose"] if m.header.stamp == stamp)
    np.testing.assert_allclose(pose_from_message(target.pose), T_base, atol=1e-6)
    data = got["out/command"][-1].data
    assert len(data) == 6
    np.testing.assert_allclose(data[:3], T_camera[:3, 3], atol=5e-3)
    for name in ("img/grasp", "img/grasp_plain", "img/depth", "img/ang", "img/heat_map"):
        message = got[name][-1]
        side = 600 if name == "img/heat_map" else 300
        assert (message.width, message.height, message.header.frame_id) == (side, side, "ggcnn/view")
        assert np.isfinite(np.asarray(array_from_image(message), float)).all()
    grippers, labels = ([m for m in got["markers"][-1].markers if m.ns == ns and m.id] for ns in ("grasps", "labels"))
    assert {len(m.points) for m in grippers} == {8} and labels[0].id == grippers[0].id
    at = [(p.x, p.y, p.z) for p in (m.pose.position for m in labels)]
    assert all(np.linalg.norm(np.subtract(p, q)) > LABEL_M for i, p in enumerate(at) for q in at[:i])
    moved = buffer.lookup_transform("kuka/base_frame", "camera_target_frame", rospy.Time(0))
    np.testing.assert_allclose(pose_from_transform(moved.transform)[:3, 3], T_base[:3, 3], atol=5e-3)
    assert buffer.can_transform(DEPTH_OPTICAL, "ggcnn/view", rospy.Time(0))
    assert status()["message"] == "There are grasps."
    assert {"ms_network", "ms_view", "ms_peaks", "ms_poses", "ms_latency", "weights"} <= status().keys()
    assert {t.source for t in times} == {"ggcnn"}
    topics = dict(rospy.get_published_topics("/ggcnn"))
    assert {f"/ggcnn/{name}": kind for name, kind in TYPES.items()}.items() <= topics.items()

    process.send_signal(signal.SIGINT)
    assert process.wait(WAIT_S + LATER_S) == 0
    assert "Traceback" not in process.log_path.read_text()


def test_it_is_not_fine_while_nothing_comes_out_for_a_second(ros, camera, calibrated, monkeypatch):
    status, step, slow = statuses(ros), GraspPipeline.step, []

    def slowly(*args):
        for seconds in slow:
            clock.sleep(seconds)
        return step(*args)

    monkeypatch.setattr(GraspPipeline, "step", slowly)
    start(ros, reach__ask=False)
    clock.sleep(1.2)
    assert status()["message"] == "There are grasps."
    slow.append(5.0)
    clock.sleep(2.5)
    assert status()["message"].startswith("the inputs come, but nothing has come out of them for ")


def test_a_camera_pose_in_millimetres_is_named(ros, camera):
    lists, far = ros.record("ggcnn/out/grasps", GraspList), ASIDE.copy()
    far[:3, 3] *= 1000.0
    broadcaster = tf2_ros.StaticTransformBroadcaster()
    broadcaster.sendTransform(stamped_transform(far, "kuka/base_frame", DEPTH_OPTICAL, rospy.Time.now()))
    start(ros)
    found = newest(ros, lists, lambda m: m.grasps, "a grasp before the camera")
    assert "the camera pose in tf is invalid: its distance is 796.9 m" in found.grasps[0].reason
    broadcaster.pub_tf.unregister()


def test_the_arms_controller_is_asked_and_grasps_go_on_without_it(ros, camera, calibrated):
    lists, asked = ros.record("ggcnn/out/grasps", GraspList), []
    answer = CheckToolPoseResponse(success=True)
    rospy.set_param("kuka/center_line", [1.0, 0.0, 0.0])
    start(ros, reach__keep=0.5, reach__timeout=0.5)
    first = newest(ros, lists, lambda m: m.grasps, "a grasp")
    assert first.grasps[0].reason == ASKED
    silent = newest(ros, lists, lambda m: m.grasps[0].reason == SILENT, "a controller that is absent", 1.0)
    assert 0.5 <= seconds_between(first, silent) < 0.5 + 2 * PERIOD_S + LATER_S

    def check(request):
        asked.append(request.tool)
        return answer

    rospy.Service("kuka/check_tool_pose", CheckToolPose, check)
    yes = newest(ros, lists, lambda m: m.grasps[0].reachable, "a controller that says yes", RETRY_S + 0.5 + PERIOD_S)
    T, T_waits = (pose_from_message(asked[i].pose) for i in (0, 1))
    np.testing.assert_allclose(inverse(T) @ T_waits, pose(p=(0.0, 0.0, -0.12)), atol=1e-6)
    assert asked[-1].header.frame_id == "kuka/base_frame"
    np.testing.assert_allclose(T[:3, 2], (0.0, 0.0, -1.0), atol=1e-6)
    grip = T @ (*GRIP, 1.0)
    np.testing.assert_allclose(grip[:3], pose_from_message(yes.grasps[0].pose_base.pose)[:3, 3], atol=0.01)
    answer.success, answer.message = False, "It is outside of the workspace."
    refused = newest(ros, lists, lambda m: m.grasps[0].reason != "", "one that says no", 1.0)
    assert (refused.grasps[0].reachable, refused.grasps[0].reason) == (False, "It is outside of the workspace")
    assert 0.5 <= seconds_between(yes, refused) < 0.5 + 2 * PERIOD_S + LATER_S


def test_a_controller_that_comes_late_and_hangs_counts_as_silent_in_time(ros, camera, calibrated):
    lists = ros.record("ggcnn/out/grasps", GraspList)
    start(ros, reach__timeout=0.5)
    first = newest(ros, lists, lambda m: m.grasps, "a grasp")
    clock.sleep(0.3)
    rospy.Service("kuka/check_tool_pose", CheckToolPose, lambda _: clock.sleep(60.0))
    silent = newest(ros, lists, lambda m: m.grasps[0].reason == SILENT, "that it says so", 0.5)
    assert 0.5 <= seconds_between(first, silent) < 0.5 + 2 * PERIOD_S + LATER_S


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("ggcnn/network/weights", "/nowhere/a.pt", "The file /nowhere/a.pt cannot be read"),
        ("kuka/mounting", "ceiling", "The parameter kuka/mounting is not roll, pitch and yaw"),
    ],
)
def test_what_it_cannot_work_with_ends_it_with_a_sentence(ros, name, value, sentence):
    rospy.set_param(name, value)
    process = start(ros)
    assert process.wait(1.0) == 1
    log = process.log_path.read_text()
    assert sentence in log
    assert "Traceback" not in log


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"weights": "/etc/passwd"}, "The file /etc/SHA256SUMS cannot be read"),
        ({"sha256": "00" * 32}, "was expected"),
        ({"kind": "ggcnn"}, "holds weights of ggcnn2, but network/kind is ggcnn"),
        ({"weights": "README.md"}, "does not name README.md"),
    ],
)
def test_weight_files_are_checked(changes, sentence):
    with pytest.raises(RigError, match=sentence):
        load_network(parse(NetworkConfig, {**own_yaml("ggcnn.yaml")["network"], **changes}))


GGCNN = "ab" * 32


def sha256_of(file):
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


def lift_file(folder, hand=REFLEX, ggcnn=GGCNN, **changes):
    torch.manual_seed(0)
    file = folder / "lifts_reflex.pt"
    torch.save({**lift_network.saved(LiftNetwork(hand, ggcnn)), **changes}, file)
    return str(file)


@pytest.mark.parametrize(("trusts", "said"), [(0.0, True), (0.25, True), (1.0, False)])
def test_the_node_says_which_of_ggcnns_grasps_it_takes_and_takes_them(ros, camera, calibrated, tmp_path, trusts, said):
    lists = ros.record("ggcnn/out/grasps", GraspList)
    ggcnn = load_network(parse(NetworkConfig, own_yaml("ggcnn.yaml")["network"])).sha256
    file = lift_file(tmp_path, ggcnn=ggcnn, trusts=trusts)
    node = start(ros, lifts=MUST, lift_weights=file, peaks__threshold=0.01, reach__ask=False)
    found = newest(ros, lists, lambda m: m.grasps, "grasps", 3.0)
    down = [pose_from_message(grasp.pose_base.pose)[2, 2] < -np.cos(np.radians(2.0)) for grasp in found.grasps]
    assert all(grasp.own_approach for grasp in found.grasps) and (all(down) or not said)
    assert (f"It takes GG-CNN's where these lift with more than {100 * trusts:.0f} %." in node.log) == said


def test_a_network_of_lifts_is_taken_where_its_file_fits(tmp_path):
    file = lift_file(tmp_path)
    found, sha256, why = load_lifts(file, AUTO, REFLEX, GGCNN)
    assert why == "" and (found.hand, found.ggcnn) == (REFLEX, GGCNN) and sha256 == sha256_of(file)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"hand": PARALLEL}, "was made for the hand parallel and the GG-CNN abab.*, not for reflex and abab"),
        ({"ggcnn": "cd" * 32}, "was made for the hand reflex and the GG-CNN cdcd.*, not for reflex and abab"),
        ({"features": 3}, "its features is 3, not "),
        (None, "cannot be read: No such file"),
    ],
)
def test_one_of_another_hand_or_ggcnn_is_refused_or_left(tmp_path, changes, sentence):
    file = str(tmp_path / "none.pt") if changes is None else lift_file(tmp_path, **changes)
    with pytest.raises(RigError, match=sentence):
        load_lifts(file, MUST, REFLEX, GGCNN)
    found, _, why = load_lifts(file, AUTO, REFLEX, GGCNN)
    assert found is None and re.search(sentence, why)


def test_a_networks_grasps_are_published_with_their_approach_and_the_controller_is_asked_along_it(
    ros, camera, calibrated, tmp_path
):
    lists, asked = ros.record("ggcnn/out/grasps", GraspList), []
    rospy.set_param("kuka/center_line", [1.0, 0.0, 0.0])

    def check(request):
        asked.append(pose_from_message(request.tool.pose))
        return CheckToolPoseResponse(success=bool(asked[-1][0, 3] > 0.0), message="It is behind the base.")

    rospy.Service("kuka/check_tool_pose", CheckToolPose, check)
    ggcnn = load_network(parse(NetworkConfig, own_yaml("ggcnn.yaml")["network"])).sha256
    start(ros, lifts=MUST, lift_weights=lift_file(tmp_path, ggcnn=ggcnn), max_tilt=30.0, peaks__threshold=0.01)
    answered = newest(ros, lists, lambda m: m.grasps and all(g.reason != ASKED for g in m.grasps), "answers", 3.0)
    assert all(grasp.own_approach for grasp in answered.grasps) and len(answered.grasps) > 1
    accepted = [grasp.reachable for grasp in answered.grasps]
    assert accepted == sorted(accepted, reverse=True), "those that the controller refused come last"
    poses = [pose_from_message(grasp.pose_base.pose) for grasp in answered.grasps]
    assert min(T[2, 2] for T in poses) < -np.cos(np.radians(32.0)) < 0.0
    for grasp, T in zip(answered.grasps, poses):
        tools = [tool for tool in asked if np.linalg.norm((tool @ (*GRIP, 1.0))[:3] - T[:3, 3]) < 0.01]
        assert any(tool[:3, 2] @ T[:3, 2] > np.cos(np.radians(6.0)) for tool in tools), "asked along its approach"
        assert grasp.reason in ("", "It is behind the base")


def rig(**changes):
    """Returns the rig that the package's own yaml files describe."""
    values = {**own_yaml("ggcnn.yaml"), "tool": own_yaml("tool_pose.yaml")}
    lifts = changes.pop("lifts_sha256", "cd" * 32)
    return live_origin(settings_from(overlaid(values, changes)), GGCNN, "LBR7R800", lifts)


def test_where_there_is_no_grasp_it_says_why(ros, camera, depth):
    lists, targets = ros.record("ggcnn/out/grasps", GraspList), ros.record("ggcnn/out/target_pose", PoseStamped)
    camera.info, status = False, statuses(ros)
    torn = rospy.Publisher("camera/depth/image", Image, queue_size=1)
    process = start(ros)
    newest(ros, lists, lambda m: m.reason == "no camera_info has come on /camera/depth/camera_info", "no info")
    camera.info = True
    found = newest(ros, lists, lambda m: m.grasps, "a grasp before the camera").grasps[0]
    assert found.pose_base.header.frame_id == "" and not found.reachable
    assert "tf has no frame 'camera_depth_optical_frame'" in found.reason
    clock.sleep(LATER_S)
    assert targets[-1].header.frame_id == DEPTH_OPTICAL

    def says(reason, seconds=2 * PERIOD_S):
        message = newest(ros, lists, lambda m: reason in m.reason, reason, seconds)
        assert not message.grasps
        return message

    camera.depth = depth_picture(ASIDE, [])
    says("nothing stands on the table")
    clock.sleep(DIAGNOSTICS_S + LATER_S)
    assert "nothing stands on the table" in status()["message"]
    camera.depth = np.float32(1000.0) * depth
    says("the depth image is invalid: the median of the depth is")
    camera.depth, camera.late = depth, 0.9
    newest(ros, lists, lambda m: m.grasps, "an image that is not too old")
    camera.late = 1.1
    says("the depth image is 1.1 s old")
    camera.late = -5.0
    says("the depth image is 5.0 s in the future")
    camera.late, camera.frame = 0.0, f"/{DEPTH_OPTICAL}"
    clock.sleep(PERIOD_S)
    assert newest(ros, lists, lambda m: m.grasps, "a frame with a slash").header.frame_id == DEPTH_OPTICAL
    camera.frame, camera.depth = DEPTH_OPTICAL, None
    clock.sleep(LATER_S)
    last, before = lists[-1], len(targets)
    known = max(grasp.id for message in lists for grasp in message.grasps)
    silent = says("the depth camera is silent: nothing has come on /camera/depth/image for 1.", 1.3)
    again = says("the depth camera is silent", 0.8)
    assert 1.0 < seconds_between(last, silent) < 1.2 + LATER_S
    assert 0.5 <= seconds_between(silent, again) < 0.7 + LATER_S
    assert len(targets) == before
    camera.depth = depth
    back = newest(ros, lists, lambda m: m.grasps, "the camera came back")
    assert min(grasp.id for grasp in back.grasps) > known, "what was seen before the silence does not count"
    camera.depth = None
    clock.sleep(PERIOD_S)
    torn.publish(Image(height=1, width=1, encoding="64FC3", step=24, data=b"\0" * 24))
    clock.sleep(LATER_S)
    assert lists[-1].reason == "the depth image has no stamp"
    log = process.log_path.read_text()
    assert log.count("nothing stands on the table") == 1
    assert process.poll() is None and "Traceback" not in log


@pytest.mark.parametrize(
    ("learned", "used", "sentence"),
    [
        (
            {"view": "camera"},
            {"view": "table"},
            "was learned with view: camera, but view is table. Train one on episodes of this rig.",
        ),
        ({}, {"table": {"extent": 0.4}}, "was learned with table: .*0.65.*, but table is .*0.4"),
        ({}, {"tool": {"closing_angle": 90.0}}, "was learned with hand: .*, but hand is"),
        ({}, {"lifts_sha256": "ef" * 32}, "was learned with lifts: cdcdcdcdcdcd..., but lifts is efefefefefef..."),
    ],
)
def test_a_taste_of_another_rig_is_refused_and_a_missing_one_named(tmp_path, learned, used, sentence):
    file = str(tmp_path / "refinement.pt")
    torch.save(content(TasteFile({"cup": nobody()}, rig(**learned))), file)
    assert list(load_refinement(file, rig(**learned))) == ["cup"]
    with pytest.raises(RigError, match=sentence):
        load_refinement(file, rig(**used))
    with pytest.raises(RigError, match="train_refinement.py"):
        load_refinement("refinement.pt", rig())


class Lifts(LiftNetwork):
    """Believes that all grasps lift."""

    def forward(self, features):
        return 5.0 + 0.5 * features[:, -SCALARS]


@pytest.fixture
def refined(tmp_path, monkeypatch):
    """Returns a function that writes a taste of kinds that the operator grasps with these tilts [rad], and a network of
    lifts; it returns parameters for the node."""
    monkeypatch.setattr(lift_network, "LiftNetwork", Lifts)
    ggcnn = load_network(parse(NetworkConfig, own_yaml("ggcnn.yaml")["network"])).sha256
    lifts = lift_file(tmp_path, ggcnn=ggcnn)
    likes_height = np.zeros(len(nobody().weights))
    likes_height[TASTES.index("height")] = 0.01

    def write(view="table", **tilts):
        kinds = {
            name: nobody()._replace(
                weights=likes_height, style=nobody().style._replace(tilt_x=np.array([tilt, 0.0, 0.0]))
            )
            for name, tilt in tilts.items()
        }
        file = tmp_path / "refinement.pt"
        torch.save(content(TasteFile(kinds, Origin(view=view, lifts=sha256_of(lifts)))), file)
        return {"view": view, "refine": True, "refinement_weights": str(file), "lift_weights": lifts}

    return write


@pytest.mark.parametrize("view", ["camera", "table"])
def test_with_a_taste_there_are_grasps_in_either_view_and_how_sure_they_are(ros, camera, calibrated, refined, view):
    lists = ros.record("ggcnn/out/grasps", GraspList)
    start(ros, **refined(view, cup=0.2), reach__ask=False)
    best = newest(ros, lists, lambda m: m.grasps, "a grasp").grasps[0]
    approach = pose_from_message(best.pose_camera)[:3, 2]
    assert approach @ DOWN == pytest.approx(np.cos(0.2), abs=0.01)  # of the table, in either view
    assert best.own_approach and best.quality > 0.97 and 0.0 < best.probability <= 1.0
    place, line, tilt, opening = nobody().spreads
    np.testing.assert_allclose(best.deviations, [place, place, place, tilt, tilt, line], rtol=1e-6)
    assert best.width_deviation == pytest.approx(opening)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"refinement_kind": "mug"}, "refinement_kind is 'mug', but must be one of cup, bottle."),
        ({"lifts": "never"}, "lifts is never, but refine: true chooses among the grasps of that network."),
        (
            {"lift_weights": "/nowhere/lifts.pt"},
            "refine: true needs a network of lifts. The file /nowhere",
        ),
        ({"refinement_weights": "/nowhere/a.pt"}, "The file /nowhere/a.pt cannot be read"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_what_a_taste_cannot_do_without_ends_the_node_with_a_sentence(ros, refined, changes, sentence):
    process = start(ros, **{**refined(cup=0.2, bottle=0.0), "refinement_kind": "cup", **changes})
    assert process.wait(1.0) == 1
    log = process.log_path.read_text()
    assert sentence in log and "Traceback" not in log


def test_the_kind_of_object_is_changed_while_it_runs(ros, camera, calibrated, refined):
    lists = ros.record("ggcnn/out/grasps", GraspList)
    camera.period = 3 * PERIOD_S
    process = start(ros, **refined(cup=0.2, bottle=0.0), refinement_kind="cup", reach__ask=False)

    def tilt():
        approach = pose_from_message(lists[-1].grasps[0].pose_camera)[:3, 2]
        return np.arccos(min(approach @ DOWN, 1.0))

    def soon(kind, master_answers=True):
        rospy.set_param("ggcnn/refinement_kind", kind)
        ros.master_answers = master_answers
        clock.sleep(KIND_PERIOD_S + 2 * camera.period)

    clock.sleep(3 * camera.period)
    assert tilt() == pytest.approx(0.2, abs=0.02)
    soon("bottle", master_answers=False)
    assert tilt() == pytest.approx(0.2, abs=0.02), "a master that does not answer changes nothing"
    soon("bottle")
    assert tilt() == pytest.approx(0.0, abs=0.1)
    soon("mug")
    sentence = "refinement_kind is 'mug', but must be one of cup, bottle. The grasps remain those of the kind before."
    assert sentence in process.log_path.read_text()
    soon(["cup"])
    assert tilt() == pytest.approx(0.0, abs=0.1)
    soon("cup")
    assert tilt() == pytest.approx(0.2, abs=0.02)
    assert process.poll() is None


def test_the_launch_file_starts_the_node_with_a_file_of_changes(ros, camera, tmp_path):
    changes = tmp_path / "changes.yaml"
    changes.write_text("lifts: never\npeaks: {threshold: 0.95}\n")
    launch = ("grasping", "grasping.launch", "camera:=false", "image_view:=false", f"config:={changes}")
    assert "/ggcnn" not in launched.nodes(*launch)
    (prefix,) = launched.prefixes(*launch, "node:=true")
    assert prefix.endswith("/behind.sh 10")
    beside, inside = (launched.parameters(*launch, *more) for more in ((), ("node:=true",)))
    own = [{name: value for name, value in one.items() if name.startswith("/ggcnn/")} for one in (beside, inside)]
    assert own[0] == own[1] and own[0]

    lists = ros.record("ggcnn/out/grasps", GraspList)
    ros.launch("grasping", "grasping.launch", camera="false", image_view="false", config=changes, node="true")
    newest(ros, lists, lambda m: "no peak of the quality is above 0.95" in m.reason, "the launched node")
