"""Actions of a policy, and the bytes between it and the rig."""

import math

import pytest

from leap_rig.lerobot import wire
from leap_rig.lerobot.actions import ACTION, action_fault
from leap_rig.lerobot.wire import LerobotWireFault, packed, unpacked

HOME = (0.5, 0.0, 0.4, 0.0, 0.0, 0.0, 1.0)


def action(x=0.5, **values):
    given = dict(zip(ACTION, (x, *HOME[1:], 0.1, 0.1, 0.1, 0.0)))
    return {**given, **{name.replace("_", "."): value for name, value in values.items()}}


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (action(tool_x=math.nan), "tool.x: nan"),
        (action(tool_x="1"), "not a finite number"),
        (action(tool_x=True), "not a finite number"),
        (action(tool_z=3.0), "from the base"),
        (action(tool_qw=0.69), "the length 0.69, not about 1"),
        (action(tool_qw=1.31), "the length 1.31, not about 1"),
        (action(index_pos=5.0), "index.pos"),
        (action(more=1.0), "look at more"),
        ({}, "needs tool.x"),
    ],
)
def test_a_bad_action_is_refused_in_a_sentence(wrong, said):
    assert said in action_fault(wrong) and action_fault(wrong).endswith(".")
    assert action_fault(action()) == action_fault(action(tool_qw=0.71)) == action_fault(action(tool_qw=1.29)) == ""


def reader(data):
    """Returns a `read` for bytes that are there."""
    at = 0

    def read(count):
        nonlocal at
        at += count
        return data[at - count : at]

    return read


GOLDEN = b'LEAP\x00\x01\x00\x00\x00\x26\x00\x00\x00\x03{"do": "observe", "images": {"color": 3}}'


def test_a_message_has_these_bytes():
    golden = GOLDEN.replace(b"\x26", bytes([len(GOLDEN) - 14])) + b"abc"
    assert packed({"do": "observe"}, {"color": b"abc"}) == golden
    assert unpacked(reader(golden)) == ({"do": "observe"}, {"color": b"abc"})


def message(text, images=b"", magic=b"LEAP", version=1):
    return wire.HEAD.pack(magic, version, len(text), len(images)) + text + images


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (message(b'{"images": {}}', magic=b"HTTP"), "begins with b'HTTP'"),
        (message(b'{"images": {}}', version=2), "version 2"),
        (wire.HEAD.pack(b"LEAP", 1, 2**31, 0), "claims 2147483648"),
        (message(b"{}"), "cannot be read"),
        (message(b"[]"), "cannot be read"),
        (message(b"\xff"), "cannot be read"),
        (message(b'{"a": NaN, "images": {}}'), "not finite"),
        (message(b'{"images": {"a": 4}}', b"abc"), "images of 4 bytes, but holds 3"),
        (message(b'{"images": {"a": -1, "b": 4}}', b"abc"), "but holds 3"),
        (message(b"[" * 60000), "cannot be read"),
    ],
)
def test_other_bytes_are_refused_in_a_sentence(data, said):
    with pytest.raises(LerobotWireFault, match=said) as caught:
        unpacked(reader(data))
    assert str(caught.value).endswith(".")


def test_numbers_that_are_not_finite_are_not_sent():
    with pytest.raises(LerobotWireFault, match="not finite"):
        packed({"a": math.inf}, {})
