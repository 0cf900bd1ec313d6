"""Actions of a policy, and the bytes between it and the rig."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leap_rig.lerobot import actions, wire
from leap_rig.lerobot.actions import ACTION, ActionStream, action_fault, between
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
        (action(tool_qw=0.5), "the length 0.5"),
        (action(index_pos=5.0), "index.pos"),
        (action(more=1.0), "look at more"),
        ({}, "needs tool.x"),
        (action(x=0.7), "200 mm"),
        (action(tool_qw=0.0, tool_qx=1.0), "180 deg"),
    ],
)
def test_a_bad_action_is_refused_in_a_sentence_and_moves_nothing(wrong, said):
    stream = ActionStream()
    refused = stream.take(wrong, HOME, 0.0)
    assert said in refused and refused.endswith(".") and stream.step(0.1) is None
    assert stream.take(action(), HOME, 0.2) == "" and stream.step(0.3) == pytest.approx(HOME)
    stream.take(wrong, HOME, 0.3)
    assert stream.step(0.4) == pytest.approx(HOME), "it stays where the last good one led"
    assert action_fault(action()) == ""


def test_without_a_measured_tool_no_stream_begins():
    assert "where the tool is" in ActionStream().take(action(), None, 0.0)


def test_a_stream_begins_at_the_tool_and_pauses_without_actions():
    stream = ActionStream()
    assert stream.step(0.0) is None and stream.take(action(0.6), HOME, 1.0) == ""
    assert stream.step(1.0) == pytest.approx(HOME)
    assert stream.step(1.1)[0] == pytest.approx(0.5 + 0.1 * actions.SPEED_M_S)
    assert stream.step(1.5)[0] == pytest.approx(0.6), "it arrives and stays"
    assert stream.step(1.51) is None
    assert stream.take(action(0.5), HOME, 2.0) == "" and stream.step(2.0) == pytest.approx(HOME), "anew at the tool"


@given(st.lists(st.tuples(st.floats(-0.1, 0.1), st.floats(-0.5, 0.5), st.floats(0.0, 0.6)), max_size=30))
def test_the_desired_tool_never_moves_faster_than_its_limits(walk):
    stream, now, last = ActionStream(), 0.0, None
    for off, turn, pause in walk:
        stream.take(action(0.5 + off, tool_qz=math.sin(turn / 2), tool_qw=math.cos(turn / 2)), HOME, now)
        now += pause
        tool = stream.step(now)
        if tool is not None and last is not None:
            assert math.dist(tool[:3], last[1][:3]) <= actions.SPEED_M_S * (now - last[0]) + 1e-9
            assert actions.angle_between(tool, last[1]) <= actions.SPEED_RAD_S * (now - last[0]) + 1e-6
        last = (now, tool) if tool is not None else None


def test_between_two_poses_is_the_shorter_way():
    a, b = HOME, (0.7, 0.0, 0.4, 0.0, 0.0, -math.sin(0.2), -math.cos(0.2))
    np.testing.assert_allclose(between(a, b, 0.5), (0.6, 0, 0.4, 0, 0, math.sin(0.1), math.cos(0.1)), atol=1e-9)


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
