"""The node plane_pose: publishes the marker board's pose with depth, in the topics and frames of apriltag_ros. In:
rgb/image_raw, depth/image_raw and camera_info of each. Out: tag_detections_fused (colour and depth by their
covariances) and tag_detections_plane (tilt and range by depth alone), AprilTagDetectionArray, empty without such a
pose; in tf the frames <board>/fused and <board>/plane. The detector node publishes the colour-only pose."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from apriltag_ros.detector import TargetDetection
from apriltag_ros.msg import AprilTagDetectionArray
from apriltag_ros.ros.messages import detection_array
from apriltag_ros.settings import detector_settings
from common.errors import ConfigError
from common.ros.broadcaster import FreshBroadcaster
from common.ros.conversions import stamped_transform
from common.ros.diagnostics import Diagnostics
from common.ros.params import private_config, private_values
from common.rotations import rotation_angle
from vision.camera.registration import PairsConfig
from vision.marker_board.board import MarkerBoardConfig, board_target
from vision.marker_board.plane_fit import PlanePoseConfig
from vision.marker_board.plane_pose import RgbdDetection, RgbdDetector
from vision.ros.camera.rgbd_pairs import RgbdPair, RgbdPairs

METHODS = ("plane", "fused")
SECTIONS = ("detector", "panel", "plane_pose")


class PlanePoseNode:
    """Publishes the marker board's poses, tf frame `frame`, for every pair of images at most `slop` [s] apart."""

    def __init__(self, detector: RgbdDetector, frame: str, publish_tf: bool, slop: float) -> None:
        self._detector, self._frame, self._publish_tf = detector, frame, publish_tf
        self._fused = self._refused = 0
        self._values: dict[str, str] = {}
        self._reason = "the marker board has not been detected yet"
        self._publishers = {
            name: rospy.Publisher(f"tag_detections_{name}", AprilTagDetectionArray, queue_size=1, tcp_nodelay=True)
            for name in METHODS
        }
        self._broadcaster = FreshBroadcaster()
        self._pairs = RgbdPairs(self._on_pair, slop)
        self._pairs.subscribe(True)
        Diagnostics("plane_pose", self._diagnose)

    def _on_pair(self, pair: RgbdPair) -> None:
        grey = cv2.cvtColor(np.ascontiguousarray(pair.colour), cv2.COLOR_RGB2GRAY)
        stamp = pair.header.stamp.to_sec()
        found = self._detector.detect(grey, pair.rgb, pair.depth, pair.depth_camera, pair.T_rgb_depth, stamp)
        for name, publisher in self._publishers.items():
            detections = _detections(found, name)
            publisher.publish(detection_array(detections, pair.header))
            if self._publish_tf and detections:
                T, child = detections[0].pose.T_camera_tag, f"{self._frame}/{name}"
                self._broadcaster.sendTransform(stamped_transform(T, pair.header.frame_id, child, pair.header.stamp))
        self._report(found)

    def _report(self, found: RgbdDetection | None) -> None:
        """Counts, and logs why a detected marker board has no fused pose."""
        throttle_s = 5.0
        if found is None:
            self._reason = "no tag of the marker board is visible"
            return
        self._reason = found.depth.reason
        if found.depth.fused is None:
            self._refused += 1
            rospy.logwarn_throttle(throttle_s, f"No pose with depth: {self._reason}.")
            return
        self._fused += 1
        colour, fused = found.depth.colour.T_camera_board, found.depth.fused.T_camera_board
        self._values = {
            "colour_to_fused_mm": f"{1e3 * np.linalg.norm(colour[:3, 3] - fused[:3, 3]):.2f}",
            "colour_to_fused_deg": f"{np.degrees(rotation_angle(colour[:3, :3].T @ fused[:3, :3])):.3f}",
            "range_colour_less_depth_mm": f"{1e3 * found.depth.disagreement:.2f}",
            "pixels": str(found.depth.fit.pixels),
            "inliers": f"{found.depth.fit.inliers:.3f}",
        }

    def _diagnose(self) -> tuple[int, str, dict[str, object]]:
        values = {"pairs": self._pairs.pairs, "fused": self._fused, "refused": self._refused, **self._values}
        fault = self._pairs.inputs.fault()
        if fault:
            return DiagnosticStatus.WARN, fault, values
        if self._reason:
            return DiagnosticStatus.WARN, self._reason, values
        return DiagnosticStatus.OK, "the marker board has a pose with depth", values


def _detections(found: RgbdDetection | None, name: str) -> tuple[TargetDetection, ...]:
    """Returns the detection with the pose of that name instead of its own; empty if there is none."""
    estimate = None if found is None else getattr(found.depth, name)
    if estimate is None:
        return ()
    pose = replace(found.colour.pose, T_camera_tag=estimate.T_camera_board, covariance=estimate.covariance)
    return (replace(found.colour, pose=pose),)


def main() -> None:
    cv2.setNumThreads(1)
    config = private_config(PairsConfig, others=SECTIONS)
    board = private_config(MarkerBoardConfig, "panel")
    poses = private_config(PlanePoseConfig, "plane_pose")
    values = private_values().get("detector", {})
    settings = detector_settings({**values, "rectified": False}, prefix="~detector/")  # the images are raw
    target = board_target(values, "~detector", board.frame)
    rospy.loginfo("%s; %s", settings, poses)
    try:
        detector = RgbdDetector(settings, target, board.plate, poses)
    except ValueError as error:
        raise ConfigError([f"{str(error)[0].upper()}{str(error)[1:]}."]) from None
    PlanePoseNode(detector, board.frame, settings.publish_tf, config.slop)
    rospy.spin()
