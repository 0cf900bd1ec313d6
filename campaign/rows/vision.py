"""Rows 70 to 73: the camera, the marker board and the network. They propose only; a hand still steers the arm."""

from __future__ import annotations

import contextlib
import signal
import tempfile
from pathlib import Path

import numpy as np
import rospkg
import rospy
import tf2_ros
import yaml
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from apriltag_ros.msg import AprilTagDetection, AprilTagDetectionArray
from campaign.arm_trace import T_FLANGE_TOOL
from campaign.rows.limits import stays_in_servo
from campaign.trial import row
from common import clock
from common.camera_model import pinhole
from common.config import parse
from common.poses import inverse, pose
from common.ros.conversions import message_from_pose, stamped_transform
from common.ros.images import camera_info_message
from common.rotations import rotation_about
from grasp_msgs.msg import GraspList
from kuka_msgs.msg import MoveGoal
from vision.marker_board.board import MarkerBoardConfig

FRESH_S = 2.0  # proposals in an older image are refused
NETWORK = Path(rospkg.RosPack().get_path("grasping"), "weights", "ggcnn2_wide.pt")
LISTS_S = 30.0  # a busy machine looks at an image now and then [s]


class Proposals:
    """The newest list of grasps, whose reasons are heard; its time is monotonic [s]."""

    def __init__(self, trial) -> None:
        self._rig = trial.rig
        self.newest, self.at = GraspList(), 0.0
        self._subscriber = rospy.Subscriber("ggcnn/out/grasps", GraspList, self._take, queue_size=1)

    def close(self) -> None:
        """Listens no longer."""
        self._subscriber.unregister()

    def wait(self, some: bool, reason: str = "") -> None:
        """Waits for a list from now on with grasps, or without any and with a reason."""
        since = clock.monotonic()
        self._rig.wait(
            lambda: self.at > since and bool(self.newest.grasps) == some and reason in self.newest.reason,
            f"{'grasps' if some else f'no grasps: {reason}'}; the last: {self.newest.reason}",
            LISTS_S,
        )

    def _take(self, message: GraspList) -> None:
        self.newest, self.at = message, clock.monotonic()
        self._rig.hear("ggcnn/out/grasps", message.reason)


def refused(trial, reason: str) -> None:
    """Has a grasp executed, which must be refused for a reason."""
    trial.rig.watch(0.5)  # until the node that executes grasps has heard what was heard here
    answer = trial.call("grasping/execute", Trigger)
    if answer.success:
        trial.call("grasping/cancel", Trigger)
    trial.check("no grasp is executed", not answer.success, answer.message)
    trial.check("it is refused for this reason", reason in answer.message, answer.message)


@row(70, "Camera stream stops", "R", variant="seeing", within=10.0, named_by="depth camera is silent", hazards=(23,))
def camera_stops(trial):
    rig = trial.rig
    with contextlib.closing(Proposals(trial)) as proposals:
        proposals.wait(some=True)
        trial.follow()
        trial.fault("camera", "vanished")
        proposals.wait(some=False, reason="depth camera is silent")
        trial.says("camera.*(vanished|silent|no image)", 10.0)
        start = rig.arm.now.time
        rig.watch(1.5)
        trial.check("the arm follows on", rig.arm.way(start) > 0.02, rig.arm.way(start))
        stays_in_servo(trial)
        rig.hand.hide()
        rig.wait_for_modes("servo", "home")
        rig.wait(lambda: rig.stream_state == "waiting", "the end of the stream")
        refused(trial, "depth camera is silent")
        trial.mend("camera", "vanished")
        proposals.wait(some=True)
        trial.fault("camera", "frozen")
        proposals.wait(some=False, reason="old")
        trial.mend("camera", "frozen")
        proposals.wait(some=True)


@row(72, "Network model output NaN / empty depth", "R", variant="seeing", within=10.0, still=True,
     named_by="no grasp|not finite|depth", hazards=(23,))  # fmt: skip
def useless_images(trial):
    import torch  # takes seconds to load

    rig = trial.rig
    with contextlib.closing(Proposals(trial)) as proposals, tempfile.TemporaryDirectory() as folder:
        proposals.wait(some=True)
        assert rig.control(True).success
        trial.fault("camera", "depth_empty")
        proposals.wait(some=False)
        refused(trial, "No grasp is proposed")
        trial.mend("camera", "depth_empty")
        proposals.wait(some=True)
        # A network whose weights are finite, so that they are loaded, but whose maps are not.
        state = torch.load(NETWORK, map_location="cpu", weights_only=True)
        weights = Path(folder, "broken.pt")
        torch.save(
            {name: 1e30 * value if value.is_floating_point() else value for name, value in state.items()}, weights
        )
        _restart_network(trial, weights=str(weights), sha256="any")
        proposals.wait(some=False, reason="the network's maps are not finite")
        refused(trial, "the network's maps are not finite")
        _restart_network(trial, weights="ggcnn2_wide.pt", sha256="listed")
        proposals.wait(some=True)


def _restart_network(trial, **parameters: str) -> None:
    rig = trial.rig
    trial.signal("ggcnn", signal.SIGINT)
    rig.wait(lambda: rig.pid("ggcnn") is None, "the end of the network", 20.0)
    for name, value in parameters.items():
        rospy.set_param(f"ggcnn/network/{name}", value)
    rig.run("grasping", "ggcnn.py", "__name:=ggcnn")


@row(73, "Grasp proposal stale when accepted", "R", variant="seeing", within=10.0, still=True,
     named_by=r"newest proposal is \d+\.\d s old", hazards=(23,))  # fmt: skip
def stale_proposal(trial):
    rig = trial.rig
    with contextlib.closing(Proposals(trial)) as proposals:
        assert rig.control(True).success
        proposals.wait(some=True)
        trial.begins()
        network = rig.pid("ggcnn")
        rig.suspend("ggcnn")
        try:
            rig.watch(FRESH_S + 1.0)
            refused(trial, "s old")
        finally:
            rig.kill(network, signal.SIGCONT)
        trial.ends()
        proposals.wait(some=True)
        rig.watch(1.0)


VISION = Path(rospkg.RosPack().get_path("vision"), "config")
DETECTOR, OPTICAL = "apriltag_ros_continuous_node", "camera_rgb_optical_frame"
SD = np.array([3e-4, 3e-4, 6e-4, 1.5e-3, 1.5e-3, 5e-4])  # of a detection [m, rad]
T_LINK_OPTICAL = pose([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], (0.0, -0.045, 0.0))
T_CAMERA_BOARD = pose(rotation_about(0, 2.6), (0.05, 0.02, 0.9))
ELSEWHERE = np.radians([-30.0, 30.0, 0.0, -63.0, 0.0, 87.0, 0.0])
"""Joints near home."""


class Board:
    """What the detector says of a marker board on the flange that a camera sees, twenty times a second; the camera
    stands where it sees the board well while the arm is at home.

    Attributes:
        ambiguous: whether every other detection is the other solution, in which a small tag is tilted the other way."""

    def __init__(self, rig) -> None:
        self._rig, self.ambiguous = rig, False
        self._T_flange_board = parse(
            MarkerBoardConfig, yaml.safe_load((VISION / "panel.yaml").read_text())
        ).T_flange_tag
        self._T_board_camera0 = self._flange() @ self._T_flange_board @ inverse(T_CAMERA_BOARD)
        self._camera = pinhole("campaign", 640, 480, [[545.0, 0, 319.5], [0, 545.0, 239.5], [0, 0, 1]])
        self._infos = rospy.Publisher("camera/rgb/camera_info", CameraInfo, queue_size=1)
        self._detections = rospy.Publisher("tag_detections", AprilTagDetectionArray, queue_size=1)
        self._static = tf2_ros.StaticTransformBroadcaster()
        self._static.sendTransform([stamped_transform(T_LINK_OPTICAL, "camera_link", OPTICAL, rospy.Time.now())])
        self._rng, self._count = np.random.default_rng(0), 0
        self._timer = rospy.Timer(rospy.Duration(0.05), self._publish)

    def close(self) -> None:
        """Ends it."""
        self._timer.shutdown()
        self._timer.join()
        for publisher in (self._infos, self._detections, self._static.pub_tf):
            publisher.unregister()

    def _flange(self) -> np.ndarray:
        return self._rig.arm.now.T_base_tool @ inverse(T_FLANGE_TOOL)

    def _publish(self, _: object) -> None:
        header = Header(stamp=rospy.Time.now(), frame_id=OPTICAL)
        T = inverse(self._T_board_camera0) @ self._flange() @ self._T_flange_board
        self._count += 1
        if self.ambiguous and self._count % 2:
            T = T @ pose(rotation_about(0, np.radians(25.0)))
        noise = self._rng.normal(0.0, SD / 3.0)
        T = pose(T[:3, :3] @ rotation_about(0, noise[3]), T[:3, 3] + noise[:3])
        seen = PoseWithCovarianceStamped(header=header)
        seen.pose.pose = message_from_pose(T)
        seen.pose.covariance = np.diag(SD**2).ravel().tolist()
        tags = AprilTagDetection([0, 1, 2, 3, 4], [0.1, 0.06, 0.06, 0.06, 0.06], seen)
        self._infos.publish(camera_info_message(self._camera, OPTICAL, header.stamp))
        self._detections.publish(AprilTagDetectionArray(header, [tags]))


@row(71, "AprilTag ambiguous/moved", "R", within=20.0, named_by="Nothing was stored",
     instead="a whole calibration has the robot to itself, so no rig runs beside it; what it refuses, with residuals, "
     "is tested with the program (test_calibrate_program.py). Here the running rig's camera pose is stored from "
     "detections that a board on the arm would give", hazards=(23,))  # fmt: skip
def board_that_is_ambiguous(trial):
    rig = trial.rig
    with tempfile.TemporaryDirectory() as folder, contextlib.closing(Board(rig)) as board:
        files = {"panel": "panel.yaml", "limits": "camera_calibration.yaml", "views": "calibration_views.yaml"}
        values = {name: yaml.safe_load((VISION / file).read_text()) for name, file in files.items()}
        store = {"folder": folder, "camera": "1234", "robot": "LBR7R800", "flange": "MF_elektrisch"}
        rospy.set_param("camera_calibration", {**values, "store": store})
        rospy.set_param(DETECTOR, yaml.safe_load((VISION / "tags.yaml").read_text()))
        node = rig.run("vision", "camera_place_node.py", "__name:=camera_place", "_mode:=live")
        try:
            rig.wait(lambda: trial.call("camera_place/store", Trigger).success, "a first camera pose", 20.0)
            kept = _files(folder)
            trial.begins()
            board.ambiguous = True
            rig.watch(3.5)  # longer than detections are kept
            answer = trial.call("camera_place/store", Trigger)
            trial.check("an ambiguous board does not count", not answer.success, answer.message)
            trial.check("the residual is named", "deg" in answer.message, answer.message)
            board.ambiguous = False
            assert rig.control(True).success
            program = rig.moves()
            program.send_goal(MoveGoal(kind=MoveGoal.JOINTS, joints=ELSEWHERE.tolist()))
            rig.wait(lambda: rig.arm.now.speed > 0.1, "the arm to move")
            rig.watch(1.0)
            answer = trial.call("camera_place/store", Trigger)
            trial.check("a board that moves does not count", not answer.success, answer.message)
            rig.moved(program)
            trial.check("the old pose is kept", _files(folder) == kept and len(kept) == 1, _files(folder))
        finally:
            rig.end_program(node)
            for name in ("camera_calibration", DETECTOR):
                rospy.delete_param(name)


def _files(folder: str) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in Path(folder).iterdir()}
