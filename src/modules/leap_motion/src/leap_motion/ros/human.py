"""A tracking frame as the message leap_motion/Human, filled as the published C++ driver fills it.

That driver has two errors. `compatible` repeats them, for programs written for it; `correct` does not:

| field | compatible | correct |
| --- | --- | --- |
| orientation of bones and arm | the conjugate of the bone's orientation | the bone's orientation |
| arm.direction | the arm's centre | unit vector from elbow to wrist |

`direction` and `normal` of the hand, and every position, are the same in both. All vectors stay in the Leap's own axes.
Gestures, which this driver does not ask for, and the texts of hands, fingers and bones stay empty.
"""

from __future__ import annotations

import numpy as np
import rospy
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import Header

from common.rotations import quaternion_from_rotation
from leap_motion.frames import LeapBone, LeapFinger, LeapFrame, LeapHand
from leap_motion.msg import Arm, Bone, Finger, Hand, Human
from leap_motion.ros.parameters import COMPATIBLE

FRAME_ID = "leap_hands"


def human_from_frame(frame: LeapFrame, stamp: rospy.Time, orientation: str = COMPATIBLE) -> Human:
    """Returns the message of a frame received at `stamp`; of several hands of one side the one tracked longest."""
    header = Header(0, stamp, FRAME_ID)
    convert = _Converter(header, orientation == COMPATIBLE)
    return Human(
        header=header,
        lmc_frame_id=_int32(frame.id),
        nr_of_hands=len(frame.hands),
        nr_of_fingers=frame.finger_count,
        nr_of_gestures=frame.gestures,
        current_frames_per_second=frame.rate,
        to_string=f"frame {frame.id}, device time {frame.timestamp_us} us",
        right_hand=convert.hand(frame.hand("right")),
        left_hand=convert.hand(frame.hand("left")),
    )


class _Converter:
    """Converts the parts of one frame; all of them carry the same header."""

    def __init__(self, header: Header, compatible: bool) -> None:
        self._header, self._compatible = header, compatible

    def hand(self, hand: LeapHand | None) -> Hand:
        if hand is None:
            return Hand()
        return Hand(
            header=self._header,
            lmc_hand_id=_int32(hand.id),
            is_present=True,
            time_visible=hand.time_visible,
            confidence=hand.confidence,
            roll=hand.roll,
            pitch=hand.pitch,
            yaw=hand.yaw,
            direction=Vector3(*hand.direction.tolist()),
            normal=Vector3(*hand.normal.tolist()),
            grab_strength=hand.grab,
            pinch_strength=hand.pinch,
            palm_velocity=hand.velocity.tolist(),
            palm_center=Point(*hand.palm.tolist()),
            palm_width=hand.palm_width,
            sphere_radius=hand.sphere_radius,
            sphere_center=hand.sphere_center.tolist(),
            finger_list=[self._finger(finger) for finger in hand.fingers],
            arm=self._arm(hand.arm) if hand.arm else Arm(center=[0.0, 0.0, 0.0]),
        )

    def _finger(self, finger: LeapFinger) -> Finger:
        return Finger(
            header=self._header,
            lmc_finger_id=_int32(finger.id),
            type=finger.type,
            length=finger.length,
            width=finger.width,
            bone_list=[self._bone(bone, i, finger.width) for i, bone in enumerate(finger.bones)],
        )

    def _bone(self, bone: LeapBone, number: int, width: float) -> Bone:
        start, end = self._ends(bone)
        return Bone(self._header, number, bone.length, width, "", start, end, bone.center.tolist())

    def _arm(self, arm: LeapBone) -> Arm:
        elbow, wrist = self._ends(arm)
        center = arm.center
        direction = center if self._compatible else -arm.rotation[:, 2]
        header = Header(0, self._header.stamp, "")
        return Arm(header, elbow, wrist, center.tolist(), Vector3(*direction.tolist()))

    def _ends(self, bone: LeapBone) -> tuple[Pose, Pose]:
        rotation = bone.rotation.T if self._compatible else bone.rotation
        orientation = Quaternion(*quaternion_from_rotation(rotation).tolist())
        return Pose(Point(*bone.start.tolist()), orientation), Pose(Point(*bone.end.tolist()), orientation)


def _int32(number: int) -> int:
    """Returns the low 32 bits as a signed number, the part of a longer id that the field can hold."""
    return int(np.int64(number & 0xFFFFFFFF).astype(np.int32))
