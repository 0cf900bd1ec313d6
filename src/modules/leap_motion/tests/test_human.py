"""Conversion of frames to leap_motion/Human."""

import gzip
import io
import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

from leap_motion.codec import read_message

pytestmark = pytest.mark.ros

PITCHED = [[1, 0, 0], [0, 0.8660, 0.5], [0, -0.5, 0.8660]]
PITCHED_AND_TURNED = [[0.9397, 0, 0.3420], [-0.1710, 0.8660, 0.4698], [-0.2962, -0.5, 0.8138]]


def frame(basis, side="right"):
    """A frame with one hand, whose fingers' bones and arm all have this basis on the wire."""
    hand = {
        "id": 7,
        "type": side,
        "palmPosition": [10, 200, -30],
        "palmNormal": [0, -1, 0],
        "direction": [0, 0, -1],
        "palmVelocity": [1, 2, 3],
        "confidence": 0.9,
        "timeVisible": 2.5,
        "elbow": [0, 100, 300],
        "wrist": [0, 180, 60],
        "armBasis": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    }
    fingers = [
        {
            "id": 70 + kind,
            "handId": 7,
            "type": kind,
            "carpPosition": [kind, 0, 70],
            "mcpPosition": [kind, 0, 0],
            "pipPosition": [kind, 0, -40],
            "dipPosition": [kind, 0, -60],
            "btipPosition": [kind, 0, -80],
            "tipPosition": [kind, 0, -75],
            "bases": [basis] * 4,
            "length": 55,
            "width": 18,
        }
        for kind in range(5)
    ]
    return read_message(
        json.dumps(
            {"id": 2**40 + 5, "timestamp": 12, "currentFrameRate": 115.5, "hands": [hand], "pointables": fingers}
        )
    )


def convert(got, orientation="compatible"):
    rospy = pytest.importorskip("rospy")
    from leap_motion.ros.human import human_from_frame

    return human_from_frame(got, rospy.Time(12, 34), orientation)


def quaternion(pose):
    q = pose.orientation
    return [q.x, q.y, q.z, q.w]


@pytest.mark.parametrize(
    ("basis", "compatible"),
    [(PITCHED, [-0.2588, 0, 0, 0.9659]), (PITCHED_AND_TURNED, [-0.2549, 0.1677, -0.0449, 0.9513])],
)
@pytest.mark.parametrize("side", ["right", "left"])
def test_orientations_of_bones(basis, compatible, side):
    wire = [[-v for v in basis[0]], *basis[1:]] if side == "left" else basis
    correct = [-v for v in compatible[:3]] + [compatible[3]]
    for orientation, expected in (("compatible", compatible), ("correct", correct)):
        human = convert(frame(wire, side), orientation)
        hand = human.left_hand if side == "left" else human.right_hand
        bone = hand.finger_list[1].bone_list[2]
        assert_allclose(quaternion(bone.bone_start), expected, atol=1e-4)
        assert_allclose(quaternion(bone.bone_end), expected, atol=1e-4)


def test_fields():
    human = convert(frame(PITCHED))
    assert (human.header.frame_id, human.header.stamp.secs, human.header.stamp.nsecs) == ("leap_hands", 12, 34)
    assert (human.lmc_frame_id, human.nr_of_hands, human.nr_of_fingers, human.nr_of_gestures) == (5, 1, 5, 0)
    assert human.current_frames_per_second == 115.5
    hand = human.right_hand
    assert (hand.is_present, hand.lmc_hand_id, hand.valid_gestures) == (True, 7, False)
    assert_allclose([hand.palm_center.x, hand.palm_center.y, hand.palm_center.z], [0.01, 0.2, -0.03])
    assert_allclose(hand.palm_velocity, [0.001, 0.002, 0.003])
    assert_allclose(hand.sphere_center, [0, 0, 0])
    assert [finger.type for finger in hand.finger_list] == [0, 1, 2, 3, 4]
    bones = hand.finger_list[3].bone_list
    assert [bone.type for bone in bones] == [0, 1, 2, 3]
    assert_allclose([bone.length for bone in bones], [0.07, 0.04, 0.02, 0.02])
    assert_allclose(bones[2].center, [0.003, 0, -0.05])
    assert_allclose([bones[3].bone_end.position.z, bones[3].width], [-0.08, 0.018])
    assert bones[3].header.frame_id == "leap_hands"


def test_an_absent_hand_is_the_default_message():
    from leap_motion.msg import Hand

    assert convert(frame(PITCHED)).left_hand == Hand()


def test_direction_of_the_arm():
    direction = convert(frame(PITCHED)).right_hand.arm.direction
    assert_allclose([direction.x, direction.y, direction.z], [0, 0.14, 0.18])
    direction = convert(frame(PITCHED), "correct").right_hand.arm.direction
    assert_allclose([direction.x, direction.y, direction.z], [0, 0, -1])


def test_recorded_hands_can_be_sent(shared_data):
    with gzip.open(shared_data / "leap" / "three-claps.jsonl.gz", "rt") as lines:
        frames = [read_message(line) for line in lines]
    for got in frames[::20]:
        human = convert(got)
        buffer = io.BytesIO()
        human.serialize(buffer)
        back = type(human)().deserialize(buffer.getvalue())
        for hand, side in ((back.right_hand, "right"), (back.left_hand, "left")):
            tip = hand.finger_list[1].bone_list[3].bone_end.position
            assert_allclose([tip.x, tip.y, tip.z], got.hand(side).fingers[1].bones[3].end)
            assert_allclose(np.linalg.norm(quaternion(hand.finger_list[0].bone_list[1].bone_start)), 1.0)
