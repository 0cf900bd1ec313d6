"""The node camera_place: publishes where the camera stands in kuka/base_frame, from the stored calibration or live.

Live, every picture that shows the panel gives a place: base to flange as the arm measures it, flange to tag by the
panel's drawing, and the tag as the camera sees it. Stored, the place is that of the newest calibration and holds
without the tag. Mode auto is stored where there is a calibration, and live otherwise.
"""

from __future__ import annotations

import copy
import threading
import time
from collections import deque

import numpy as np
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TransformStamped
from std_srvs.srv import Trigger, TriggerResponse

from common.errors import DeviceError
from common.frames import FLANGE_SEEN
from common.poses import read_only
from common.ros.conversions import stamped_transform
from common.ros.diagnostics import Diagnostics
from common.ros.node import run, while_running
from common.ros.params import private_config
from vision.calibration.acceptance import Sight, check_alone, view_from
from vision.calibration.hand_eye import camera_pose
from vision.calibration.record import LIVE, CalibrationRecord
from vision.node_parameters import STORED, PlaceConfig
from vision.ros.calibration.calibration_setup import CalibrationSetup, read_setup
from vision.ros.calibration.tf_poses import Frames
from vision.ros.marker_board.detections import PanelSights

FLANGE_WAIT_S = 0.2
RECENT_S = 3.0
THROTTLE_S = 5.0
REPEAT_S = 0.1
AHEAD = rospy.Duration(2.0 * REPEAT_S)
"""A repeated place is stamped ahead, so that nobody waits for the next one; it does not move."""


class CameraPlace:
    """Publishes the camera's place and stores it on demand."""

    def __init__(self, mode: str, setup: CalibrationSetup) -> None:
        self._mode, self._setup = mode, setup
        self._frames = Frames()
        self._static = tf2_ros.StaticTransformBroadcaster()
        self._broadcaster = tf2_ros.TransformBroadcaster()
        self._lock = threading.Lock()
        self._recent: deque = deque(maxlen=setup.limits.pictures)
        self._refused = 0
        self._last: tuple[float, str] | None = None
        """When the panel was last seen [s], and why that gave no place; an empty string where it did."""
        self._record: CalibrationRecord | None = None
        self._stored: TransformStamped | None = None
        self._was_live = False
        panel, now = setup.panel, rospy.Time.now()
        self._seen = stamped_transform(panel.T_tag_flange, panel.frame, FLANGE_SEEN, now)
        self._static.sendTransform([self._seen])
        self._load()
        rospy.Service("camera_place/reload", Trigger, self._on_reload)
        rospy.Service("camera_place/store", Trigger, self._on_store)
        PanelSights(setup.target, self._on_sight)
        Diagnostics("camera_place", self._diagnostics)
        self._timer = rospy.Timer(rospy.Duration(REPEAT_S), self._repeat)

    def _load(self) -> None:
        """Takes the newest stored calibration, where the mode asks for it.

        Raises:
            DeviceError: the mode is `stored` and there is none, or the camera's frames are unknown.
        """
        if self._mode == LIVE:
            return
        found = self._setup.store.newest()
        if found is None:
            if self._mode == STORED:
                raise DeviceError(
                    f"There is no calibration for {self._setup.store_config.robot} and camera "
                    f"{self._setup.store_config.camera} in {self._setup.store.folder}; calibrate first."
                )
            rospy.logwarn("There is no calibration in %s: the place is live.", self._setup.store.folder)
            self._record = self._stored = None
            self._static.sendTransform([self._seen])
            return
        record, file = found
        transform = self._frames.camera_link(record.T_base_camera, record.camera_frame, rospy.Time.now())
        self._static.sendTransform([self._seen, transform])
        self._record, self._stored = record, transform
        rospy.loginfo("The camera's place is that of %s, %s.", file, _told(record))

    def _on_reload(self, _) -> TriggerResponse:
        with self._lock:
            try:
                self._load()
            except DeviceError as error:
                return TriggerResponse(False, str(error))
            if self._record is not None:
                return TriggerResponse(True, f"The place is {_told(self._record)}.")
            why = "the mode is live" if self._mode == LIVE else f"nothing is stored in {self._setup.store.folder}"
            return TriggerResponse(True, f"The place is live, for {why}.")

    def _on_sight(self, stamp: rospy.Time, optical: str, sight: Sight) -> None:
        if self._record is not None:
            return
        with while_running():
            try:
                T_base_flange = self._frames.flange(stamp, FLANGE_WAIT_S)
                T_base_camera = T_base_flange @ self._setup.panel.T_flange_tag @ np.linalg.inv(sight.T_camera_panel)
                transform = self._frames.camera_link(T_base_camera, optical, stamp)
            except DeviceError as error:
                self._refused += 1
                self._last = (time.monotonic(), str(error))
                rospy.logwarn_throttle(THROTTLE_S, f"A sight of the panel is of no use: {error}")
                return
            self._was_live = True
            self._broadcaster.sendTransform(transform)
            self._last = (time.monotonic(), "")
            with self._lock:
                self._recent.append((time.monotonic(), T_base_flange, sight, optical))

    def _repeat(self, _) -> None:
        """Repeats the stored place where there was a live one before: tf2 makes no fixed frame of one that moved."""
        if self._stored is None or not self._was_live:
            return
        with while_running():
            transform = copy.deepcopy(self._stored)
            transform.header.stamp = rospy.Time.now() + AHEAD
            self._broadcaster.sendTransform(transform)

    def _on_store(self, _) -> TriggerResponse:
        """Stores the mean of the newest sights, if arm and camera stood still."""
        with self._lock:
            if self._record is not None:
                return TriggerResponse(False, "Nothing was stored: the place is a stored one already; use mode:=live.")
            now = time.monotonic()
            recent = [entry for entry in self._recent if now - entry[0] < RECENT_S]
            try:
                record = self._live_record(recent)
                file = self._setup.store.save(record)
                if self._mode != LIVE:
                    self._load()
            except (ValueError, DeviceError) as error:
                return TriggerResponse(False, f"Nothing was stored: {error}")
            return TriggerResponse(True, f"The place is stored in {file}.")

    def _live_record(self, recent: list) -> CalibrationRecord:
        """Raises ValueError or DeviceError with what is wrong with the sights."""
        self._setup.check_serial()
        if not recent:
            raise ValueError("the panel was not seen just now")
        limits, store = self._setup.limits, self._setup.store_config
        view = view_from([sight for _, _, sight, _ in recent], recent[-1][1], [], limits)
        if any(np.linalg.norm(T[:3, 3] - view.T_base_flange[:3, 3]) > 1e-3 for _, T, _, _ in recent):
            raise ValueError("the arm moved")
        point_sd_mm = check_alone(view, limits)
        T_flange_panel = read_only(self._setup.panel.T_flange_tag)
        return CalibrationRecord(
            date=time.strftime("%Y-%m-%dT%H:%M:%S"),
            kind=LIVE,
            robot=store.robot,
            flange=store.flange,
            panel=self._setup.panel.frame,
            camera=store.camera,
            camera_frame=recent[-1][3],
            T_base_camera=read_only(camera_pose(view, T_flange_panel)),
            T_flange_panel=T_flange_panel,
            rms_mm=None,
            rms_deg=None,
            point_sd_mm=point_sd_mm,
            errors=read_only(np.zeros((0, 2))),
            views=(view,),
        )

    def _diagnostics(self):
        values = {"mode": self._mode, "refused": self._refused}
        record, last = self._record, self._last
        if record is not None:
            return DiagnosticStatus.OK, _told(record), values
        if last is None:
            return DiagnosticStatus.WARN, "waits for the panel", values
        age, trouble = time.monotonic() - last[0], last[1]
        if age > RECENT_S:
            return DiagnosticStatus.WARN, f"the panel was not seen for {age:.0f} s", values
        return (DiagnosticStatus.WARN, trouble, values) if trouble else (DiagnosticStatus.OK, "live", values)


def _told(record: CalibrationRecord) -> str:
    return f"stored on {record.date}: {record.accuracy}"


def _run() -> None:
    config = private_config(PlaceConfig)
    CameraPlace(config.mode, read_setup(config.detector))
    rospy.spin()


def main() -> None:
    """Runs the node until ROS shuts down."""
    run("camera_place", _run)
