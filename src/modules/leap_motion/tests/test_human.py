"""Conversion of frames to leap_motion/Human."""

import gzip
import io
import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

from common.rotations import quaternion_from_rotation
from leap_motion.codec import read_message

pytest.importorskip("rig_msgs.srv")
import rospy
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import Header

from leap_motion.msg import Arm, Bone, Finger, Gesture, Hand, Human
from leap_motion.ros import tracking
from leap_motion.ros.human import FrameMessage
from leap_motion.ros.tracking import FramesHere, ReceivedHuman, ReceivedPalms, ReceivedSkeletons

pytestmark = pytest.mark.ros

PITCHED = [[1, 0, 0], [0, 0.8660, 0.5], [0, -0.5, 0.8660]]
PITCHED_AND_TURNED = [[0.9397, 0, 0.3420], [-0.1710, 0.8660, 0.4698], [-0.2962, -0.5, 0.8138]]


def frame(basis, side="right"):
    """A frame with one hand, whose fingers' bones and arm all have this basis on the wire."""
    return read_message(json.dumps(wire_frame(basis, side)))


def wire_frame(basis, side="right"):
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
    x = 20 if side == "right" else -20
    fingers = [
        {
            "id": 70 + kind,
            "handId": 7,
            "type": kind,
            "carpPosition": [x * kind, 0, 70],
            "mcpPosition": [x * kind, 0, 0],
            "pipPosition": [x * kind, 0, -40],
            "dipPosition": [x * kind, 0, -60],
            "btipPosition": [x * kind, 0, -80],
            "tipPosition": [x * kind, 0, -75],
            "bases": [basis] * 4,
            "length": 55,
            "width": 18,
        }
        for kind in range(5)
    ]
    return {"id": 2**40 + 5, "timestamp": 12, "currentFrameRate": 115.5, "hands": [hand], "pointables": fingers}


def convert(got, orientation="compatible"):
    return Human().deserialize(packed(got, orientation))


def packed(got, orientation="compatible", seq=0):
    """The bytes of the message as rospy sends them as its message `seq`."""
    rospy = pytest.importorskip("rospy")
    message, buffer = FrameMessage(got, rospy.Time(12, 34), orientation), io.BytesIO()
    rospy.msg.serialize_message(buffer, seq, message)
    return buffer.getvalue()[4:]


def plain(got, orientation="compatible", seq=0):
    """The same message filled field by field with genpy's classes."""
    compatible = orientation == "compatible"
    header = Header(seq, rospy.Time(12, 34), "leap_hands")

    def int32(number):
        return int(np.int64(number & 0xFFFFFFFF).astype(np.int32))

    def ends(bone):
        q = quaternion_from_rotation(bone.rotation.T if compatible else bone.rotation)
        return (Pose(Point(*end), Quaternion(*q)) for end in (bone.start, bone.end))

    def bone_message(bone, number, width):
        return Bone(header, number, bone.length, width, "", *ends(bone), bone.center)

    def finger_message(f):
        bones = [bone_message(bone, i, f.width) for i, bone in enumerate(f.bones)]
        return Finger(header, int32(f.id), f.type, f.length, f.width, "", bones)

    def arm_message(arm):
        if arm is None:
            return Arm(center=[0.0, 0.0, 0.0])
        direction = arm.center if compatible else -arm.rotation[:, 2]
        return Arm(Header(0, header.stamp, ""), *ends(arm), arm.center, Vector3(*direction))

    def hand_message(hand):
        if hand is None:
            return Hand()
        return Hand(
            header=header, lmc_hand_id=int32(hand.id), is_present=True, time_visible=hand.time_visible,
            confidence=hand.confidence, roll=hand.roll, pitch=hand.pitch, yaw=hand.yaw,
            direction=Vector3(*hand.direction), normal=Vector3(*hand.normal), grab_strength=hand.grab,
            pinch_strength=hand.pinch, palm_velocity=hand.velocity, palm_center=Point(*hand.palm),
            palm_width=hand.palm_width, sphere_radius=hand.sphere_radius, sphere_center=hand.sphere_center,
            finger_list=[finger_message(finger) for finger in hand.fingers], arm=arm_message(hand.arm),
        )  # fmt: skip

    return Human(
        header=header, lmc_frame_id=int32(got.id), nr_of_hands=len(got.hands), nr_of_fingers=got.finger_count,
        nr_of_gestures=got.gestures, current_frames_per_second=got.rate,
        to_string=f"frame {got.id}, device time {got.timestamp_us} us",
        right_hand=hand_message(got.hand("right")), left_hand=hand_message(got.hand("left")),
    )  # fmt: skip


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


def test_an_absent_hand_is_the_default_message():
    """Reported in https://github.com/ros-drivers/leap_motion/issues/11: a hand that left keeps its values. Tried: a
    frame without hands.
    """
    assert serialised(convert(frame(PITCHED)).left_hand) == serialised(Hand())


def serialised(message):
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def without_quaternions(human):
    """The bytes without the orientations, and these."""
    poses = [
        pose
        for hand in (human.right_hand, human.left_hand)
        for ends in (
            *((bone.bone_start, bone.bone_end) for finger in hand.finger_list for bone in finger.bone_list),
            (hand.arm.elbow, hand.arm.wrist),
        )
        for pose in ends
    ]
    orientations = [quaternion(pose) for pose in poses]
    for pose in poses:
        pose.orientation = type(pose.orientation)()
    return serialised(human), orientations


def vary(wire, rng):
    """Changes what a service may leave out or send otherwise."""
    for hand in wire["hands"]:
        if rng.random() < 0.3:
            hand["id"] += 2**33 + 2**31
        if "armBasis" in hand and rng.random() < 0.3:
            del hand["armBasis"]
        hand.update(grabStrength=rng.random(), timeVisible=1e6 * rng.random(), type=rng.choice(["left", "right"]))
    wire["id"] += int(rng.integers(2**40))
    keep = rng.random() < 0.5
    wire["pointables"] = [p for p in wire["pointables"] if keep or rng.random() < 0.8]


@pytest.mark.parametrize("orientation", ["compatible", "correct"])
def test_the_bytes_are_those_of_the_message_filled_field_by_field(shared_data, orientation):
    rng = np.random.default_rng(5)
    texts = [json.dumps(wire_frame(PITCHED_AND_TURNED)), '{"id":1,"timestamp":2,"hands":[],"pointables":[]}']
    for name in ("three-claps", "confidence-74fps"):
        with gzip.open(shared_data / "leap" / f"{name}.jsonl.gz", "rt") as lines:
            texts += list(lines)[::10]
    seen = set()
    for seq, text in enumerate(texts):
        wire = json.loads(text)
        if seq % 2:
            vary(wire, rng)
        got = read_message(json.dumps(wire))
        seen |= {(len(hand.fingers), hand.arm is None) for hand in got.hands} | {len(got.hands)}
        data = packed(got, orientation, seq)
        fast, orientations = without_quaternions(Human().deserialize(data))
        slow, expected = without_quaternions(plain(got, orientation, seq))
        assert serialised(Human().deserialize(data)) == data
        assert fast == slow
        assert_allclose(orientations, expected, atol=1e-12)
    assert {0, 1, 2, (5, True), (5, False), (3, True)} <= seen


def tracked(frame):
    """The numbers of a tracking frame."""
    return frame.id, frame.age, [
        (h.id, h.is_left, h.confidence, *(v.tolist() for v in (h.palm, h.direction, h.normal)),
         h.fingers and [vars(h.fingers)[name].tolist() for name in sorted(vars(h.fingers))])
        for h in frame.hands
    ]  # fmt: skip


def test_what_is_read_from_the_bytes_is_what_the_message_says(shared_data):
    """Also of messages that are laid out otherwise: fewer fingers or bones, texts, other frame ids, odd lists."""

    def drop_bone(hand):
        del hand.finger_list[1].bone_list[2]

    def swap_bones(hand):
        hand.finger_list[1].bone_list.reverse()

    changes = {
        "as it is": lambda hand: None,
        "a finger is missing": lambda hand: hand.finger_list.pop(),
        "fingers in another order": lambda hand: hand.finger_list.reverse(),
        "a bone is missing": drop_bone,
        "bones in another order": swap_bones,
        "text of the hand": lambda hand: setattr(hand, "to_string", "hand"),
        "text of a finger": lambda hand: setattr(hand.finger_list[2], "to_string", "fingers"),
        "text of a bone": lambda hand: setattr(hand.finger_list[2].bone_list[3], "to_string", "bone"),
        "frame id of a bone": lambda hand: setattr(hand.finger_list[0].bone_list[3].header, "frame_id", "x"),
        "frame id of the hand": lambda hand: setattr(hand.header, "frame_id", "leap_hand5"),
        "no velocity": lambda hand: setattr(hand, "palm_velocity", []),
        "long center": lambda hand: setattr(hand.finger_list[3].bone_list[0], "center", [1.0] * 4),
        "a gesture": lambda hand: hand.gesture_list.append(Gesture()),
        "frame id of the arm": lambda hand: setattr(hand.arm.header, "frame_id", "arm"),
        "not present": lambda hand: setattr(hand, "is_present", False),
    }
    with gzip.open(shared_data / "leap" / "three-claps.jsonl.gz", "rt") as lines:
        frames = [read_message(line) for line in list(lines)[::40]]
    now = rospy.Time(12, 90)
    for got in (*frames, frame(PITCHED), frame(PITCHED, "left")):
        for change in changes.values():
            for side in ("right", "left"):
                human = plain(got)
                if got.hand(side):
                    change(getattr(human, f"{side}_hand"))
                data = serialised(human)
                oracle, message, palms = ReceivedHuman(), ReceivedHuman(), ReceivedPalms()
                oracle._read_any(type(human)().deserialize(data))
                assert tracked(message.deserialize(data).frame(now)) == tracked(oracle.frame(now))
                skeletons, all_read = ReceivedSkeletons().deserialize(data), ReceivedSkeletons()
                all_read._read_any(type(human)().deserialize(data))
                for hand, expected in zip(skeletons.hands, all_read.hands):
                    np.testing.assert_array_equal(hand.joints, expected.joints)
                without = [(*hand[:-1], None) for hand in tracked(oracle.frame(now))[2]]
                for hand, expected in zip(palms.deserialize(data).hands, without):
                    assert (hand.id, hand.palm.tolist(), hand.confidence) == (expected[0], expected[3], expected[2])
    with pytest.raises(genpy_error()):
        ReceivedHuman().deserialize(b"torn")
    right = got.hand("right") or got.hand("left")
    joints = ReceivedSkeletons().deserialize(serialised(plain(got))).hands[0].joints
    np.testing.assert_array_equal(joints, [finger.joints for finger in right.fingers])


def genpy_error():
    import genpy

    return genpy.DeserializationError


def test_of_the_usual_message_nothing_else_is_read(shared_data, monkeypatch):
    monkeypatch.setattr(ReceivedHuman, "_read_any", None)
    for orientation in ("compatible", "correct"):
        assert len(ReceivedHuman().deserialize(packed(frame(PITCHED), orientation, 9)).hands) == 1


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("orientation", ["compatible", "correct"])
def test_nodes_in_the_driver_s_process_get_what_a_subscriber_reads(side, orientation, monkeypatch):
    rospy = pytest.importorskip("rospy")
    monkeypatch.setattr(rospy.rostime, "_rostime_initialized", True)
    frames, got = FramesHere(), []
    for _ in range(2):
        frames.subscribe(lambda frame, stamp: got.append((frame, stamp)), ReceivedHuman)
    message = FrameMessage(frame(PITCHED_AND_TURNED, side), rospy.Time.now(), orientation)
    frames.pass_on(message)
    read = ReceivedHuman().deserialize(serialised(message))
    assert len(got) == 2
    for frame_here, stamp in got:
        assert (frame_here.id, stamp) == (read.frame_id, read.stamp)
        assert 0.0 <= frame_here.age < 30.0
        for here, there in zip(frame_here.hands, read.hands):
            assert (here.id, here.is_left) == (there.id, there.is_left)
            assert_allclose(here.confidence, there.confidence)
            for name in ("palm", "direction", "normal"):
                assert_allclose(getattr(here, name), getattr(there, name))
            for name, point in vars(there.fingers).items():
                assert_allclose(vars(here.fingers)[name], point, atol=1e-7)


def test_a_taker_of_frames_that_fails_starves_no_other(monkeypatch):
    rospy = pytest.importorskip("rospy")
    order, errors, now = [], [], [100.0]
    monkeypatch.setattr(rospy.rostime, "_rostime_initialized", True)
    monkeypatch.setattr(rospy, "logerr", lambda text, *words: errors.append(text % words))
    monkeypatch.setattr(tracking.clock, "monotonic", lambda: now[0])

    def taker(name, fails):
        def take(*_):
            order.append(name)
            if fails:
                raise ValueError(f"the {name} is broken")

        return take

    frames = tracking.FramesHere()
    frames.subscribe(taker("hand", True), tracking.ReceivedHuman)
    frames.subscribe(taker("camera", True), tracking.ReceivedHuman)
    frames.subscribe(taker("arm", False), tracking.ReceivedPalms, first=True)
    message = FrameMessage(frame(PITCHED_AND_TURNED, "right"), rospy.Time.now(), "correct")
    for _ in range(30):
        now[0] += 0.1
        frames.pass_on(message)
    assert order == ["arm", "hand", "camera"] * 30
    for name in ("hand", "camera"):
        assert sum(error.endswith(f"ValueError: the {name} is broken") for error in errors) == 3
