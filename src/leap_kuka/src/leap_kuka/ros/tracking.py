"""From the message leap_motion/Human to this package's records."""

from __future__ import annotations

from common.ros.conversions import array
from leap_kuka.hand_frame import HandSample
from leap_kuka.teleop import TrackingFrame


def frame_from_human(human, now) -> TrackingFrame:
    """Returns the frame of a leap_motion/Human message that arrived at the ROS time `now`."""
    hands = [(human.right_hand, False), (human.left_hand, True)]
    return TrackingFrame(
        id=human.lmc_frame_id,
        age=(now - human.header.stamp).to_sec(),
        hands=tuple(_sample(hand, is_left) for hand, is_left in hands if hand.is_present),
    )


def _sample(hand, is_left: bool) -> HandSample:
    return HandSample(
        id=hand.lmc_hand_id,
        is_left=is_left,
        position=array(hand.palm_center),
        direction=array(hand.direction),
        normal=array(hand.normal),
        confidence=hand.confidence,
    )
