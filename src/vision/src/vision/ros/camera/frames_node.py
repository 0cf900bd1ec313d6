"""The node camera_frames: publishes the static frames of the RGB-D camera."""

from __future__ import annotations

import rospy
import tf2_ros

from common.ros.conversions import stamped_transform
from common.ros.params import private_config
from vision.camera.frames import CameraFramesConfig, camera_frames


def main() -> None:
    config = private_config(CameraFramesConfig)
    stamp = rospy.Time.now()
    transforms = [stamped_transform(T, parent, child, stamp) for parent, child, T in camera_frames(config)]
    broadcaster = tf2_ros.StaticTransformBroadcaster()
    broadcaster.sendTransform(transforms)
    rospy.spin()
