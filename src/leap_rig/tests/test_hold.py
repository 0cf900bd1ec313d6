"""The tool waits at a pose for a hand, on the whole simulated rig: nothing jumps when the hand takes over."""

from __future__ import annotations

import numpy as np
import pytest

from common.poses import pose
from common.rotations import rotation_about, rotation_angle

pytestmark = [pytest.mark.ros, pytest.mark.rig]

TURN = np.radians(40.0)
TOOL = pose(rotation_about(2, -np.pi / 4.0 + TURN) @ np.diag([-1.0, 1.0, -1.0]), (0.45, -0.40, 0.32))


def hold(rig, duration):
    import rospy

    from common.ros.conversions import pose_from_message, stamped_pose
    from rig_msgs.srv import CheckToolPose, HoldTool

    check = rig.call("kuka/check_tool_pose", CheckToolPose, stamped_pose(TOOL, "kuka/base_frame", rospy.Time.now()))
    assert check.success, check.message
    desired = stamped_pose(pose_from_message(check.desired), "kuka/base_frame", rospy.Time.now())
    return rig.call("leap_kuka/hold_tool", HoldTool, desired, duration)


def is_there(rig):
    T = rig.arm.now.T_base_tool
    turned = rotation_angle(T[:3, :3].T @ TOOL[:3, :3])
    return np.linalg.norm(T[:3, 3] - TOOL[:3, 3]) < 2e-3 and turned < np.radians(0.5)


def test_a_hand_takes_the_arm_over_where_it_waits(rig):
    assert "control of the arm is off" in hold(rig, 60.0).message
    assert rig.control(True).success
    rig.wait(lambda: hold(rig, 60.0).success, "the hold", 10.0)
    rig.wait(lambda: rig.mode == "servo" and is_there(rig), "the arm at the pose", 15.0)
    assert rig.modes == ["pick_up", "servo"] and rig.stream_state == "waiting"

    start = rig.arm.now.time
    rig.hand.show(right=0.05, up=-0.03, back=0.02, yaw=25.0, pitch=10.0, roll=-8.0)
    rig.wait(lambda: rig.stream_state == "running", "the hand that takes over")
    rig.watch(1.5)
    places = np.array([s.T_base_tool[:3, 3] for s in rig.arm.since(start)])
    assert np.linalg.norm(places - TOOL[:3, 3], axis=1).max() < 5e-3
    rig.hand.glide(1.5, up=-0.08)
    rig.settle()
    assert rig.arm.now.T_base_tool[2, 3] == pytest.approx(TOOL[2, 3] - 0.05, abs=5e-3)
    assert rig.modes == ["pick_up", "servo"]

    rig.hand.hide()
    rig.wait_for_modes("returning", "home")
    assert rig.arm.now.stops == 0


def test_without_a_hand_the_arm_goes_home_again(rig):
    assert rig.control(True).success
    rig.wait(lambda: hold(rig, 8.0).success, "the hold", 10.0)
    rig.wait(lambda: rig.mode == "servo" and is_there(rig), "the arm at the pose", 15.0)
    rig.wait_for_modes("returning", "home")
    assert "the tool is held no longer: no hand took it over in time" in [why for _, why in rig.stream]
