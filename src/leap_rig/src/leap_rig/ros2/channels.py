"""What passes through the door to ROS 2: topics by their numbers, and what the two processes tell each other."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass

WANTED, DESIRED, STATIC, FAULT, GOAL, CANCEL, FEEDBACK, RESULT = range(8)
"""Channels beside the topics. From ROS 2: JSON numbers of the topics with subscribers, twice a second; desired tool
frames, also static ones, behind the name of their publisher; a sentence; a goal and its cancellation. To ROS 2:
feedback and result of a goal."""
FIRST_TOPIC = 16
MOVE = struct.Struct("<BI")  # before a goal and what follows from it: number of the arm, and of the goal
SUCCEEDED, CANCELLED, ABORTED = range(3)  # first byte of a result

IMAGE, COMPRESSED = "camera/rgb/image_raw", "camera/rgb/image_raw/compressed"
DESCRIPTION, WRENCH, STATUS, STATE = "robot_description", "kuka/flange_wrench", "kuka/status", "leap_kuka/state"
DIAGNOSTIC = "diagnostic_msgs/DiagnosticStatus"


@dataclass(frozen=True)
class Channel:
    """A topic from ROS 1 to ROS 2, of one name in both."""

    number: int
    topic: str
    kind: str  # type, as of ROS 1
    depth: int = 1  # how many messages of each publisher wait for a slow ROS 2
    is_latched: bool = False


SHARED = (
    ("tf", "tf2_msgs/TFMessage", 100, False),
    ("tf_static", "tf2_msgs/TFMessage", 1, True),
    ("diagnostics", "diagnostic_msgs/DiagnosticArray", 10, False),
    (COMPRESSED, "sensor_msgs/CompressedImage", 1, False),
    ("camera/rgb/camera_info", "sensor_msgs/CameraInfo", 1, False),
)
OF_EACH_ARM = (
    ("joint_states", "sensor_msgs/JointState", 2, False),
    (DESCRIPTION, "std_msgs/String", 1, True),
    (WRENCH, "geometry_msgs/WrenchStamped", 2, False),
    (STATUS, DIAGNOSTIC, 2, False),
    (STATE, DIAGNOSTIC, 2, False),
    ("leap_kuka/stream", DIAGNOSTIC, 2, False),
)


def channels(arms: Iterable[str] = ("",)) -> list[Channel]:
    """Returns the topics of a rig with these arms, such as left/ and right/, or an empty name for the only one."""
    rows = [*SHARED, *((arm + topic, *rest) for arm in arms for topic, *rest in OF_EACH_ARM)]
    return [Channel(FIRST_TOPIC + i, *row) for i, row in enumerate(rows)]  # type: ignore[arg-type]
