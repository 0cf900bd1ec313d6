"""The arms as the data sheets and the description of the rig have them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from iiwa_kinematics import forward
from iiwa_kinematics.robot_model import FLANGE_HEIGHTS, robot_model

URDF = Path(__file__).parents[2] / "rig_description" / "urdf"
ARMS = [(robot, flange) for robot in ("LBR7R800", "LBR14R820") for flange in FLANGE_HEIGHTS]


@pytest.mark.parametrize("robot, flange", ARMS)
def test_closed_form_and_description_agree(robot, flange):
    """The simulated robot moves by the description, the controller thinks in the closed form."""
    described = pin.buildModelFromUrdf(str(URDF / f"{robot.lower()}_{flange}.urdf"))
    data, frame = described.createData(), described.getFrameId("kuka/flange")
    joints = [described.joints[described.getJointId(f"kuka/joint_{i + 1}")] for i in range(7)]
    position, velocity = [j.idx_q for j in joints], [j.idx_v for j in joints]
    model = robot_model(robot, flange)

    np.testing.assert_allclose(model.lower, described.lowerPositionLimit[position], atol=1e-6)
    np.testing.assert_allclose(model.upper, described.upperPositionLimit[position], atol=1e-6)
    np.testing.assert_allclose(model.max_speed, described.velocityLimit[velocity], atol=1e-6)
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = rng.uniform(model.lower, model.upper)
        everything = pin.neutral(described)
        everything[position] = q
        pin.framesForwardKinematics(described, data, everything)
        np.testing.assert_allclose(forward(model, q), data.oMf[frame].homogeneous, atol=1e-9)


def test_unknown_arm_and_flange_are_named_with_the_choices():
    with pytest.raises(ValueError, match=r"'LBR7'.*LBR7R800, LBR14R820"):
        robot_model("LBR7", "MF_elektrisch")
    with pytest.raises(ValueError, match=r"'MF'.*MF_elektrisch.*MF_touch_pneumatisch"):
        robot_model("LBR7R800", "MF")


def test_a_model_cannot_be_changed():
    model = robot_model("LBR7R800", "MF_elektrisch")
    with pytest.raises(dataclasses.FrozenInstanceError):
        model.base_shoulder = 0.0
    with pytest.raises(ValueError, match="read-only"):
        model.upper[0] = 9.0
