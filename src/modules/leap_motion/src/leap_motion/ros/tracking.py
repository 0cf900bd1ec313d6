"""From the topic leap_motion/leap_device to tracking frames.

Of a message as `leap_motion.ros.human` writes it, only what a tracking frame holds is read; of any other one, such as
the published C++ driver's, genpy reads all fields first.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
import rospy

from common.poses import read_only
from common.ros.conversions import array
from common.ros.node import while_running
from leap_motion.frames import DISTAL, INDEX, INTERMEDIATE, MIDDLE, THUMB, FingerPoints, TrackedHand, TrackingFrame
from leap_motion.msg import Human
from leap_motion.ros.human import ARM, CENTER, FINGER, FRAME_ID, HAND, NO_HAND, TOP, empty_fingers

RIGHT, LEFT = "right", "left"
HUMAN_BUFFER_BYTES = 2**20  # room for many messages: rospy drops all but the newest only among those that it has read
FIVE_BYTES = 5 * FINGER.itemsize
COUNTS, COUNTED = (
    np.frombuffer(fingers.tobytes(), np.uint8) for fingers in (empty_fingers(5), empty_fingers(5, mask=True))
)
"""The bytes of five fingers that say how they are laid out, and a mask of these bytes; zero elsewhere."""


class ReceivedHuman(Human):
    """A message of the topic as its stamp, `frame_id` of the tracker, and `hands`."""

    with_fingers = True

    def __init__(self) -> None:
        self.stamp, self.frame_id, self.hands = rospy.Time(), 0, ()

    def deserialize(self, data: bytes) -> ReceivedHuman:
        """Reads the bytes of a message; raises genpy.DeserializationError for bytes that are not a Human message."""
        try:
            self._read_usual(data)
        except (_UnusualLayout, struct.error):
            self._read_any(Human().deserialize(data))
        return self

    def _read_usual(self, data: bytes) -> None:
        top = TOP.unpack_from(data)
        at = TOP.size + top[-1]
        hands = []
        for is_left in (False, True):
            if data.startswith(NO_HAND, at):
                at += len(NO_HAND)
            else:
                hand, at = _hand_at(data, at, is_left, self.with_fingers)
                hands.append(hand)
        if top[3] != len(FRAME_ID) or at != len(data):
            raise _UnusualLayout
        self.stamp, self.frame_id, self.hands = rospy.Time(*top[1:3]), top[5], tuple(hands)

    def _read_any(self, human: Human) -> None:
        self.stamp, self.frame_id = human.header.stamp, human.lmc_frame_id
        self.hands = tuple(
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

    def frame(self, now: rospy.Time) -> TrackingFrame:
        """Returns the tracking frame, if the message arrived at the ROS time `now`."""
        return TrackingFrame(self.frame_id, (now - self.stamp).to_sec(), self.hands)


class ReceivedPalms(ReceivedHuman):
    """A message without the fingers of its hands."""

    with_fingers = False


class _UnusualLayout(Exception):
    """The bytes are not laid out as `leap_motion.ros.human` writes them with five fingers."""


def subscribe(
    on_frame: Callable[[TrackingFrame, rospy.Time], None], kind: type[ReceivedHuman] = ReceivedHuman
) -> rospy.Subscriber:
    """Calls `on_frame` with the newest tracking frame and its stamp; older ones that still wait are skipped.

    A process subscribes once: rospy gives the same kind of message to all subscribers of a topic in a process.
    """

    def on_human(human: ReceivedHuman) -> None:
        with while_running():
            on_frame(human.frame(rospy.Time.now()), human.stamp)

    return rospy.Subscriber(
        "leap_motion/leap_device", kind, on_human, queue_size=1, buff_size=HUMAN_BUFFER_BYTES, tcp_nodelay=True
    )


def _hand_at(data: bytes, at: int, is_left: bool, with_fingers: bool) -> tuple[TrackedHand, int]:
    """Returns the hand that begins at a byte, and where it ends."""
    head = HAND.unpack_from(data, at)
    at += HAND.size
    if (head[3], head[6], head[21], head[30], *head[34:]) != (len(FRAME_ID), True, CENTER, CENTER, 0, 5):
        raise _UnusualLayout
    end = at + FIVE_BYTES
    arm = ARM.unpack_from(data, end)
    if (arm[0], arm[4], arm[19]) != (0, 0, CENTER) or (np.frombuffer(data[at:end], np.uint8) & COUNTED != COUNTS).any():
        raise _UnusualLayout
    direction, normal, palm = read_only((head[13:16], head[16:19], head[25:28]))
    fingers = None
    if with_fingers:
        bones = np.frombuffer(data, FINGER, 5, at)["bones"][[INDEX, MIDDLE, THUMB]]
        tips, centers = bones["ends"]["position"][:, DISTAL, 1], bones["center"][:, INTERMEDIATE]
        fingers = FingerPoints(*read_only((*tips, *centers[:2])))
    return TrackedHand(head[5], is_left, palm, direction, normal, head[9], fingers), end + ARM.size


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
