"""description.launch: tf of the arm from joint_states, and of its mounting; the publishers are not Python."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("rig_msgs.srv")
import rospy
import tf2_ros
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

pytestmark = [pytest.mark.ros, pytest.mark.real]

URDF = Path(__file__).parents[1] / "urdf"


@pytest.mark.parametrize(
    ("robot", "flange"),
    [
        ("LBR7R800", "MF_elektrisch"),
        pytest.param("LBR14R820", "MF_touch_pneumatisch", marks=pytest.mark.long),
    ],
)
def test_tf_is_the_forward_kinematics_of_the_published_joints(ros, wait_until, robot, flange):
    ros.launch("rig_description", "description.launch", robot=robot, flange=flange, mounting="20 30 -40")
    model = pin.buildModelFromUrdf(str(URDF / f"{robot.lower()}_{flange}.urdf"))
    data, q = model.createData(), np.linspace(-0.5, 0.9, model.nq)
    pin.framesForwardKinematics(model, data, q)
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)
    publisher = rospy.Publisher("joint_states", JointState, queue_size=1)

    def publish_until(frame):
        publisher.publish(JointState(name=list(model.names[1:]), position=list(q), header=_now()))
        return buffer.can_transform("kuka/base_frame", frame, rospy.Time(0))

    for frame in ("kuka/flange", "reflex/distal_1", "reflex/distal_3"):
        wait_until(lambda name=frame: publish_until(name), 30.0, f"tf of {frame}", poll=0.1)
        t = buffer.lookup_transform("kuka/base_frame", frame, rospy.Time(0)).transform
        expected = data.oMf[model.getFrameId(frame)]
        p, r = t.translation, t.rotation
        np.testing.assert_allclose([p.x, p.y, p.z], expected.translation, atol=1e-6)
        np.testing.assert_allclose(pin.Quaternion(r.w, r.x, r.y, r.z).toRotationMatrix(), expected.rotation, atol=1e-6)
    wait_until(lambda: buffer.can_transform("world", "kuka/base_frame", rospy.Time(0)), 30.0, "tf of the base")
    r = buffer.lookup_transform("world", "kuka/base_frame", rospy.Time(0)).transform.rotation
    expected = pin.rpy.rpyToMatrix(*np.radians([20.0, 30.0, -40.0]))
    np.testing.assert_allclose(pin.Quaternion(r.w, r.x, r.y, r.z).toRotationMatrix(), expected, atol=1e-6)
    listener.unregister()


def _now():
    return Header(stamp=rospy.Time.now())
