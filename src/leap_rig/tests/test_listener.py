"""The report's listener: the tool's frames out of the tf messages, beside tf2's own buffer."""

import io

import numpy as np
import pytest

from common import clock
from common.frames import BASE, FLANGE_DESIRED, HAND, HAND_FILTERED, TOOL_COMMANDED, TOOL_DESIRED, VIRTUAL_LEAP
from common.poses import pose
from common.reasons import ReasonCode
from common.rotations import rotation_from_zyx
from common.teleop_record import RUNNING, WAITING

pytest.importorskip("rig_msgs.srv")
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import TimeReference
from std_msgs.msg import Header, String
from tf2_msgs.msg import TFMessage

from common.ros.conversions import pose_from_transform, stamped_transform
from leap_rig.report.recorder import Recorder
from leap_rig.report.ros.listener import RigListener
from rig_msgs.msg import TeleopState

pytestmark = pytest.mark.ros


def random_pose(rng):
    return pose(rotation_from_zyx(*rng.uniform(-1.5, 1.5, 3)), rng.uniform(-1.0, 1.0, 3))


def any_message(message):
    buffer = io.BytesIO()
    message.serialize(buffer)
    return rospy.AnyMsg().deserialize(buffer.getvalue())


def raw(transforms):
    return any_message(TFMessage(transforms))


@pytest.fixture
def listener(ros):
    return RigListener(Recorder())


def test_the_newest_poses_are_those_of_tf(listener):
    rng, buffer = np.random.default_rng(3), tf2_ros.Buffer()
    begin = rospy.Time.now()
    for i in range(200):
        stamp = begin + rospy.Duration(0, 1000 * i)
        messages = [[stamped_transform(random_pose(rng), BASE, "kuka/link_0", stamp)]]
        if rng.random() < 0.7:
            frames = [
                (BASE, VIRTUAL_LEAP),
                (VIRTUAL_LEAP, HAND),
                (VIRTUAL_LEAP, HAND_FILTERED),
                (VIRTUAL_LEAP, TOOL_DESIRED),
                (VIRTUAL_LEAP, FLANGE_DESIRED),
            ]
            slash = "/" if rng.random() < 0.2 else ""  # as an old publisher has it
            messages.append([stamped_transform(random_pose(rng), slash + a, slash + b, stamp) for a, b in frames])
        if rng.random() < 0.5:
            messages.append([stamped_transform(random_pose(rng), BASE, TOOL_COMMANDED, stamp)])
        for transforms in messages:
            listener._transforms(raw(transforms))
            for transform in transforms:
                buffer.set_transform(transform, "test")
        for frame in (TOOL_DESIRED, TOOL_COMMANDED):
            try:
                expected = pose_from_transform(buffer.lookup_transform(BASE, frame, rospy.Time(0)).transform)
            except tf2_ros.TransformException:
                expected = None
            got = listener._fresh(frame)
            assert (got is None) == (expected is None)
            if got is not None:
                np.testing.assert_allclose(got, expected, atol=1e-9)


def test_old_and_incomplete_frames_are_missing(listener):
    def found(parent, age=0.0):
        stamp = rospy.Time.now() - rospy.Duration.from_sec(age)
        transform = stamped_transform(np.eye(4), BASE, TOOL_DESIRED, stamp)
        transform.header.frame_id = parent
        listener._transforms(raw([transform]))
        return listener._fresh(TOOL_DESIRED) is not None

    assert listener._fresh(TOOL_DESIRED) is None
    assert not found(VIRTUAL_LEAP) and not found(TOOL_DESIRED)
    assert found(BASE, 0.19) and not found(BASE, 0.21)
    assert found(BASE)
    clock.sleep(0.21)
    assert listener._fresh(TOOL_DESIRED) is None


def test_a_listener_of_one_of_two_arms_takes_the_names_of_this_arm_alone(ros):
    left, right = (RigListener(Recorder(), arm) for arm in ("left", "right"))
    names = ("left/kuka_control", "right/kuka_control", "simulated_world")
    statuses = [DiagnosticStatus(name=name, values=[KeyValue("goals_sent", name)]) for name in names]
    frame = raw([stamped_transform(np.eye(4), f"left/{BASE}", f"left/{TOOL_DESIRED}", rospy.Time.now())])
    for listener in (left, right):
        listener._diagnostics(DiagnosticArray(status=statuses))
        listener._transforms(frame)
    assert left.recorder.counters["kuka_control"] == {"goals_sent": "left/kuka_control"}
    assert right.recorder.counters["kuka_control"] == {"goals_sent": "right/kuka_control"}
    assert left.recorder.counters["simulated_world"] == right.recorder.counters["simulated_world"]
    assert left._fresh(f"left/{TOOL_DESIRED}") is not None and not right._frames
    for listener in (left, right):
        listener.stop()


def test_a_stage_time_is_read_as_genpy_reads_it(listener):
    rng = np.random.default_rng(4)
    for i in range(200):
        stamp, done = (rospy.Time(*rng.integers(0, (2**32, 10**9)).tolist()) for _ in range(2))
        source = rng.choice(["received", "leap_motion", "leap_kuka", "kuka_control", "leap_hand"])
        listener._stage(any_message(TimeReference(Header(i, stamp, ""), done, source)))
        frame = round(stamp.to_sec(), 4)
        assert listener.recorder.stamps[frame] == pytest.approx(stamp.to_sec(), abs=1e-6)
        assert listener.recorder.stage_times[source][frame] == pytest.approx(done.to_sec(), abs=1e-6)


def test_the_end_of_a_stream_is_recorded_with_its_codes(listener):
    codes = [ReasonCode.HAND_GONE.value, "of a newer version"]
    listener._teleop(TeleopState(state=RUNNING))
    listener._teleop(TeleopState(state=WAITING, reason="why", reason_codes=codes))
    (stream,) = listener.recorder.streams
    assert stream.reason == "why" and stream.codes == (ReasonCode.HAND_GONE,)


def test_a_sampled_topic_is_read_once_a_period_however_many_messages_come(listener):
    read = []
    take = listener._sampled(String, lambda _: read.append(clock.monotonic()), 0.1)
    begun = clock.monotonic()
    for _ in range(1000):
        take(any_message(String()))
        clock.sleep(0.003)
    assert read[0] == begun and len(read) == pytest.approx(30, abs=2)
    spans = np.diff(read)[1:]  # two come at once after a pause, such as the one before the first
    assert min(spans) > 0.09 and max(spans) < 0.11
