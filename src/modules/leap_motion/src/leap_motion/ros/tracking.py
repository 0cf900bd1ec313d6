"""From the topic leap_motion/leap_device to tracking frames: of our own driver's messages only what they hold is
read, of any other one genpy reads all fields."""

from __future__ import annotations

import math
import struct
import traceback
import typing
from collections.abc import Callable

import numpy as np
import rospy

from common import clock
from common.poses import read_only
from common.ros.conversions import array
from common.ros.node import while_running
from leap_motion.frames import (
    DISTAL,
    INDEX,
    INTERMEDIATE,
    MIDDLE,
    THUMB,
    FingerPoints,
    TrackedHand,
    TrackingFrame,
    int32,
    tracked_hands,
)
from leap_motion.msg import Human
from leap_motion.ros.human import ARM, CENTER, FINGER, FRAME_ID, HAND, NO_HAND, TOP, FrameMessage, empty_fingers

FIVE_BYTES = 5 * FINGER.itemsize
COUNTS, COUNTED = (
    np.frombuffer(fingers.tobytes(), np.uint8) for fingers in (empty_fingers(5), empty_fingers(5, mask=True))
)
"""The bytes of five fingers that say how they are laid out, and a mask of these bytes; zero elsewhere."""


class ReceivedHuman(Human):
    """A message of the topic as its stamp, `frame_id` of the tracker, and `hands`."""

    with_fingers = True
    with_joints = False

    def __init__(self) -> None:
        self.stamp = rospy.Time()
        self.frame_id = 0
        self.hands = ()

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
                hand, at = _hand_at(data, at, is_left, self.with_fingers, self.with_joints)
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
                grab=hand.grab_strength,
                pinch=hand.pinch_strength,
                joints=_joints(hand) if self.with_joints else None,
            )
            for hand in (human.right_hand, human.left_hand)
            if hand.is_present
        )

    def frame(self, now: rospy.Time) -> TrackingFrame:
        return TrackingFrame(self.frame_id, (now - self.stamp).to_sec(), self.hands)


class ReceivedPalms(ReceivedHuman):
    """A message without the fingers of its hands."""

    with_fingers = False


class ReceivedSkeletons(ReceivedHuman):
    """A message with all joints of its hands."""

    with_fingers = False
    with_joints = True


class _UnusualLayout(Exception):
    """The bytes are not laid out as `leap_motion.ros.human` writes them with five fingers."""


def subscribe(
    on_frame: Callable[[TrackingFrame, rospy.Time], None], kind: type[ReceivedHuman] = ReceivedHuman
) -> rospy.Subscriber:
    """Calls `on_frame` with the newest tracking frame and its stamp; older ones that still wait are skipped. An
    `on_frame` that takes its time thus sees fewer frames, and those skipped cost next to nothing. A process
    subscribes once: rospy gives the same kind of message to all subscribers of a topic in a process."""
    # room for many messages: rospy drops all but the newest only among those that it has read
    human_buffer_bytes = 2**20

    def on_human(human: ReceivedHuman) -> None:
        with while_running():
            on_frame(human.frame(rospy.Time.now()), human.stamp)

    return rospy.Subscriber(
        "leap_motion/leap_device", kind, on_human, queue_size=1, buff_size=human_buffer_bytes, tcp_nodelay=True
    )


Subscribe = typing.Callable[..., object]
"""`subscribe`, or that of the frames of a driver in the same process."""


class FramesHere:
    """Passes a driver's frames on to the nodes of its process: no message is read, and no other process wakes."""

    def __init__(self) -> None:
        self._takers: list[Callable[[TrackingFrame, rospy.Time], None]] = []
        self._logged_at: dict[Callable, float] = {}  # of a taker that failed [s]

    def subscribe(
        self, on_frame: Callable[[TrackingFrame, rospy.Time], None], _: type[ReceivedHuman], first: bool = False
    ) -> None:
        """Calls `on_frame` with each tracking frame and its stamp, in the driver's thread; `first`: before others."""
        self._takers.insert(0 if first else len(self._takers), on_frame)

    def pass_on(self, message: FrameMessage) -> None:
        """Gives the frame of a message to all; the exception of one is logged, once a second, and the others get it."""
        log_period_s = 1.0  # between two errors of one taker
        frame, hands, stamp = message.frame, tracked_hands(message.frame), message.header.stamp
        for on_frame in tuple(self._takers):
            try:
                with while_running():
                    age = (rospy.Time.now() - stamp).to_sec()
                    on_frame(TrackingFrame(int32(frame.id), age, hands), stamp)
            except Exception:
                if clock.monotonic() - self._logged_at.get(on_frame, -math.inf) >= log_period_s:
                    self._logged_at[on_frame] = clock.monotonic()
                    reason = traceback.format_exc().splitlines()[-1]
                    rospy.logerr("%s failed with a tracking frame: %s", on_frame.__qualname__, reason)


def _hand_at(data: bytes, at: int, is_left: bool, with_fingers: bool, with_joints: bool) -> tuple[TrackedHand, int]:
    head = HAND.unpack_from(data, at)
    at += HAND.size
    if (head[3], head[6], head[21], head[30], *head[34:]) != (len(FRAME_ID), True, CENTER, CENTER, 0, 5):
        raise _UnusualLayout
    end = at + FIVE_BYTES
    arm = ARM.unpack_from(data, end)
    if (arm[0], arm[4], arm[19]) != (0, 0, CENTER) or (np.frombuffer(data[at:end], np.uint8) & COUNTED != COUNTS).any():
        raise _UnusualLayout
    direction, normal, palm = read_only((head[13:16], head[16:19], head[25:28]))
    fingers = joints = None
    if with_joints:
        ends = np.frombuffer(data, FINGER, 5, at)["bones"]["ends"]["position"]
        joints = read_only(np.concatenate((ends[:, :1, 0], ends[:, :, 1]), axis=1))
    if with_fingers:
        bones = np.frombuffer(data, FINGER, 5, at)["bones"][[INDEX, MIDDLE, THUMB]]
        tips, centers = bones["ends"]["position"][:, DISTAL, 1], bones["center"][:, INTERMEDIATE]
        fingers = FingerPoints(*read_only((*tips, *centers[:2])))
    tracked = TrackedHand(head[5], is_left, palm, direction, normal, head[9], fingers, *head[19:21], joints)
    return tracked, end + ARM.size


def _joints(hand) -> np.ndarray | None:
    """Returns the joints of a hand with five fingers of four bones each, shape (5, 5, 3) [m], else None."""
    fingers = [finger.bone_list for finger in hand.finger_list]
    if [len(bones) for bones in fingers] != [4] * 5:
        return None
    chains = ([bones[0].bone_start, *(bone.bone_end for bone in bones)] for bones in fingers)
    return read_only([[array(end.position) for end in chain] for chain in chains])


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
