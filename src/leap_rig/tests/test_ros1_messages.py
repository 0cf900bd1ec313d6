"""Decoding by the stored definition: as genpy does, without making code; damaged bytes end in a sentence."""

import contextlib
import io
import math
import random
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leap_rig.recording.ros1 import NUMBERS, MessageFault, decoder

TYPES = (
    "tf2_msgs/TFMessage", "diagnostic_msgs/DiagnosticArray", "rig_msgs/SentGoals", "leap_motion/RawFrame",
    "leap_motion/Human", "reflex_msgs/Hand", "kuka_msgs/MoveActionGoal", "rig_msgs/KukaStatus", "rosgraph_msgs/Log",
    "visualization_msgs/MarkerArray", "sensor_msgs/Image", "sensor_msgs/CameraInfo", "rig_msgs/GuardState",
)  # fmt: skip
STRINGS = ("", "a", "é\x00", "frame/name")


def filled(message, rng):
    """Fills a message of genpy with random values."""
    for slot, kind in zip(message.__slots__, message._slot_types):
        base, _, count = kind.partition("[")
        if count == "":
            value = one(base, rng)
        else:
            n = int(count[:-1]) if count != "]" else rng.randint(0, 3)
            value = [one(base, rng) for _ in range(n)]
            if base in ("uint8", "char"):
                value = bytes(rng.randint(0, 255) for _ in range(n))
        setattr(message, slot, value)
    return message


def one(base, rng):
    import genpy
    import roslib.message

    if base == "string":
        return rng.choice(STRINGS)
    if base == "time":
        return genpy.Time(rng.randint(0, 2**31), rng.randint(0, 10**9 - 1))
    if base == "duration":
        return genpy.Duration(rng.randint(-5, 5), rng.randint(0, 10**9 - 1))
    if base == "bool":
        return rng.random() < 0.5
    if base.startswith("float"):
        return struct.unpack("<f", struct.pack("<f", rng.uniform(-1e3, 1e3)))[0]
    if base in NUMBERS:
        return rng.randint(0, 100)
    return filled(roslib.message.get_message_class("std_msgs/Header" if base == "Header" else base)(), rng)


def same(expected, found):
    import genpy

    if isinstance(expected, (genpy.Time, genpy.Duration)):
        return expected.to_nsec() == found
    if hasattr(expected, "__slots__"):
        return set(expected.__slots__) == set(found) and all(same(getattr(expected, k), v) for k, v in found.items())
    if isinstance(expected, (list, tuple)):
        return len(expected) == len(found) and all(map(same, expected, found))
    return expected == found and not (isinstance(expected, float) and math.isnan(expected))


@pytest.mark.ros
@pytest.mark.parametrize("name", TYPES)
def test_it_decodes_as_genpy(name):
    import roslib.message

    kind = roslib.message.get_message_class(name)
    decode, rng = decoder(name, kind._full_text), random.Random(name)
    for _ in range(5):
        message = filled(kind(), rng)
        buffer = io.BytesIO()
        message.serialize(buffer)
        assert same(message, decode(buffer.getvalue()))


DEFINITION = """Header header
string[] names   # some
int32 LIMIT = 3
float64[2] pair
pkg/Inner[] inner
time[] stamps
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: pkg/Inner
uint8[] data
duration d
"""


@given(st.binary(max_size=200))
def test_any_bytes_are_decoded_or_refused(data):
    with contextlib.suppress(MessageFault):
        decoder("pkg/Outer", DEFINITION)(data)


@given(st.integers(0, 30))
def test_a_message_is_read_to_its_end(cut):
    data = struct.pack("<III", 1, 2, 3) + struct.pack("<I", 1) + b"f" + struct.pack("<I", 0) + struct.pack("<dd", 1, 2)
    data += struct.pack("<IIBii", 1, 1, 7, -1, 5) + struct.pack("<III", 1, 4, 6)
    decode = decoder("pkg/Outer", DEFINITION)
    value = decode(data)
    assert value["header"] == {"seq": 1, "stamp": 2 * 10**9 + 3, "frame_id": "f"} and value["names"] == []
    assert value["inner"] == [{"data": b"\x07", "d": -(10**9) + 5}] and value["stamps"].tolist() == [4 * 10**9 + 6]
    np.testing.assert_array_equal(value["pair"], [1.0, 2.0])
    with pytest.raises(MessageFault):
        decode(data + b"x" if cut == 0 else data[:-cut])


@pytest.mark.parametrize(
    "definition", ["a/B b", "pkg/Outer o", "Other o\n===\nMSG: pkg/Other\npkg/Outer o", "Unknown[] x"]
)
def test_a_definition_that_is_missing_or_contains_itself_is_refused(definition):
    with pytest.raises(MessageFault):
        decoder("pkg/Outer", definition)


def test_an_array_of_nothing_does_not_fill_the_memory():
    with pytest.raises(MessageFault):
        decoder("pkg/Outer", "Empty[] e\n===\nMSG: pkg/Empty\n")(b"\xff" * 4)
