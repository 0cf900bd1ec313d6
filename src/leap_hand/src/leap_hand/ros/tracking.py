"""From the message leap_motion/Human to this package's records."""

from __future__ import annotations

from common.ros.conversions import array
from leap_hand.flexion import HandPoints
from leap_hand.teleop import TrackedHand, TrackingFrame

THUMB, INDEX, MIDDLE = 0, 1, 2
FINGER_TYPES = [0, 1, 2, 3, 4]
INTERMEDIATE, DISTAL = 2, 3


def frame_from_human(human, now) -> TrackingFrame:
    """Returns the frame of a leap_motion/Human message that arrived at the ROS time `now`."""
    hands = [(human.right_hand, False), (human.left_hand, True)]
    return TrackingFrame(
        id=human.lmc_frame_id,
        age=(now - human.header.stamp).to_sec(),
        hands=tuple(
            TrackedHand(hand.lmc_hand_id, is_left, _points(hand)) for hand, is_left in hands if hand.is_present
        ),
    )


def _points(hand) -> HandPoints | None:
    """Returns the points of a hand with five fingers and the bones that count, else None."""
    if sorted(finger.type for finger in hand.finger_list) != FINGER_TYPES:
        return None
    bones = {(finger.type, bone.type): bone for finger in hand.finger_list for bone in finger.bone_list}
    try:
        return HandPoints(
            palm=array(hand.palm_center),
            normal=array(hand.normal),
            index_tip=array(bones[INDEX, DISTAL].bone_end.position),
            middle_tip=array(bones[MIDDLE, DISTAL].bone_end.position),
            thumb_tip=array(bones[THUMB, DISTAL].bone_end.position),
            index_bone=bones[INDEX, INTERMEDIATE].center,
            middle_bone=bones[MIDDLE, INTERMEDIATE].center,
        )
    except KeyError:
        return None
