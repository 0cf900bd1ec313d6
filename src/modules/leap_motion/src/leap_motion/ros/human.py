"""A tracking frame as the message leap_motion/Human, filled as the published C++ driver fills it.

That driver has two errors. `compatible` repeats them, for programs written for it; `correct` does not:

| field | compatible | correct |
| --- | --- | --- |
| orientation of bones and arm | the conjugate of the bone's orientation | the bone's orientation |
| arm.direction | the arm's centre | unit vector from elbow to wrist |

`direction` and `normal` of the hand, and every position, are the same in both. All vectors stay in the Leap's own axes.
Gestures, which this driver does not ask for, and the texts of hands, fingers and bones stay empty."""

from __future__ import annotations

import struct
from functools import cached_property, lru_cache
from io import BytesIO

import numpy as np
import rospy
from std_msgs.msg import Header

from common.rotations import quaternions_from_rotations
from leap_motion.frames import LeapBone, LeapFinger, LeapFrame, LeapHand, int32
from leap_motion.msg import Human
from leap_motion.ros.parameters import COMPATIBLE

FRAME_ID = b"leap_hands"
HEADER = "IIII10s"  # seq, stamp, length of the frame id and the frame id
TOP = struct.Struct(f"<{HEADER}4ifI")  # of the message, up to the length of its to_string
HAND = struct.Struct(f"<{HEADER}i2B5f3d3d2fI3f3d2fI3fII")  # of a hand, up to the number of fingers
ARM = struct.Struct("<I4I7d7dI3f3d")  # the rest of a hand, from the number of gestures on
_HEADER = np.dtype([("numbers", "<u4", 3), ("length", "<u4"), ("frame_id", "S10")])
_POSE = np.dtype([("position", "<f8", 3), ("orientation", "<f8", 4)])
_BONE = np.dtype([
    ("header", _HEADER), ("type", "u1"), ("length", "<f4"), ("width", "<f4"), ("to_string", "<u4"),
    ("ends", _POSE, 2), ("center_count", "<u4"), ("center", "<f4", 3),
])  # fmt: skip
FINGER = np.dtype([
    ("header", _HEADER), ("id", "<i4"), ("type", "u1"), ("length", "<f4"), ("width", "<f4"), ("to_string", "<u4"),
    ("bone_count", "<u4"), ("bones", _BONE, 4),
])  # fmt: skip
"""A finger of the message, if the frame id is FRAME_ID, the texts are empty and all lists are complete."""
CENTER = 3
NO_HAND = bytes(
    struct.calcsize("<4Ii2B5f3d3d2fI3d2f4I4I7d7dI3d")
)  # a hand whose numbers are 0 and whose lists are empty


class FrameMessage(Human):
    """The message of a frame received at `stamp`; of several hands of one side the one tracked longest. It has no
    fields but the header. Its bytes are made where they are sent, which rospy does for subscribers only."""

    def __init__(self, frame: LeapFrame, stamp: rospy.Time, orientation: str = COMPATIBLE) -> None:
        self.header = Header(0, stamp, FRAME_ID.decode())
        self.frame = frame
        self._compatible = orientation == COMPATIBLE

    def serialize(self, buff: BytesIO) -> None:
        """Writes the bytes of the message."""
        buff.write(self.data)

    @cached_property
    def data(self) -> bytes:
        """The bytes, with the header as it is when they are first asked for."""
        frame, header = self.frame, (self.header.seq, self.header.stamp.secs, self.header.stamp.nsecs)
        counts = len(frame.hands), frame.finger_count, frame.gestures
        text = f"frame {frame.id}, device time {frame.timestamp_us} us".encode()
        data = TOP.pack(*header, len(FRAME_ID), FRAME_ID, int32(frame.id), *counts, frame.rate, len(text)) + text
        for hand in map(frame.hand, ("right", "left")):
            data += NO_HAND if hand is None else _hand_bytes(hand, header, self._compatible)
        return data


def _hand_bytes(hand: LeapHand, header: tuple[int, int, int], compatible: bool) -> bytes:
    bones = [finger.rotations for finger in hand.fingers]
    rotations = np.concatenate([*bones, (hand.arm.rotation if hand.arm else np.eye(3))[None]])
    quaternions = quaternions_from_rotations(rotations)
    if compatible:
        quaternions[:, :3] *= -1.0
    head = HAND.pack(
        *header, len(FRAME_ID), FRAME_ID, int32(hand.id), True, False,
        hand.time_visible, hand.confidence, hand.roll, hand.pitch, hand.yaw,
        *hand.direction.tolist(), *hand.normal.tolist(), hand.grab, hand.pinch,
        CENTER, *hand.velocity.tolist(), *hand.palm.tolist(), hand.palm_width, hand.sphere_radius,
        CENTER, *hand.sphere_center.tolist(), 0, len(hand.fingers),
    )  # fmt: skip
    fingers = _finger_bytes(hand.fingers, header, quaternions[:-1].reshape(-1, 4, 1, 4)) if hand.fingers else b""
    return head + fingers + _arm_bytes(hand.arm, header, quaternions[-1].tolist(), compatible)


def _finger_bytes(fingers: tuple[LeapFinger, ...], header: tuple[int, int, int], quaternions: np.ndarray) -> bytes:
    """Returns the bytes of n fingers whose bones have the orientations `quaternions`, shape (n, 4, 1, 4)."""
    records = empty_fingers(len(fingers)).copy()
    bones = records["bones"]
    joints = np.array([finger.joints for finger in fingers])
    start, end = joints[:, :-1], joints[:, 1:]
    widths = [finger.width for finger in fingers]
    records["header"]["numbers"] = bones["header"]["numbers"] = header
    records["id"] = [int32(finger.id) for finger in fingers]
    records["type"] = [finger.type for finger in fingers]
    records["length"] = [finger.length for finger in fingers]
    records["width"] = widths
    bones["width"] = np.array(widths)[:, None]
    bones["length"] = np.linalg.norm(end - start, axis=-1)
    bones["center"] = 0.5 * (start + end)
    ends = bones["ends"]
    ends["position"][:, :, 0], ends["position"][:, :, 1], ends["orientation"] = start, end, quaternions
    return records.tobytes()


def _arm_bytes(arm: LeapBone | None, header: tuple[int, int, int], q: list[float], compatible: bool) -> bytes:
    if arm is None:
        return ARM.pack(*[0] * 19, CENTER, *[0.0] * 6)
    center = arm.center
    direction = center if compatible else -arm.rotation[:, 2]
    ends = *arm.start.tolist(), *q, *arm.end.tolist(), *q
    return ARM.pack(0, 0, *header[1:], 0, *ends, CENTER, *center.tolist(), *direction.tolist())


@lru_cache(maxsize=None)
def empty_fingers(n: int, mask: bool = False) -> np.ndarray:
    """Returns n fingers with the types, counts and texts, zero elsewhere, shape (n,); as a `mask` all their bits."""
    records = np.zeros(n, FINGER)
    for part, count, number in ((records, "bone_count", 4), (records["bones"], "center_count", CENTER)):
        part["type"] = 255 if mask else range(part.shape[-1])
        part["to_string"] = 2**32 - 1 if mask else 0
        part[count] = 2**32 - 1 if mask else number
        part["header"]["length"] = 2**32 - 1 if mask else len(FRAME_ID)
        part["header"]["frame_id"] = b"\xff" * len(FRAME_ID) if mask else FRAME_ID
    records.setflags(write=False)
    return records
