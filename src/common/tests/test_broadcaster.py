"""What a node sends on tf: nothing that its listeners would warn of."""

import numpy as np
import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
from tf2_msgs.msg import TFMessage

from common.ros.broadcaster import FreshBroadcaster
from common.ros.conversions import stamped_transform

pytestmark = pytest.mark.ros


def test_no_frame_goes_out_twice_with_one_stamp(virtual_graph):
    """Reported in https://github.com/ros/geometry2/issues/467, https://github.com/heuristicus/spot_ros/issues/142:
    repeated stamps flood each listener with warnings. Tried: a camera that repeats its images.
    """
    got, broadcaster = virtual_graph.record("/tf", TFMessage), FreshBroadcaster()
    clock.sleep(0.1)

    def sent(*frames):
        del got[:]
        broadcaster.sendTransform([stamped_transform(np.eye(4), "camera", *frame) for frame in frames])
        clock.sleep(0.1)
        return [transform.child_frame_id for message in got for transform in message.transforms]

    first, later = rospy.Time(1), rospy.Time(2)
    assert sent(("a", first), ("b", first)) == ["a", "b"]
    assert sent(("a", first), ("b", later), ("b", later)) == ["b"]
    assert sent(("b", later)) == got == []
    assert sent(("a", first), ("b", first)) == ["b"], "a recording that begins anew"


@pytest.mark.parametrize(("parent", "child"), [("", "tag"), ("camera", ""), ("camera", "camera")])
def test_frames_that_no_listener_takes_are_refused(parent, child):
    """Reported in https://github.com/NVIDIA-ISAAC-ROS/isaac_ros_apriltag/issues/20,
    https://github.com/AprilRobotics/apriltag_ros/issues/152: images without a frame_id. Tried: that header,
    `publish_tf`.
    """
    with pytest.raises(ValueError, match="frame_id"):
        stamped_transform(np.eye(4), parent, child, rospy.Time(1))
