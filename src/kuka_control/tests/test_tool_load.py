"""The tool's weight is taken off the external torques: laws on the simulated arm, whose weight is Pinocchio's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from loop_world import CONFIG, rig

from common.mounting import rotation_of_mounting
from common.poses import translation
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.switches import Switches
from kuka_control.model.tool_load import wrench_at_tool
from rig_description.hand import CONNECTOR_LENGTH, RING_LENGTH, ring_body, tool_body
from rig_description.rigid_body import joined
from rig_description.urdf import urdf
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.robot import Robot

MOUNTINGS = {"floor": (0.0, 0.0, 0.0), "ceiling": (180.0, 0.0, 0.0), "wall": (0.0, 90.0, 0.0)}
poses = st.lists(st.floats(-1.6, 1.6), min_size=7, max_size=7).map(np.array)


def simulated(mounting):
    arm = SimulatedArm(Robot(urdf("LBR7R800", "MF_elektrisch"), MOUNTINGS[mounting]), ArmSettings(tool_weight=True))
    arm.attach(translation(0.0, 0.0, 0.106))
    return arm


ARMS = {name: simulated(name) for name in MOUNTINGS}
LOADS = {name: replace(rig(RealTimeConfig)[1].load, up=rotation_of_mounting(rpy)[2]) for name, rpy in MOUNTINGS.items()}


@pytest.mark.hazard(24)
@given(st.sampled_from(list(MOUNTINGS)), poses)
def test_an_arm_at_rest_that_nothing_touches_shows_no_torques(mounting, q):
    """Reported in https://github.com/IFL-CAMP/iiwa_stack/issues/228: the tool's weight counts as external torque.
    Tried: an arm at rest with its hand.
    """
    arm, load = ARMS[mounting], LOADS[mounting]
    arm.q = q
    left = arm.external_torques - load.torques(q)
    assert np.max(np.abs(left)) < 0.01
    assert arm.measured_torques == pytest.approx(arm.robot.torques(q, np.zeros(7), np.zeros(7)))


@given(poses, st.floats(0.0, 5.0))
def test_a_held_object_is_a_weight_at_the_tool_point(q, payload):
    loaded = LOADS["floor"]
    down = loaded.kinematics.jacobian(q)[:3].T @ np.array([0.0, 0.0, -9.81 * payload])
    for load in (loaded, replace(loaded, mass=0.0)):
        np.testing.assert_allclose(load.torques(q, payload) - load.torques(q), down, atol=1e-9)
        np.testing.assert_allclose(
            load.wrench(q, payload), wrench_at_tool(load.kinematics, q, load.torques(q, payload)), atol=1e-9
        )


def test_force_and_moment_are_free_of_the_weight_at_home():
    load, home = LOADS["floor"], rig(RealTimeConfig)[1].home.q
    force, moment = wrench_at_tool(load.kinematics, home, load.torques(home))
    np.testing.assert_allclose(force, (0.0, 0.0, 1.12 * 9.81), atol=1e-6)  # the tool's z axis points down
    np.testing.assert_allclose(load.wrench(home), (force, moment))


def test_the_shipped_mass_is_that_of_the_description():
    ring = joined([tool_body(CONNECTOR_LENGTH + RING_LENGTH), ring_body()])
    for name, body in (("kuka_params_rt", tool_body()), ("kuka_params_ptp", tool_body()), ("marker_ring", ring)):
        values = yaml.safe_load(Path(CONFIG / f"{name}.yaml").read_text())
        assert values["tool_mass"] == pytest.approx(body.mass, abs=0.005)
        np.testing.assert_allclose(values["tool_center_of_mass"], body.com, atol=5e-5)


@given(st.one_of(st.floats(), st.sampled_from([-1e-9, 5.1, float("nan")])))
def test_a_payload_is_taken_or_refused_and_kept(mass):
    switches = Switches()
    reply = switches.set_payload(mass)
    assert reply.success == (0.0 <= mass <= 5.0)
    assert switches.now.payload == (pytest.approx(mass, abs=1e-6) if reply.success else 0.0)
