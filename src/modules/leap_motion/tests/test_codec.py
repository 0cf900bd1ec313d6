"""Codec: text of the Leap service to records, by hand-made frames and by what must be refused."""

import copy
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from leap_motion.codec import DeviceEvent, LeapProtocolError, is_simulated, read_header, read_message
from leap_motion.frames import DISTAL, INDEX, METACARPAL

COS, SIN = 0.939692620786, 0.342020143326


def index_finger(hand=7, kind=1, **fields):
    """A straight finger of a flat hand pitched up by 20 degrees, as service 2 writes it."""
    pitched = [[1, 0, 0], [0, COS, SIN], [0, -SIN, COS]]
    return {
        "bases": [pitched] * 4,
        "carpPosition": [48, 176, 64],
        "mcpPosition": [48, 200, 0],
        "pipPosition": [48, 213.680806, -37.587705],
        "dipPosition": [48, 220.521209, -56.381557],
        "btipPosition": [48, 225.651511, -70.476947],
        "tipPosition": [48, 224.471541, -67.235007],
        "direction": [0, SIN, -COS],
        "extended": True,
        "handId": hand,
        "id": 10 * hand + kind,
        "length": 54.451,
        "timeVisible": 1.5,
        "tool": False,
        "type": kind,
        "width": 17.91,
        **fields,
    }


def right_hand(**fields):
    return {
        "armBasis": [[1, 0, 0], [0, COS, SIN], [0, -SIN, COS]],
        "armWidth": 59,
        "confidence": 0.75,
        "direction": [0, SIN, -COS],
        "elbow": [67, 81, 303],
        "grabStrength": 0.25,
        "id": 7,
        "palmNormal": [0, -COS, -SIN],
        "palmPosition": [60, 180, 20],
        "palmVelocity": [100, -20, 3],
        "palmWidth": 84.25,
        "pinchStrength": 0.5,
        "sphereCenter": [60, 123, -0.5],
        "sphereRadius": 60,
        "timeVisible": 1.5,
        "type": "right",
        "wrist": [67, 166, 68],
        **fields,
    }


def frame(hands=None, pointables=None, **fields):
    return {
        "currentFrameRate": 115.3,
        "gestures": [],
        "hands": [right_hand()] if hands is None else hands,
        "id": 4211,
        "interactionBox": {"center": [0, 200, 0], "size": [235.247, 235.247, 147.751]},
        "pointables": [index_finger()] if pointables is None else pointables,
        "r": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "s": 1,
        "t": [0, 0, 0],
        "timestamp": 1500000,
        **fields,
    }


def read(message):
    return read_message(json.dumps(message))


def test_a_frame_of_service_2_arrives_in_metres_and_radians():
    got = read(frame())
    assert (got.id, got.timestamp_us, got.rate, got.finger_count) == (4211, 1500000, 115.3, 1)
    hand = got.hands[0]
    assert (hand.id, hand.side, hand.confidence, hand.grab, hand.pinch) == (7, "right", 0.75, 0.25, 0.5)
    assert_allclose(hand.palm, [0.06, 0.18, 0.02])
    assert_allclose(hand.velocity, [0.1, -0.02, 0.003])
    assert_allclose(hand.sphere_center, [0.06, 0.123, -0.0005])
    assert_allclose([hand.palm_width, hand.sphere_radius], [0.08425, 0.06])
    assert_allclose([hand.pitch, hand.yaw, hand.roll], np.radians([20, 0, 0]), atol=1e-9)
    assert_allclose(hand.arm.start, [0.067, 0.081, 0.303])
    assert_allclose(hand.arm.end, [0.067, 0.166, 0.068])
    finger = hand.fingers[0]
    assert (finger.id, finger.type, finger.extended) == (71, INDEX, True)
    assert_allclose(finger.tip, [0.048, 0.224471541, -0.067235007])
    assert_allclose([bone.length for bone in finger.bones[1:]], [0.04, 0.02, 0.015], atol=1e-8)
    assert_allclose(finger.bones[METACARPAL].start, [0.048, 0.176, 0.064])
    for bone in finger.bones[1:]:
        assert_allclose(bone.rotation[:, 2], (bone.start - bone.end) / bone.length, atol=1e-6)


@pytest.mark.parametrize(
    ("direction", "normal", "angles"),
    [
        ([0, 0, -1], [0, -1, 0], [0, 0, 0]),
        ([0.5, 0, -0.866025], [0, -1, 0], [0, 30, 0]),
        ([0, 0, -1], [1, 0, 0], [0, 0, 90]),
        ([0, 0, -1], [-0.5, -0.866025, 0], [0, 0, -30]),
    ],
)
def test_signs_of_pitch_yaw_and_roll(direction, normal, angles):
    hand = read(frame([right_hand(direction=direction, palmNormal=normal)])).hands[0]
    assert_allclose(np.degrees([hand.pitch, hand.yaw, hand.roll]), angles, atol=1e-4)


def test_left_hands_are_mirrored_on_the_wire_and_turned_into_rotations():
    mirrored = [[-1, 0, 0], [0, COS, SIN], [0, -SIN, COS]]
    left = read(frame([right_hand(type="left", armBasis=mirrored)], [index_finger(bases=[mirrored] * 4)])).hands[0]
    right = read(frame()).hands[0]
    assert left.side == "left"
    assert_allclose(left.fingers[0].bones[1].rotation, right.fingers[0].bones[1].rotation)
    assert_allclose(left.arm.rotation, right.arm.rotation)


def test_fields_that_newer_services_leave_out():
    hand, finger = right_hand(), index_finger()
    for key in ("sphereCenter", "sphereRadius"):
        del hand[key]
    del finger["tool"]
    message = frame([hand], [finger], devices=[], grabAngle=0.1)
    for key in ("interactionBox", "gestures", "r", "s", "t"):
        del message[key]
    got = read(message).hands[0]
    assert_allclose(got.sphere_center, np.zeros(3))
    assert got.sphere_radius == 0.0
    assert len(got.fingers) == 1


def test_older_frames_get_their_bones_from_the_joints():
    finger = index_finger()
    for key in ("bases", "carpPosition", "btipPosition"):
        del finger[key]
    hand = right_hand()
    del hand["armBasis"]
    old, new = read(frame([hand], [finger])).hands[0], read(frame()).hands[0]
    assert old.arm is None
    bones = old.fingers[0].bones
    assert bones[METACARPAL].length == 0.0
    assert_allclose(bones[METACARPAL].rotation, new.fingers[0].bones[1].rotation, atol=1e-6)
    assert_allclose(bones[DISTAL].end, old.fingers[0].tip)
    for a, b in zip(bones[1:], new.fingers[0].bones[1:]):
        assert_allclose(a.rotation, b.rotation, atol=1e-6)


def test_a_bone_without_length_needs_no_axes():
    """Nothing is known of what a service writes for the thumb's metacarpal; its axes must not cost the frame."""
    thumb = index_finger(kind=0, carpPosition=[48, 200, 0])
    thumb["bases"] = [[[0, 0, 0]] * 3, *thumb["bases"][1:]]
    rotation = read(frame(pointables=[thumb])).hands[0].fingers[0].bones[METACARPAL].rotation
    assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["right", "left"])
@pytest.mark.parametrize(("width", "reason"), [(0.06, "m"), (60.0, None), (25.0, "small"), (140.0, "wide")])
def test_the_knuckles_must_be_those_of_a_person_in_millimetres_and_in_the_order_of_the_side(side, width, reason):
    kind = "right" if side > 0.0 else "left"

    def hand(order):
        fingers = [index_finger(kind=k, mcpPosition=[48 + order * x, 200, 0]) for k, x in ((1, 0.0), (4, width))]
        return read(frame([right_hand(type=kind)], fingers))

    assert len(hand(side).hands) == (reason is None)
    mirrored = hand(-side)
    assert not mirrored.hands and ("mirrored" if reason is None else "not millimetres") in mirrored.left_out[0]


def test_fingers_are_sorted_by_type_and_attached_by_hand():
    others = [index_finger(hand=8, kind=k, mcpPosition=[48 - 20 * k, 200, 0]) for k in (4, 0, 3, 2, 1)]
    own = [index_finger(kind=k, mcpPosition=[48 + 20 * k, 200, 0]) for k in (1, 2, 4, 3, 0)]
    got = read(frame([right_hand(), right_hand(id=8, type="left")], [*others[:2], *own, *others[2:]]))
    assert [f.id for f in got.hands[0].fingers] == [70, 71, 72, 73, 74]
    assert [f.id for f in got.hands[1].fingers] == [80, 81, 82, 83, 84]
    assert got.finger_count == 10


def test_tools_and_pointables_without_joints_or_hand_are_left_out():
    tool = index_finger(kind=2, tool=True)
    bare = {"id": 9, "handId": 7, "type": 3, "tipPosition": [0, 0, 0]}
    stray = index_finger(hand=99, kind=4)
    assert [f.type for f in read(frame(pointables=[tool, bare, stray, index_finger()])).hands[0].fingers] == [INDEX]


def test_a_finger_without_a_number_gets_the_one_that_its_service_would_give_it():
    finger = index_finger()
    del finger["id"]
    got = read(frame(pointables=[finger]))
    assert (got.hands[0].fingers[0].id, got.left_out) == (71, ())


@pytest.mark.parametrize(
    "broken", [7, None, [], index_finger(handId=[7]), index_finger(handId="7"), {"dipPosition": 1}]
)
def test_a_pointable_that_is_no_finger_costs_neither_the_hand_nor_the_frame(broken):
    got = read(frame(pointables=[broken, index_finger()]))
    assert [finger.id for finger in got.hands[0].fingers] == [71] and len(got.left_out) == 1


def test_of_two_hands_of_one_side_the_older_one_counts():
    got = read(frame([right_hand(id=12), right_hand(id=9), right_hand(id=15, type="left")], []))
    assert (got.hand("right").id, got.hand("left").id, len(got.hands)) == (9, 15, 3)
    assert read(frame([], [])).hand("right") is None


HAND_FAULTS = {
    "palmPosition is missing": {"palmPosition": ...},
    "id is missing": {"id": ...},
    "confidence is missing": {"confidence": ...},
    "palmPosition does not hold 3": {"palmPosition": [1, 2]},
    "palmNormal does not hold": {"palmNormal": ["0", "-1", "0"]},
    "direction does not hold": {"direction": None},
    "direction has the length 2": {"direction": [0, 0, -2]},
    "palmNormal has the length 0": {"palmNormal": [0, 0, 0]},
    "not orthogonal": {"palmNormal": [0, 0, -1]},
    "type 'both'": {"type": "both"},
    "confidence of a hand is 1.5": {"confidence": 1.5},
    "id is 'True'": {"id": True},
    "grabStrength is 'x'": {"grabStrength": "x"},
    "palmPosition does": {"palmPosition": [1e300, 0, 0]},
    "palmVelocity does not hold": {"palmVelocity": [True, True, True]},
    "axes of an arm": {"armBasis": [[1, 0, 0], [1, 0, 0], [0, 0, 1]]},
    "elbow is missing": {"elbow": ...},
}
FINGER_FAULTS = {
    "mcpPosition is missing": {"mcpPosition": ...},
    "tipPosition is missing": {"tipPosition": ...},
    "joints of a finger": {"pipPosition": [1, 2, "x"]},
    "types [5]": {"type": 5},
    "axes of a bone": {"bases": [[[1, 0, 0], [0, 1, 0], [0, 0, 0.5]]] * 4},
    "bases does not hold": {"bases": [[[1, 0, 0], [0, 1, 0]]] * 4},
}


def changed(record, changes):
    return {key: value for key, value in {**record, **changes}.items() if value is not ...}


@pytest.mark.parametrize("reason", HAND_FAULTS)
def test_bad_hands_are_left_out_with_a_reason_and_the_others_stay(reason):
    bad, good = changed(right_hand(), HAND_FAULTS[reason]), right_hand(id=8, type="left")
    for hands in ([bad, good], [good, bad], [bad]):
        got = read(frame(hands, [index_finger(), index_finger(hand=8)]))
        assert [(hand.id, hand.side) for hand in got.hands] == [(8, "left")] * (len(hands) - 1)
        assert all(len(hand.fingers) == 1 for hand in got.hands)
        assert len(got.left_out) == 1 and reason in got.left_out[0]


def test_a_hand_that_is_no_record_is_left_out():
    assert read(frame([right_hand(), 7, None, []])).left_out != () != read(frame([right_hand(), 7])).hands


@pytest.mark.parametrize("reason", FINGER_FAULTS)
def test_hands_with_bad_fingers_are_left_out_with_a_reason(reason):
    got = read(frame(pointables=[changed(index_finger(), FINGER_FAULTS[reason])]))
    assert got.hands == () and len(got.left_out) == 1 and reason in got.left_out[0]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('{"id":1,"hands":[', "not JSON"),
        ("", "not JSON"),
        ("[1]", "not a JSON object"),
        ("[" * 100000, "not JSON"),
        ('{"id":NaN}', "number NaN"),
        ('{"id":-Infinity}', "number -Infinity"),
        ('{"id":1,"timestamp":2}', "pointables is missing"),
        ('{"id":1.5,"timestamp":2,"hands":[],"pointables":[]}', "id is '1.5'"),
        ('{"event":{"type":"deviceEvent"}}', "unexpected form"),
        ('{"event":7}', "unexpected form"),
        (b"\xff\xfe", "not JSON"),
        ('{"id": 7,"timestamp": 8,"hands": undefined,"pointables": }', "more than two hands"),
    ],
)
def test_bad_texts_are_refused_with_a_reason(text, reason):
    with pytest.raises(LeapProtocolError, match=reason):
        read_message(text)


def test_the_same_hand_or_finger_twice_is_refused():
    with pytest.raises(LeapProtocolError, match="same id"):
        read(frame([right_hand(), right_hand(type="left")], []))
    assert "types" in read(frame(pointables=[index_finger(), index_finger()])).left_out[0]


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


def places(record, path=()):
    items = record.items() if isinstance(record, dict) else enumerate(record) if isinstance(record, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from places(value, (*path, key))


@given(st.sampled_from(list(places(frame()))), json_values)
def test_whatever_stands_in_a_frame_it_is_read_or_refused(path, value):
    message = copy.deepcopy(frame())
    target = message
    for key in path[:-1]:
        target = target[key]
    target[path[-1]] = value
    try:
        got = read_message(json.dumps(message))
    except LeapProtocolError:
        return
    for hand in got.hands:
        assert np.isfinite([*hand.palm, *hand.normal, *hand.velocity, hand.confidence, hand.time_visible]).all()


def test_events():
    state = {"attached": True, "id": "LP12345678901", "streaming": False, "type": "Peripheral"}
    event = read({"event": {"state": state, "type": "deviceEvent"}})
    assert event == DeviceEvent("LP12345678901", attached=True, streaming=False)
    assert read({"event": {"state": False, "type": "deviceConnect"}}) == DeviceEvent("", False, False)
    assert read({"event": {"type": "somethingNew"}}) is None


def test_a_service_says_that_it_is_simulated_or_it_is_not():
    for says, simulated in (("true", True), ("false", False), ('"true"', False), ("1", False)):
        assert is_simulated(f'{{"version":6,"simulated":{says}}}') is simulated
    assert is_simulated('{"version":6,"serviceVersion":"2.3.1+33747"}') is False


def test_headers():
    """Reported in https://github.com/leapmotion/leapjs/pull/168: services without their version. Tried:
    `"serviceVersion": null`.
    """
    assert read_header('{"version":6,"serviceVersion":"2.3.1+33747"}') == "2.3.1+33747"
    assert read_header('{"version":1}') == read_header('{"version":5,"serviceVersion":null}') == ""
    with pytest.raises(LeapProtocolError, match="protocol version '7'"):
        read_header('{"version":7}')
    for text in ('{"version":"6"}', '{"version":true}', '{"version":0}', '{"id":1}', "HTTP/1.1", "[6]"):
        with pytest.raises(LeapProtocolError):
            read_header(text)
