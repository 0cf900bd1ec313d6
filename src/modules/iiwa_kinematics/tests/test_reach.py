"""Position first: the nearest orientation in reach, against a search by brute force, and steady ways to it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from common.poses import pose, translation
from common.rotations import rotation_about
from iiwa_kinematics import DhParameters, Kinematics, approached, kinematics_of, tilted
from iiwa_kinematics.reach import POSITION_M
from iiwa_kinematics.robot_model import robot_model

TOOL = translation(0.0, 0.0, 0.106)
ARMS = [
    Kinematics(robot_model("LBR7R800", "MF_elektrisch"), TOOL),
    Kinematics(robot_model("LBR14R820", "MF_touch_pneumatisch"), pose(rotation_about(0, 0.2), (0.02, -0.01, 0.15))),
]
HOME = np.radians([-45.0, 30.0, 0.0, -65.0, 0.0, 85.0, 0.0])
MOST = np.radians(45.0)
arms = pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.model.name)


def angle(T, T_other):
    return float(np.linalg.norm(pin.log3(T[:3, :3].T @ T_other[:3, :3])))


def out_of_reach(arm, count, seed):
    """Poses about home, up to 0.25 m and 40 deg off, that no joints reach."""
    rng = np.random.default_rng(seed)
    T_home, found = arm.forward(HOME), []
    while len(found) < count:
        shift, turn = rng.uniform(-0.25, 0.25, 3), rng.uniform(-1.0, 1.0, 3)
        T = pose(T_home[:3, :3] @ pin.exp3(0.7 * turn), T_home[:3, 3] + shift)
        if arm.inverse(T, HOME).q is None:
            found.append(T)
    return found


def nearest_by_search(arm, T, rng):
    """The angle of the nearest orientation that was found in reach [rad], of 80 random axes and 40 about the best."""
    best, axis = np.inf, None
    for k in range(120):
        n = rng.normal(size=3) if k < 80 or axis is None else axis + 0.2 * rng.normal(size=3)
        n /= np.linalg.norm(n)
        for turn in np.arange(np.radians(0.5), min(best, MOST), np.radians(0.5)):
            if arm.inverse(pose(pin.exp3(turn * n) @ T[:3, :3], T[:3, 3]), HOME).q is not None:
                best, axis = turn, n
                break
    return best


@arms
def test_the_tilt_keeps_the_position_is_reached_and_no_search_finds_a_nearer_orientation(arm):
    rng = np.random.default_rng(0)
    for T in out_of_reach(arm, 8, seed=1):
        T_tilted = tilted(arm, T, MOST)
        best = nearest_by_search(arm, T, rng)
        if T_tilted is None:
            assert not np.isfinite(best)
            continue
        np.testing.assert_array_equal(T_tilted[:3, 3], T[:3, 3])
        assert arm.inverse(T_tilted, HOME).q is not None
        assert angle(T, T_tilted) <= 1.05 * best + np.radians(0.5)


@arms
def test_of_all_poses_out_of_reach_those_with_a_near_orientation_are_brought_into_it(arm):
    reached = [arm.inverse(tilt, HOME).q for T in out_of_reach(arm, 300, seed=2)
               if (tilt := tilted(arm, T, MOST)) is not None]  # fmt: skip
    assert len(reached) > 250 and sum(q is None for q in reached) < 4


@arms
def test_the_tilt_follows_the_pose_continuously(arm):
    """One tool path after the other, straight out of the reach: small steps of the pose, small steps of the tilt."""
    rng = np.random.default_rng(3)
    followed = 0
    for T in out_of_reach(arm, 40, seed=3):
        before, way = None, 1e-4 * rng.normal(size=6)
        for s in range(20):
            moved = pose(T[:3, :3] @ pin.exp3(s * way[3:]), T[:3, 3] + s * way[:3])
            now = tilted(arm, moved, MOST)
            if before is not None and now is not None:
                # The tilt follows the distance to the end of the reach over the lever of the tool, less than 0.2 m.
                assert angle(before, now) < np.radians(1.0)
                followed += 1
            before = now
    assert followed > 500


def test_a_calibrated_arm_comes_to_its_tilted_poses():
    rng = np.random.default_rng(4)
    off = 0.1 * rng.uniform(-1.0, 1.0, (4, 7))
    parts = (5e-3 * off[0], np.radians(off[1]), 5e-3 * off[2], np.radians(off[3]))
    arm = kinematics_of(ARMS[0].model, TOOL, DhParameters(*parts))
    tilts = [tilted(arm, T, MOST) for T in out_of_reach(arm, 150, seed=5)]
    reached = [arm.inverse(T, HOME).q is not None for T in tilts if T is not None]
    assert len(reached) > 100 and np.mean(reached) > 0.97


@arms
def test_joints_on_the_way_keep_the_tool_in_its_position_and_come_nearer(arm):
    rng = np.random.default_rng(6)
    came = 0
    for _ in range(80):
        q_goal = np.clip(HOME + rng.uniform(-0.6, 0.6, 7), 0.95 * arm.model.lower, 0.95 * arm.model.upper)
        position = arm.forward(q_goal)[:3, 3]
        found = arm.inverse(pose(arm.forward(q_goal)[:3, :3] @ pin.exp3(rng.uniform(-0.5, 0.5, 3)), position), q_goal)
        if found.q is None:
            continue
        q, most = found.q, np.full(7, np.radians(2.0))
        for _ in range(120):
            q_next = approached(arm, position, q, q_goal, most)
            if q_next is None:
                break
            assert np.abs(arm.forward(q_next)[:3, 3] - position).max() <= POSITION_M
            assert np.abs(q_next - q).max() < np.radians(3.0)
            q = q_next
        came += np.abs(q - q_goal).max() < 1e-4
    assert came > 60
