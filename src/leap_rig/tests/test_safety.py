"""The safety features of the rig, each on the whole simulated rig: hand on the Leap's wire, arm behind the toolbox's.

Nothing here looks into a node. The arm's motion is the simulated arm's own, sampled on its control port.
"""

from __future__ import annotations

import numpy as np
import pytest

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]


def test_control_is_off_until_it_is_switched_on(rig):
    goals = rig.arm.now.goals
    angles = np.array(rig.robot_hand.ask("state")["angles"])
    rig.hand.show(right=0.06, curl=0.9)
    rig.wait(lambda: len(rig.desired) > 100, "a stream of desired tool frames")
    assert rig.arm.way(0.0) == 0.0 and rig.arm.now.goals == goals and rig.mode == "home"
    np.testing.assert_allclose(rig.robot_hand.ask("state")["angles"], angles, atol=0.02)

    assert rig.gripper(True).success
    rig.wait(lambda: max(rig.robot_hand.ask("state")["angles"]) > 0.5, "the robot hand to close", 20.0)
    assert rig.arm.way(0.0) == 0.0, "the arm stands while only the gripper is on"
    assert rig.control(True).success
    rig.wait_for_mode("servo")
    rig.wait(lambda: rig.arm.way(0.0) > 0.05, "the arm to move")
