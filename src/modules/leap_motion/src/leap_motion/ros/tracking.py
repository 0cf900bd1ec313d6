"""From the topic leap_motion/leap_device to tracking frames."""

from __future__ import annotations

from collections.abc import Callable

import rospy

from common.ros.conversions import array
from common.ros.node import while_running
from leap_motion.frames import DISTAL, INDEX, INTERMEDIATE, MIDDLE, THUMB, FingerPoints, TrackedHand, TrackingFrame
from leap_motion.msg import Human

RIGHT, LEFT = "right", "left"
HUMAN_BUFFER_BYTES = 2**20  # room for many messages: rospy drops all but the newest only among those that it has read


def subscribe(on_frame: Callable[[TrackingFrame, rospy.Time], None]) -> rospy.Subscriber:
    """Calls `on_frame` with the newest tracking frame and its stamp; older ones that still wait are skipped."""

    def on_human(human: Human) -> None:
        with while_running():
            on_frame(frame_from_human(human, rospy.Time.now()), human.header.stamp)

    return rospy.Subscriber(
        "leap_motion/leap_device", Human, on_human, queue_size=1, buff_size=HUMAN_BUFFER_BYTES, tcp_nodelay=True
    )


def frame_from_human(human: Human, now: rospy.Time) -> TrackingFrame:
    """Returns the tracking frame of a message that arrived at the ROS time `now`."""
    hands = tuple(
        TrackedHand(
            id=hand.lmc_hand_id,
            is_left=hand is human.left_hand,
            palm=array(hand.palm_center),
            direction=array(hand.direction),
            normal=array(hand.normal),
            confidence=hand.confidence,
            fingers=_fingers(hand),
        )
        for hand in (human.right_hand, human.left_hand)
        if hand.is_present
    )
    return TrackingFrame(human.lmc_frame_id, (now - human.header.stamp).to_sec(), hands)


def _fingers(hand) -> FingerPoints | None:
    """Returns the finger points of a hand with five fingers and the necessary bones, else None."""
    if sorted(finger.type for finger in hand.finger_list) != list(range(5)):  # thumb to pinky
        return None
    bones = {(finger.type, bone.type): bone for finger in hand.finger_list for bone in finger.bone_list}
    try:
        return FingerPoints(
            index_tip=array(bones[INDEX, DISTAL].bone_end.position),
            middle_tip=array(bones[MIDDLE, DISTAL].bone_end.position),
            thumb_tip=array(bones[THUMB, DISTAL].bone_end.position),
            index_bone=bones[INDEX, INTERMEDIATE].center,
            middle_bone=bones[MIDDLE, INTERMEDIATE].center,
        )
    except KeyError:
        return None
