"""Between ROS messages and arrays; invalid numbers are refused here."""

from __future__ import annotations

import numpy as np
import rospy
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Transform, TransformStamped, Vector3
from std_msgs.msg import Header

from common.frames import frame_name
from common.poses import pose
from common.rotations import quaternion_from_rotation, rotation_from_quaternion


def stamped_transform(T: np.ndarray, parent: str, child: str, stamp: rospy.Time) -> TransformStamped:
    """Returns the tf message of the pose T, shape (4, 4), of `child` in `parent`; raises ValueError for frames that no
    listener takes."""
    if not parent or not child or parent == child:
        raise ValueError(f"tf takes no frame {child!r} in {parent!r}: set the frame_id in the driver of the images")
    return TransformStamped(Header(0, stamp, parent), child, transform_message(T))


def transform_message(T: np.ndarray) -> Transform:
    """Returns the message of the pose T, shape (4, 4), without frames."""
    return Transform(Vector3(*T[:3, 3].tolist()), Quaternion(*quaternion_from_rotation(T[:3, :3]).tolist()))


def pose_from_transform(transform: Transform) -> np.ndarray:
    """Returns the pose, shape (4, 4), of a Transform message; raises ValueError if a number is not finite, or the
    quaternion is not a unit quaternion."""
    return _pose(transform.translation, transform.rotation)


def pose_from_message(message: Pose) -> np.ndarray:
    """Returns the pose, shape (4, 4), of a Pose message; raises ValueError as pose_from_transform does."""
    return _pose(message.position, message.orientation)


def message_from_pose(T: np.ndarray) -> Pose:
    """Returns the message of the pose T, shape (4, 4)."""
    return Pose(Point(*T[:3, 3].tolist()), Quaternion(*quaternion_from_rotation(T[:3, :3]).tolist()))


def stamped_pose(T: np.ndarray, frame: str, stamp: rospy.Time) -> PoseStamped:
    """Returns the message of the pose T, shape (4, 4), in `frame`."""
    return PoseStamped(Header(0, stamp, frame), message_from_pose(T))


def pose_in(frame: str, message: PoseStamped) -> np.ndarray:
    """Returns the pose, shape (4, 4), of a message that must be in `frame`; raises as `pose_from_message` does."""
    if frame_name(message.header.frame_id) != frame:
        raise ValueError(f"its frame is {message.header.frame_id!r} instead of {frame}")
    return pose_from_message(message.pose)


def _pose(position: Vector3 | Point, q: Quaternion) -> np.ndarray:
    p = array(position)
    if not np.all(np.isfinite(p)):
        raise ValueError(f"the translation {p.tolist()} is not finite")
    return pose(rotation_from_quaternion([q.x, q.y, q.z, q.w]), p)


def array(v: Vector3 | Point) -> np.ndarray:
    """Returns x, y, z of a Vector3 or Point as an array, shape (3,)."""
    return np.array([v.x, v.y, v.z])
