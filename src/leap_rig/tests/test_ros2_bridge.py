"""The pure half of the bridge to ROS 2: frames on its socket, what waits for a slow process, and keys and values."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.frames import PREFIX
from leap_rig.ros2.channels import FIRST_TOPIC, RESULT, channels
from leap_rig.ros2.config import LOCALHOST, SUBNET
from leap_rig.ros2.key_values import key_values
from leap_rig.ros2.outbox import MessageRateLimit, NewestFrames
from leap_rig.ros2.variables import side_variables
from leap_rig.ros2.wire import HEADER, MAX_BODY, BridgeFault, frames, packed

FRAMES = st.lists(st.tuples(st.integers(0, 2**16 - 1), st.binary(max_size=300)), max_size=8)


def pieces(data, sizes):
    """Returns a function that gives the data in pieces of at most these sizes, then nothing."""
    rest, sizes = [data], iter(sizes)

    def receive(most):
        size = min(next(sizes, most), most)
        piece, rest[0] = rest[0][:size], rest[0][size:]
        return piece

    return receive


@given(FRAMES, st.lists(st.integers(1, 50), max_size=50))
def test_frames_come_as_they_were_sent_however_the_socket_cuts_them(sent, sizes):
    data = b"".join(packed(*frame) for frame in sent)
    assert list(frames(pieces(data, sizes))) == sent


@given(FRAMES.filter(bool), st.data())
def test_a_torn_frame_is_said_after_those_before_it(sent, drawn):
    data = b"".join(packed(*frame) for frame in sent)
    last = len(packed(*sent[-1]))
    came = []
    with pytest.raises(BridgeFault):
        for frame in frames(pieces(data[: len(data) - drawn.draw(st.integers(1, last - 1))], [])):
            came.append(frame)
    assert came == sent[:-1]


def test_no_frame_makes_the_other_side_wait_for_more_than_a_message_has():
    with pytest.raises(BridgeFault):
        list(frames(pieces(HEADER.pack(MAX_BODY + 1, 1), [])))
    with pytest.raises(BridgeFault):
        packed(1, bytes(MAX_BODY + 1))


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(1, 3))))
def test_of_each_source_the_newest_wait_in_their_order(sent):
    depth = {"a": 1, "b": 2, "c": 5}
    box = NewestFrames()
    for i, (source, _) in enumerate(sent):
        box.put(source, bytes([i]), depth[source])
    box.close()
    kept = [i for name, most in depth.items() for i in [i for i, (n, _) in enumerate(sent) if n == name][-most:]]
    assert list(box.take()) == sorted(kept)
    assert box.dropped == len(sent) - len(kept)
    assert box.take() == b""


TIMES = st.lists(st.tuples(st.sampled_from("ab"), st.integers(0, 1000)), max_size=80).map(
    lambda sent: sorted(sent, key=lambda s: s[1])
)


@given(TIMES, st.integers(1, 200), st.integers(1, 10))
def test_no_source_passes_more_often_than_its_limit(sent, rate, burst):
    limit = MessageRateLimit(rate, burst)
    passed = [(source, 1e-3 * ms) for source, ms in sent if limit.passes(source, 1e-3 * ms)]
    for source in "ab":
        times = [now for name, now in passed if name == source]
        for i, begin in enumerate(times):
            for count, end in enumerate(times[i:], 1):
                assert count <= burst + rate * (end - begin) + 1e-6


@given(TIMES, st.integers(1, 10))
def test_a_source_below_its_limit_passes_whatever_the_other_does(sent, burst):
    limit = MessageRateLimit(50.0, burst)
    flood, last, now = 0, -1.0, 0.0
    for source, ms in sent:
        now = 1e-3 * ms
        if source == "b":
            flood += limit.passes("b", now)
        elif now - last > 0.0201:
            assert limit.passes("a", now)
            last = now
    assert flood <= burst + 50.0 * now + 1e-6


FIELDS = ("header", "mode", "limits", "on", "shift", "flags")


class Vector:
    __slots__ = ("x", "y")

    def __init__(self, x, y):
        self.x, self.y = x, y


class Status:
    __slots__ = FIELDS


def test_a_message_becomes_keys_and_values():
    message = Status()
    for name, value in zip(FIELDS, (None, "servo", ["yaw", "roll"], True, Vector(0.1, -2.0), [False, True])):
        setattr(message, name, value)
    assert key_values(message) == [
        ("mode", "servo"), ("limits", "yaw, roll"), ("on", "true"), ("shift.x", "0.1"), ("shift.y", "-2"),
        ("flags", "false, true"),
    ]  # fmt: skip


@pytest.mark.parametrize("arms", [("",), ("left/", "right/")])
def test_topics_have_numbers_and_names_of_their_own(arms):
    topics = channels(arms)
    assert len({topic.number for topic in topics}) == len({topic.topic for topic in topics}) == len(topics)
    assert all(topic.number >= FIRST_TOPIC > RESULT and PREFIX.fullmatch(topic.topic) for topic in topics)
    assert {f"{arm}joint_states" for arm in arms} <= {topic.topic for topic in topics}


NAMES = ["HOME", "ROS_DOMAIN_ID", "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER", "FASTDDS_BUILTIN_TRANSPORTS",
         "FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_ENVIRONMENT_FILE",
         "RMW_IMPLEMENTATION", "RMW_FASTRTPS_USE_QOS_FROM_XML", "SKIP_DEFAULT_XML_FILE", "PYTHONPATH",
         "ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE"]  # fmt: skip


@given(st.dictionaries(st.sampled_from(NAMES), st.just("theirs")))
def test_nothing_in_the_environment_leads_the_bridge_into_the_network(own):
    local = side_variables(own, LOCALHOST, "/ours.xml")
    theirs = {name for name, value in local.items() if value == "theirs"}
    assert theirs <= {"HOME", "ROS_DOMAIN_ID", "LEAP_RIG_PYTHONPATH"}
    assert local["FASTDDS_DEFAULT_PROFILES_FILE"] == "/ours.xml" and local["SKIP_DEFAULT_XML_FILE"] == "1"
    assert local["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    wide = side_variables(own, SUBNET, "/ours.xml")
    assert wide.get("ROS_STATIC_PEERS") == own.get("ROS_STATIC_PEERS") and "/ours.xml" not in wide.values()
