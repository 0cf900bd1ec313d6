"""The node camera_place: publishes the camera pose in kuka/base_frame, from the stored calibration or live. Live, every
image that shows the marker board gives a pose: base to flange as measured by the arm, flange to board by its drawing,
and the board as detected by the camera. Stored, the pose is that of the newest calibration and needs no board. Mode
auto is stored if there is a calibration, and live otherwise."""

from __future__ import annotations

import copy
from collections import deque
from typing import NamedTuple

import numpy as np
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TransformStamped
from std_srvs.srv import Trigger, TriggerResponse

from common import clock
from common.errors import DeviceError
from common.frames import FLANGE_SEEN
from common.input_watch import OUTPUT_S
from common.poses import inverse, read_only
from common.ros.conversions import stamped_transform
from common.ros.diagnostics import Diagnostics
from common.ros.inputs import FaultLog
from common.ros.node import repeat, while_running
from common.ros.params import private_config
from vision.calibration.acceptance import BoardDetection, check_alone, view_from
from vision.calibration.hand_eye import camera_pose
from vision.calibration.record import LIVE, STORED, CalibrationRecord, CameraPoseConfig
from vision.ros.calibration.calibration_setup import CalibrationSetup, TfPoses, read_setup
from vision.ros.marker_board.detections import BoardListener

RECENT_S = 3.0
REPEAT_S = 0.1
AHEAD = rospy.Duration(2.0 * REPEAT_S)  # a repeated pose, which does not move, is stamped ahead: nobody has to wait


class LiveDetection(NamedTuple):
    """A detection with the time of its arrival [s], T_base_flange and the camera's optical frame."""

    time: float
    T_base_flange: np.ndarray
    detection: BoardDetection
    optical: str


class CameraPoseNode:
    """Publishes the camera pose and stores it on request."""

    def __init__(self, mode: str, setup: CalibrationSetup) -> None:
        self._mode, self._setup = mode, setup
        self._poses = TfPoses()
        self._static = tf2_ros.StaticTransformBroadcaster()
        self._broadcaster = tf2_ros.TransformBroadcaster()
        self._lock = clock.Lock()
        self._recent: deque[LiveDetection] = deque(maxlen=setup.limits.pictures)
        self._refused = 0
        self._last: tuple[float, str] | None = None  # time [s] of the last detection; why it gave no pose, or ""
        self._record: CalibrationRecord | None = None
        self._stored: TransformStamped | None = None
        self._was_live = False
        self._log = FaultLog()
        board, now = setup.board, rospy.Time.now()
        self._flange_seen = stamped_transform(board.T_tag_flange, board.frame, FLANGE_SEEN, now)
        self._static.sendTransform([self._flange_seen])
        self._load()
        rospy.Service("camera_place/reload", Trigger, self._on_reload)
        rospy.Service("camera_place/store", Trigger, self._on_store)
        self._listener = BoardListener(setup.target, self._on_detection)
        Diagnostics("camera_place", self._diagnostics)
        repeat(self._repeat, REPEAT_S, "camera pose")

    def _load(self) -> None:
        """Loads the newest calibration unless live; DeviceError if none (mode stored) or the frames are unknown."""
        if self._mode == LIVE:
            return
        folder, config = self._setup.store.folder, self._setup.store_config
        found = self._setup.store.newest()
        if found is None:
            if self._mode == STORED:
                raise DeviceError(
                    f"No calibration for {config.robot} and camera {config.camera} in {folder}: run rosrun vision "
                    "calibrate_camera.py, or use mode:=live."
                )
            rospy.logwarn("No calibration in %s: the camera pose is live.", folder)
            self._record = self._stored = None
            self._static.sendTransform([self._flange_seen])
            return
        record, file = found
        transform = self._poses.camera_link(record.T_base_camera, record.camera_frame, rospy.Time.now())
        self._static.sendTransform([self._flange_seen, transform])
        self._record, self._stored = record, transform
        rospy.loginfo("The camera pose is that of %s, %s.", file, _summary(record))

    def _on_reload(self, _) -> TriggerResponse:
        with self._lock:
            try:
                self._load()
            except DeviceError as error:
                return TriggerResponse(False, str(error))
            if self._record is not None:
                return TriggerResponse(True, f"The camera pose is {_summary(self._record)}.")
            why = "the mode is live" if self._mode == LIVE else f"{self._setup.store.folder} has no calibration"
            return TriggerResponse(True, f"The camera pose is live: {why}.")

    def _on_detection(self, stamp: rospy.Time, optical: str, detection: BoardDetection) -> None:
        flange_wait_s = 0.2
        throttle_s = 5.0
        if self._record is not None:
            return
        with while_running():
            try:
                T_base_flange = self._poses.flange(stamp, flange_wait_s)
                T_base_camera = T_base_flange @ self._setup.board.T_flange_tag @ inverse(detection.T_camera_board)
                transform = self._poses.camera_link(T_base_camera, optical, stamp)
            except DeviceError as error:
                self._refused += 1
                self._last = (clock.monotonic(), str(error))
                rospy.logwarn_throttle(throttle_s, f"A detection of the marker board gave no camera pose: {error}")
                return
            self._was_live = True
            self._broadcaster.sendTransform(transform)
            self._last = (clock.monotonic(), "")
            with self._lock:
                self._recent.append(LiveDetection(self._last[0], T_base_flange, detection, optical))

    def _repeat(self) -> None:
        """Repeats the stored pose if there was a live one before: in tf2 a moving frame does not become static."""
        if self._stored is None or not self._was_live:
            return
        transform = copy.deepcopy(self._stored)
        transform.header.stamp = rospy.Time.now() + AHEAD
        self._broadcaster.sendTransform(transform)

    def _on_store(self, _) -> TriggerResponse:
        """Stores the mean of the newest detections, if arm and camera stood still."""
        with self._lock:
            if self._record is not None:
                why = "the camera pose is a stored one already; restart with mode:=live."
                return TriggerResponse(False, f"Nothing was stored: {why}")
            now = clock.monotonic()
            try:
                file = self._setup.store.save(self._live_record([e for e in self._recent if now - e.time < RECENT_S]))
                if self._mode != LIVE:
                    self._load()
            except (ValueError, DeviceError) as error:
                return TriggerResponse(False, f"Nothing was stored: {error}")
            return TriggerResponse(True, f"The camera pose is stored in {file}.")

    def _live_record(self, recent: list[LiveDetection]) -> CalibrationRecord:
        """Returns the record; raises ValueError or DeviceError if the detections cannot be used."""
        self._setup.check_serial()
        if not recent:
            raise ValueError(f"no detection of the marker board in the last {RECENT_S:g} s: show it to the camera")
        limits, last = self._setup.limits, recent[-1]
        view = view_from([entry.detection for entry in recent], last.T_base_flange, [], limits)
        if any(np.linalg.norm(e.T_base_flange[:3, 3] - view.T_base_flange[:3, 3]) > 1e-3 for e in recent):
            raise ValueError("the arm moved: store again once it stands still")
        T_flange_board = read_only(self._setup.board.T_flange_tag)
        return CalibrationRecord(
            **self._setup.head,
            kind=LIVE,
            simulated=self._setup.measured_by(rospy.get_param("kuka/ip", "")),
            camera_frame=last.optical,
            T_base_camera=read_only(camera_pose(view, T_flange_board)),
            T_flange_board=T_flange_board,
            rms_mm=None,
            rms_deg=None,
            point_sd_mm=check_alone(view, limits),
            errors=read_only(np.zeros((0, 2))),
            views=(view,),
        )

    def _diagnostics(self):
        values = {"mode": self._mode, "refused": self._refused}
        record, last = self._record, self._last
        if record is not None:
            return DiagnosticStatus.OK, _summary(record), values
        fault = "the marker board has not been detected yet"
        if last is not None:
            age, fault = clock.monotonic() - last[0], last[1]
            if age > OUTPUT_S:
                fault = f"the marker board was not detected for {age:.0f} s"
        fault = self._log(self._listener.fault() or fault)
        return (DiagnosticStatus.WARN, fault, values) if fault else (DiagnosticStatus.OK, "live", values)


def _summary(record: CalibrationRecord) -> str:
    return f"stored on {record.date}: {record.accuracy}"


def main() -> None:
    config = private_config(CameraPoseConfig)
    CameraPoseNode(config.mode, read_setup(config.detector))
    rospy.spin()
