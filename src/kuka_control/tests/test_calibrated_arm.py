"""A calibrated arm in the whole chain: the real one deviates from its data sheet, the controller is told how."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from bench.simulated import SimulatedRig
from common.config import parse
from common.poses import pose
from common.rotations import rotation_about
from iiwa_kinematics import nominal_parameters, robot_model
from kuka_control.model.config import DhDeviations
from rig_simulation.devices.sunrise.robot import Robot

EXAMPLE = Path(__file__).parents[1] / "config" / "dh_parameters_example.yaml"
JOINT = """
<link name="link_{i}"><inertial><mass value="0.1"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>
</inertial></link>
<joint name="kuka/joint_{i}" type="revolute"><parent link="{parent}"/><child link="link_{i}"/><axis xyz="0 0 1"/>
<origin xyz="{x} 0 {z}" rpy="{roll} 0 0"/>
<limit lower="{lower}" upper="{upper}" velocity="{speed}" effort="300"/></joint>"""
FLANGE = """
<link name="kuka/flange"/><joint name="flange" type="fixed"><parent link="turned_7"/><child link="kuka/flange"/>
<origin xyz="{x} 0 {z}" rpy="{roll} 0 0"/></joint>"""
TURNED = """
<link name="turned_{i}"/><joint name="zero_{i}" type="fixed"><parent link="link_{i}"/><child link="turned_{i}"/>
<origin rpy="0 0 {theta}"/></joint>"""


def deviations(scale=1.0):
    values = yaml.safe_load(EXAMPLE.read_text())
    scaled = {key: (scale * np.array(value)) for key, value in values.items() if key.startswith("delta")}
    return parse(DhDeviations, {**values, **scaled})


def deviating_robot(found):
    """The simulated arm, built like that of the description, with these deviations."""
    model = robot_model(found.robot, "MF_elektrisch")
    table = nominal_parameters(model).plus(found.parameters)
    text, parent, before = '<robot name="arm"><link name="base"/>', "base", {"x": 0.0, "z": 0.0, "roll": 0.0}
    for i in range(7):
        limits = {"lower": model.lower[i], "upper": model.upper[i], "speed": model.max_speed[i]}
        text += JOINT.format(i=i + 1, parent=parent, **before, **limits)
        text += TURNED.format(i=i + 1, theta=table.theta[i])
        parent, before = f"turned_{i + 1}", {"x": table.a[i], "z": table.d[i], "roll": table.alpha[i]}
    return Robot(text + FLANGE.format(**before) + "</robot>")


def tool_error(robot, dh):
    """How far the true tool is from the tool frames it was to go to, in position [mm] and rotation [deg]."""
    rig = SimulatedRig(robot=robot, dh=dh).at_home()
    home = rig.rig.home.T_base_tool
    millimetres, degrees = [], []
    for shift, turn in (
        ((0, 0, 0), 0.0),
        ((0.05, 0.05, 0.08), 0.2),
        ((-0.06, 0.02, -0.1), -0.2),
        ((0, -0.06, 0.05), 0.3),
    ):
        wanted = pose(home[:3, :3] @ rotation_about(0, turn), home[:3, 3] + shift)
        rig.follow(3.0, lambda _, T=wanted: T)
        true = robot.flange(rig.q[-1]) @ rig.rig.T_flange_tool
        millimetres.append(1e3 * np.linalg.norm(true[:3, 3] - wanted[:3, 3]))
        cosine = (np.trace(true[:3, :3].T @ wanted[:3, :3]) - 1.0) / 2.0
        degrees.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    return max(millimetres), max(degrees)


def test_the_tool_of_a_deviating_arm_is_where_it_is_wanted_if_the_controller_knows_the_deviations():
    found = deviations(scale=3.0)
    robot = deviating_robot(found)
    before, after = tool_error(robot, None), tool_error(robot, found)
    assert before[0] > 2.0 and before[1] > 0.2, before
    assert after[0] < 0.05 and after[1] < 0.02, after


def test_a_home_of_ones_own_has_its_centre_where_the_true_tool_is():
    found = deviations()
    rig = SimulatedRig(robot=deviating_robot(found), dh=found, use_home_pos=True).rig
    np.testing.assert_array_equal(rig.home.q, np.radians(rig_values()["home_pos"]))
    true = deviating_robot(found).flange(rig.home.q) @ rig.T_flange_tool
    np.testing.assert_allclose(rig.home.centre, true[:3, 3], atol=1e-9)


def rig_values():
    return yaml.safe_load((EXAMPLE.parent / "kuka_params_rt.yaml").read_text())


def test_a_file_that_is_named_must_be_handed_in():
    with pytest.raises(ValueError, match="has to be read and handed in"):
        SimulatedRig(dh_parameters="/somewhere.yaml")
