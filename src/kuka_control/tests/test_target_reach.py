"""Targets in the shipped workspaces: pick-ups are short, and at the end of the reach the tool is followed steadily."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from common.config import parse
from common.poses import pose
from common.rotations import rotation_angle, rotation_from_zyx, scaled_rotation
from kuka_control.loop.goal_stream import is_jump
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.rig import Rig
from kuka_control.model.target import HALF_TURN_RAD, MAX_DEVIATION_RAD, MotionScaling, Target
from kuka_control.model.workspace import Infeasible

CONFIG = Path(__file__).parents[1] / "config"
DT = 0.01
TILT = np.radians(25.0)
WORKSPACES = {
    "default": {},
    "14 R820": {"robot": "LBR14R820", "flange": "MF_touch_pneumatisch"},
    "marker ring": "marker_ring.yaml",
    "ceiling": "ceiling.yaml",
    "wall": "wall.yaml",
    "behind": {"center_line": [-1, -1, 0]},
    "high 0.8": {"z_upper_limit": 0.8},
    "high 1.0": {"z_upper_limit": 1.0},
}


@pytest.fixture(params=WORKSPACES, scope="module")
def rig(request):
    changes = WORKSPACES[request.param]
    if isinstance(changes, str):
        changes = yaml.safe_load((CONFIG / changes).read_text())
    values = yaml.safe_load((CONFIG / "kuka_params_rt.yaml").read_text())
    return Rig.of(parse(RealTimeConfig, {**values, **changes}, "kuka/"))


def tool(rig, shift, angles):
    """The tool of a hand that is shifted from the middle of the box [m], forward, left and up, and turned [rad]."""
    m = rig.mounting
    across = np.column_stack([m.forward, np.cross(m.up, m.forward), m.up])
    return pose(m.tool_from_hand(m.R_base_hand @ rotation_from_zyx(*angles)), rig.home.centre + across @ shift)


def test_no_pick_up_between_poses_of_the_workspace_is_absurd(rig):
    """From home and from one to the next, all over the workspace at the permitted tilts: 1.6 s at full speed."""
    rng = np.random.default_rng(0)
    q, turns, times = rig.home.q, [], []
    for k in range(300):
        T = tool(rig, rng.uniform(-0.2, 0.2, 3), rng.uniform(-TILT, TILT, 3))
        q_rest = rig.home.q if k % 2 else q
        target = rig.chain.resolve(T, MotionScaling(), q_rest)
        if isinstance(target, Infeasible) or target.q is None:
            assert isinstance(target, Infeasible) or "would turn joint" not in target.failure
            continue
        q = target.q
        turns.append(np.max(np.abs(q - q_rest)))
        times.append(np.max(np.abs(q - q_rest) / rig.model.max_speed))
    assert len(turns) > 250 and max(turns) < HALF_TURN_RAD and max(times) < 1.6


def test_an_absurd_turn_is_refused_with_a_sentence():
    rig = Rig.of(parse(RealTimeConfig, yaml.safe_load((CONFIG / "kuka_params_rt.yaml").read_text()), "kuka/"))
    q_rest = rig.home.q - np.radians([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 170.0])
    target = rig.chain.resolve(tool(rig, np.zeros(3), np.radians([20.0, 0.0, 0.0])), MotionScaling(), q_rest)
    assert isinstance(target, Target) and target.q is None
    assert "would turn joint" in target.failure and "more than half a turn" in target.failure


def smooth(rng, seconds):
    """A smooth way from zero and back, shape (n, 6) within -1 to 1."""
    t = np.arange(0.0, seconds, DT)[:, None] / seconds
    waves = (rng.normal(size=6) * np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.0, 6)) / f for f in (1, 2, 3))
    return np.tanh(sum(waves)) * np.minimum(1.0, 8.0 * np.minimum(t, 1.0 - t))


@pytest.mark.parametrize("seed", range(2))
def test_smooth_ways_at_permitted_tilts_are_followed_and_end_exactly(rig, seed):
    """Nothing is lost, the tool stays in its position, no joint jumps, and back in reach the desired pose is reached.

    Not on the wall: there joint 6 is near zero, and joints 5 and 7 may wind up to their limits.
    """
    if rig.workspace.z_lower == 0.4:
        pytest.skip("on the wall joint 6 is near zero: joints 5 and 7 wind up to their limits")
    speeds, way = 0.9 * rig.model.max_speed, smooth(np.random.default_rng(seed), 6.0)
    q, before = rig.home.q, None
    for x in [*way, *np.zeros((40, 6))]:
        T = tool(rig, 0.1 * x[:3], TILT * x[3:])
        target = rig.chain.resolve(T, MotionScaling(), q, before, DT)
        assert target.q is not None, target.failure
        assert not is_jump(q, target.q, DT, speeds)
        reached = rig.kinematics.forward(target.q)
        np.testing.assert_allclose(reached, target.T_base_tool, atol=1e-6)
        T[:3, 3] = rig.workspace.constrain(T[:3, 3]).position
        np.testing.assert_allclose(reached[:3, 3], T[:3, 3], atol=1e-6)
        off = rotation_angle(T[:3, :3].T @ reached[:3, :3])
        assert off <= MAX_DEVIATION_RAD and off == pytest.approx(target.deviation, abs=1e-6)
        q, before = target.q, target
    assert before.deviation == 0.0 and before.limited_by == ()


def nothing_near_is_reached(rig, T):
    """Whether no random orientation within MAX_DEVIATION_RAD of T, shape (4, 4), has joints."""
    rng = np.random.default_rng(1)
    for share in rng.uniform(0.0, 1.0, 60) ** (1.0 / 3.0):
        R = rotation_from_zyx(*rng.uniform(-np.pi, np.pi, 3))
        near = T @ pose(scaled_rotation(R, share * MAX_DEVIATION_RAD / rotation_angle(R)))
        if rig.kinematics.inverse(near, q_seed=rig.home.q).q is not None:
            return False
    return True


def test_a_far_orientation_in_which_nothing_near_is_reached_is_refused(rig):
    """Poses all over and around the workspace; which of them are out of reach is found by search."""
    rng, refused = np.random.default_rng(0), 0
    for _ in range(80):
        T = tool(rig, rng.uniform(-0.3, 0.3, 3), rng.uniform(-np.pi, np.pi, 3))
        constrained = rig.workspace.constrain(T[:3, 3])
        if isinstance(constrained, Infeasible):
            continue
        T[:3, 3] = constrained.position
        target = rig.chain.resolve(T, MotionScaling(), rig.home.q)
        if target.q is not None:
            off = rotation_angle(T[:3, :3].T @ rig.kinematics.forward(target.q)[:3, :3])
            assert off <= MAX_DEVIATION_RAD + 1e-6
        elif nothing_near_is_reached(rig, T):
            refused += 1
            assert target.q is None and target.failure.startswith("The tool pose is out of reach")
    assert refused >= 4
