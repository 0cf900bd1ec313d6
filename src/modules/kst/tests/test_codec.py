"""The wire text against lines recorded from the published server, and laws of its numbers, poses and framing."""

import math
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.poses import pose, translation
from kst import codec
from kst.codec import Feedback, KstLineSplitter, ReplyKind, ServerThread, ToolTransform, parse_reply, rotation_from_zyx

doubles = st.floats(allow_nan=False, allow_infinity=False)
angles = st.floats(-math.pi, math.pi)


@pytest.mark.parametrize(
    ("command", "line", "thread", "answer"),
    [
        (codec.relative_velocity(0.25), "jRelVel_0.25_", "main", "done"),
        (codec.START_PTP, "doPTPinJS", "main", "done"),
        (codec.GUARDED_PTP, "doPTP!inJS", "main", "done"),
        (codec.START_SERVO, "startDirectServoJoints", "main", "done"),
        (codec.STOP_SERVO, "stopDirectServoJoints", "reader", "done"),
        (codec.JOINTS, "getJointsPositions", "reader", "7 numbers"),
        (codec.EXTERNAL_TORQUES, "Torques_ext_J", "main", "7 numbers"),
        (codec.MEASURED_TORQUES, "Torques_m_J", "main", "7 numbers"),
        (codec.POSE, "Eef_pos", "main", "6 numbers"),
        (codec.FORCE, "Eef_force", "main", "3 numbers"),
        (codec.MOMENT, "Eef_moment", "main", "3 numbers"),
        (codec.blue(True), "blueOn", "reader", "done"),
        (codec.blue(False), "blueOff", "reader", "done"),
        (codec.set_pin(1, True), "pin1on", "reader", "done"),
        (codec.set_pin(11, False), "pin11off", "reader", "done"),
        (codec.get_pin(3), "getPin3", "reader", "0 or 1"),
        (codec.END, "end", "reader", "no answer"),
    ],
)
def test_commands_are_spelled_as_the_server_reads_them(command, line, thread, answer):
    """Reported in https://github.com/Modi1987/iiwaPy3/issues/8: a misspelt command gets no answer. Tried: all
    commands.
    """
    assert command == codec.KstCommand(line, ServerThread(thread), ReplyKind(answer))


def test_the_ranges_of_a_guarded_motion_are_triples_of_index_lowest_highest():
    """As the published client writes them: `doPTP!inJS_0_-5_5_...`, the joints counted from 0; text ends with `_`."""
    ranges = np.array([[-5, 5], [-18.8, 10], [-1e-7, 12.25], [-10, 10], [-10, 10], [-3, 4], [-10, 10]])
    command = codec.start_guarded_ptp(ranges)
    expected = "doPTP!inJS_0_-5.0_5.0_1_-18.8_10.0_2_-1e-07_12.25_3_-10.0_10.0_4_-10.0_10.0_5_-3.0_4.0_6_-10.0_10.0_"
    assert command == codec.KstCommand(expected, ServerThread.MAIN, ReplyKind.DONE)
    assert command.word == "doPTP!inJS" and command.starts_motion and codec.START_PTP.starts_motion
    assert parse_reply(b"interrupted") == codec.KstReply("interrupted", ReplyKind.INTERRUPTED)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -20.0])
def test_ranges_that_are_none_never_leave(bad):
    ranges = np.tile((-10.0, 10.0), (7, 1))
    ranges[3, 1] = bad
    for wrong in (ranges, ranges[:3], ranges.ravel()):
        with pytest.raises(ValueError):
            codec.start_guarded_ptp(wrong)


def test_the_tool_is_six_numbers_in_millimetres_and_rad():
    tool = ToolTransform(pose(rotation_from_zyx(0.5, -0.25, 2.0), (0.001, -0.002, 0.106)))
    word, *fields, end = codec.attach_tool(tool).line.split("_")
    assert (word, end) == ("TFtrans", "")
    np.testing.assert_allclose([float(f) for f in fields], [1.0, -2.0, 106.0, 0.5, -0.25, 2.0], atol=1e-12)


@pytest.mark.parametrize(
    ("feedback", "prefix", "answer"),
    [
        (Feedback.DONE, "jp_", ReplyKind.DONE),
        (Feedback.NOTHING, "jf_", ReplyKind.NOTHING),
        (Feedback.JOINTS, "jpJP_", ReplyKind.SEVEN),
        (Feedback.EXTERNAL_TORQUES, "jpExT_", ReplyKind.SEVEN),
        (Feedback.MEASURED_TORQUES, "jpMT_", ReplyKind.SEVEN),
        (Feedback.POSE, "jpEEfP_", ReplyKind.SIX),
        (Feedback.FORCE, "jpEEfFrelEEF_", ReplyKind.THREE),
    ],
)
def test_joint_goals(feedback, prefix, answer):
    goal = codec.joint_goal(np.array([-0.7834, 0.5236, 0.0, -1.39626, 1e-7, 1.22173, -0.0]), feedback)
    assert goal.line == prefix + "-0.7834_0.5236_0.0_-1.39626_1e-07_1.22173_-0.0_"
    assert (goal.thread, goal.answer) == (ServerThread.READER, answer)


@pytest.mark.parametrize(
    ("line", "kind", "numbers"),
    [
        (b"ok_lrBeat_", ReplyKind.OK, ()),
        (b"no_jp_held: paused_", ReplyKind.NO, ()),
        (b"stopped_the client_", ReplyKind.STOPPED, ()),
        (b"event_the motion is paused_", ReplyKind.EVENT, ()),
        (b"busy_10.0.0.2:40112_", ReplyKind.BUSY, ()),
        (b"state_IDLE_" + 28 * b"0.5_" + b"T1_HAND_NOSTOP_", ReplyKind.STATE, 28 * (0.5,)),
        (b"done", ReplyKind.DONE, ()),
        (b"nak", ReplyKind.NAK, ()),
        (b"1", ReplyKind.PIN, (1.0,)),
        (b"0", ReplyKind.PIN, (0.0,)),
        (b"0.0_-0.0_1.0E7_", ReplyKind.THREE, (0.0, -0.0, 1e7)),
        (b"Infinity_-Infinity_5.0E-5_", ReplyKind.THREE, (math.inf, -math.inf, 5e-5)),
    ],
)
def test_replies(line, kind, numbers):
    reply = parse_reply(line)
    assert reply.kind is kind
    assert reply.numbers == numbers


@pytest.mark.parametrize(
    "line",
    [
        *(b"Done", b"done ", b"interrupted ", b"2", b"0.5", b"1_2_", b"0.1__0.2_0.3_", b"1_2_3_4_5_6_7_8_"),
        *(b"0,1_0,2_0,3_0,4_0,5_0,6_0,7_", b"0.1 0.2 0.3 0.4 0.5 0.6 0.7", b"donedone", b"done\x00"),
        *(b"a_b_c_", b"nan_0_0_", b"0x1_0_0_", b"\xff\x00\x81", b"1_2_" + b"3" * 1100),
        *(
            b"ok",
            b"ok_lrBeat",
            b"state_IDLE_" + 27 * b"0.5_" + b"T1_HAND_NOSTOP_",
            b"state_IDLE_" + 28 * b"x_" + b"a_b_c_",
        ),
    ],
)
def test_what_is_no_reply_is_foreign_and_printable(line):
    reply = parse_reply(line)
    assert reply.kind is ReplyKind.FOREIGN
    assert reply.text.isprintable() and len(reply.text) <= 60


@given(st.binary(max_size=600))
def test_no_bytes_break_the_parser(line):
    assert isinstance(parse_reply(line).kind, ReplyKind)


@given(doubles)
def test_numbers_keep_every_bit_and_suit_javas_parser(value):
    text = codec.number(value)
    assert struct.pack("d", float(text)) == struct.pack("d", value)
    assert set(text) <= set("0123456789.e+-")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_numbers_that_would_deafen_the_server_are_refused(value):
    with pytest.raises(ValueError):
        codec.number(value)


@given(angles, st.one_of(st.floats(-math.pi / 2, math.pi / 2), st.sampled_from([-math.pi / 2, math.pi / 2])), angles)
def test_poses_survive_the_wire_units_even_at_the_euler_singularity(a, b, c):
    T = pose(rotation_from_zyx(a, b, c), (0.4, -0.3, 0.25))
    np.testing.assert_allclose(codec.pose_from_fields(codec.fields_from_pose(T)), T, rtol=0.0, atol=1e-9)


def test_a_recorded_pose_is_where_the_arm_was():
    reply = parse_reply(
        b"407.206829637132_-407.2083253940839_282.60267766133745_2.356192653589793_2.6535897931254714E-6"
        b"_-3.141592653589793_"
    )
    T = codec.pose_from_fields(reply.numbers)
    np.testing.assert_allclose(T[:3, 3], [0.4072068, -0.4072083, 0.2826027], atol=1e-7)
    np.testing.assert_allclose(T[:3, 2], [0.0, 0.0, -1.0], atol=1e-5)


@pytest.mark.parametrize("tool", [translation(0.0, 0.0, 106.0), np.eye(4) * np.nan, np.diag([2.0, 2.0, 2.0, 1.0])])
def test_a_tool_in_millimetres_or_not_rigid_is_refused(tool):
    with pytest.raises(ValueError):
        ToolTransform(tool)


@pytest.mark.parametrize("number", [0, 5, 17])
def test_pins_that_the_server_does_not_know_are_refused(number):
    with pytest.raises(ValueError):
        codec.set_pin(number, True)
    with pytest.raises(ValueError):
        codec.get_pin(number)


@given(st.lists(st.binary(max_size=30), max_size=8), st.data())
def test_lines_do_not_depend_on_how_the_stream_is_cut(lines, data):
    stream = b"\n".join(lines) + b"\n" + b"x" * 1100 + b"\r\nno end"
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    splitter = KstLineSplitter()
    pieces = [stream[i:j] for i, j in zip([0, *cuts], [*cuts, len(stream)])]
    assert [line for piece in pieces for line in splitter.feed(piece)] == KstLineSplitter().feed(stream)


def test_a_line_without_end_takes_no_memory_and_no_neighbour():
    splitter = KstLineSplitter()
    assert all(splitter.feed(b"1" * 1000) == [] for _ in range(1000))
    assert len(splitter._rest) < 2000
    overlong, good = splitter.feed(b"\ndone\n")
    assert parse_reply(overlong).kind is ReplyKind.FOREIGN and len(overlong) < 2000
    assert good == b"done"


NUMBER = re.compile(r"[-+]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|Infinity)|NaN")
pieces = st.sampled_from(
    ["-", "+", ".", "E", "e", "_", "0", "17", "NaN", "Infinity", "nan", "inf", " ", "0x1", "1.5E-7"]
)
fields = st.floats().map(lambda x: repr(x).replace("e", "E").replace("nan", "NaN").replace("inf", "Infinity"))
vectors = st.lists(fields | st.lists(pieces, max_size=3).map("".join), max_size=9).map("_".join)


@settings(max_examples=500)
@given(vectors, st.sampled_from(["", "_", "__"]))
def test_a_line_of_numbers_is_read_as_field_by_field(vector, end):
    reply = parse_reply((vector + end).encode())
    texts = re.sub("_$", "", vector + end).split("_") if vector + end not in ("0", "1") else []
    if len(texts) in (3, 6, 7) and all(NUMBER.fullmatch(text) for text in texts):
        assert reply.kind.value == f"{len(texts)} numbers"
        np.testing.assert_array_equal(reply.numbers, [float(text) for text in texts])
    else:
        assert reply.kind in (ReplyKind.FOREIGN, ReplyKind.PIN) and len(reply.numbers) < 2


@pytest.mark.parametrize("word", ["stVelDcJoint", "velJDC"])
def test_no_command_of_the_velocity_mode_is_known(word):
    """The server has no watchdog: after the loss of the link it keeps the last speed."""
    sources = Path(codec.__file__).parent.glob("*.py")
    assert not [path.name for path in sources if word in path.read_text()]
