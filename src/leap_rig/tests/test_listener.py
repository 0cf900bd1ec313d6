"""The report's listener: the tool's frames out of the tf messages, beside tf2's own buffer."""

import io

import numpy as np
import pytest

from common.frames import BASE, FLANGE_DESIRED, HAND, TOOL_COMMANDED, TOOL_DESIRED, VIRTUAL_LEAP
from common.poses import pose
from common.rotations import rotation_from_zyx

pytestmark = pytest.mark.ros


def random_pose(rng):
    return pose(rotation_from_zyx(*rng.uniform(-1.5, 1.5, 3)), rng.uniform(-1.0, 1.0, 3))


def raw(transforms):
    import rospy
    from tf2_msgs.msg import TFMessage

    buffer = io.BytesIO()
    TFMessage(transforms).serialize(buffer)
    return rospy.AnyMsg().deserialize(buffer.getvalue())


@pytest.fixture
def listener(ros):
    from leap_rig.recorder import Recorder
    from leap_rig.ros.listener import RigListener

    return RigListener(Recorder())


def test_the_newest_poses_are_those_of_tf(listener, monkeypatch):
    import rospy
    import tf2_ros

    from common.ros.conversions import pose_from_transform, stamped_transform

    monkeypatch.setattr("leap_rig.ros.listener.FRESH_S", 1000.0)
    rng, buffer = np.random.default_rng(3), tf2_ros.Buffer()
    begin = rospy.Time.now()
    for i in range(200):
        stamp = begin + rospy.Duration(0, 1000 * i)
        messages = [[stamped_transform(random_pose(rng), BASE, "kuka/link_0", stamp)]]
        if rng.random() < 0.7:
            frames = [
                (BASE, VIRTUAL_LEAP),
                (VIRTUAL_LEAP, HAND),
                (VIRTUAL_LEAP, TOOL_DESIRED),
                (TOOL_DESIRED, FLANGE_DESIRED),
            ]
            messages.append([stamped_transform(random_pose(rng), a, b, stamp) for a, b in frames])
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
    import rospy

    from common.ros.conversions import stamped_transform

    def give(parent, stamp):
        listener._transforms(raw([stamped_transform(np.eye(4), parent, TOOL_DESIRED, stamp)]))

    assert listener._fresh(TOOL_DESIRED) is None
    give(VIRTUAL_LEAP, rospy.Time.now())
    assert listener._fresh(TOOL_DESIRED) is None
    give(TOOL_DESIRED, rospy.Time.now())
    assert listener._fresh(TOOL_DESIRED) is None
    give(BASE, rospy.Time.now() - rospy.Duration(1))
    assert listener._fresh(TOOL_DESIRED) is None
    give(BASE, rospy.Time.now())
    assert listener._fresh(TOOL_DESIRED) is not None
