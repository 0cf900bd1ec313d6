"""Inverse kinematics: right, complete, within the ranges, and steady along a path."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from common.poses import pose, translation
from common.rotations import rotation_about
from iiwa_kinematics import Branch, IkFailure, Kinematics, inverse
from iiwa_kinematics.elbow_choice import ElbowChoice
from iiwa_kinematics.elbow_circle import BRANCHES, ElbowCircle, Limits
from iiwa_kinematics.robot_model import robot_model

TOOL = translation(0.0, 0.0, 0.106)
ARMS = [
    Kinematics(robot_model("LBR7R800", "MF_elektrisch"), TOOL),
    Kinematics(robot_model("LBR14R820", "MF_touch_pneumatisch"), pose(rotation_about(0, 0.4), (0.1, -0.05, 0.2))),
]
HOME = np.radians([-45.0, 30.0, 0.0, -65.0, 0.0, 85.0, 0.0])
arms = pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.model.name)


def check(arm, result, T):
    assert result.failure is None
    np.testing.assert_allclose(arm.forward(result.q), T, atol=1e-9)
    assert np.all(arm.model.lower <= result.q) and np.all(result.q <= arm.model.upper)
    assert result.branch == Branch.of(result.q)


def random_joints(arm, count, seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(arm.model.lower, arm.model.upper, (count, 7))


@arms
@pytest.mark.parametrize("seed", [np.zeros(7), HOME], ids=["upright", "home"])
def test_every_pose_within_the_ranges_is_reached_from_a_cold_start(arm, seed):
    for q in random_joints(arm, 400, seed=1):
        T = arm.forward(q)
        check(arm, arm.inverse(T, seed), T)


@arms
def test_poses_with_several_joints_exactly_at_their_limits_or_at_zero_are_reached(arm):
    rng = np.random.default_rng(6)
    for q in random_joints(arm, 1750, seed=7):
        joints = rng.choice(7, rng.integers(2, 8), replace=False)
        q[joints] = np.where(rng.random(len(joints)) < 0.5, arm.model.lower[joints], arm.model.upper[joints])
        if rng.random() < 0.2:
            q[rng.choice([1, 5])] = 0.0
        T = arm.forward(q)
        check(arm, arm.inverse(T, HOME), T)
        check(arm, arm.inverse(T, q, keep_branch=True), T)


@arms
def test_a_motion_from_rest_takes_not_much_longer_than_the_quickest_of_all_branches_and_elbows(arm):
    """Between random joints; the quickest is sought among 120 elbow positions of each branch."""
    limits = Limits(arm.model.lower, arm.model.upper)
    for q, q_rest in zip(random_joints(arm, 40, seed=8), random_joints(arm, 40, seed=9)):
        T = arm.forward(q)
        circle, quickest = circle_of(arm, T), np.inf
        for branch in BRANCHES:
            for turn in np.linspace(-np.pi, np.pi, 120):
                there = np.array(circle.joints(turn, branch, q_rest, limits))
                if np.all((arm.model.lower <= there) & (there <= arm.model.upper)):
                    quickest = min(quickest, duration(arm, q_rest, there))
        found = arm.inverse(T, q_rest)
        check(arm, found, T)
        assert duration(arm, q_rest, found.q) < 1.5 * quickest + 0.6


class FullChoice(ElbowChoice):
    """The choice that computes what all limits leave free, and all branches, for every pose."""

    def __init__(self, model):
        super().__init__(model, 0.0)
        self._margins.hold = lambda q: False

    def _descend(self, circle, branch, interval, angle, seed, best):
        return None if interval is None else super()._descend(circle, branch, interval, angle, seed, best)

    def _least_time(self, circle, branch, seed):
        return 0.0


def present_circle(arm, q, seed):
    """The circle of the pose of joints q, with the elbow of the seed near angle zero."""
    circle = circle_of(arm, arm.forward(q))
    reference = inverse._elbow_across(circle._u, seed.tolist())
    axes = tuple(map(tuple, (arm.forward(q) @ np.linalg.inv(arm.T_flange_tool))[:3, :3].T))
    return ElbowCircle(circle.bend, arm._lengths, circle._u, reference, axes)


@arms
@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1))
def test_near_the_seed_the_elbow_is_chosen_as_among_all_that_the_limits_leave_free(arm, seed):
    rng = np.random.default_rng(seed)
    q = rng.uniform(arm.model.lower, arm.model.upper)
    q = np.where(rng.random(7) < rng.choice([0.0, 0.3]), rng.choice([arm.model.lower, arm.model.upper]), q)
    near = np.clip(q + np.radians(rng.choice([0.1, 2.0])) * rng.uniform(-1.0, 1.0, 7), arm.model.lower, arm.model.upper)
    circle = present_circle(arm, q, near)
    quick, full, present = ElbowChoice(arm.model, 0.0), FullChoice(arm.model), near.tolist()
    branch = Branch.of(near)
    found, expected = (choice._best_in_branch(circle, branch, present) for choice in (quick, full))
    assert (found is None) == (expected is None)
    if found is None:
        return
    # Both are results of three steps; where the circle is small or joints 2 or 6 near zero, the starts count.
    assert found.cost <= 1.02 * expected.cost + 1e-9
    led, fully = (choice.led_back(circle, found, present, 0.3) for choice in (quick, full))
    np.testing.assert_allclose(led.q, fully.q, atol=1e-12)


@arms
@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1))
def test_branches_that_cannot_be_quicker_are_left_out_and_no_others(arm, seed):
    rng = np.random.default_rng(seed)
    q, near = rng.uniform(arm.model.lower, arm.model.upper, (2, 7))
    circle = present_circle(arm, q, near)
    found, expected = (
        choice.quickest(circle, near.tolist()) for choice in (ElbowChoice(arm.model, 0.0), FullChoice(arm.model))
    )
    assert found == expected


def duration(arm, q_rest, q):
    """How long a motion between joints takes at full joint speed [s]."""
    return np.max(np.abs(q - q_rest) / arm.model.max_speed)


def circle_of(arm, T):
    T_flange = T @ np.linalg.inv(arm.T_flange_tool)
    w = T_flange[:3, 3] - arm.model.wrist_flange * T_flange[:3, 2] - [0.0, 0.0, arm.model.base_shoulder]
    a, b, reach = arm.model.shoulder_elbow, arm.model.elbow_wrist, np.linalg.norm(w)
    u, bend = w / reach, np.arccos((reach**2 - a**2 - b**2) / (2.0 * a * b))
    across = np.cross(u, [0.6, 0.8, 0.0])
    axes = tuple(map(tuple, T_flange[:3, :3].T))
    return ElbowCircle(bend, (a, b), tuple(u), tuple(across / np.linalg.norm(across)), axes)


SINGULAR = {
    "upright": np.zeros(7),
    "upright and turned": np.radians([30, 0, 20, 0, 40, 0, -60]),
    "straight arm": np.radians([20, 50, 30, 0, 40, 60, 70]),
    "joint 2 at zero": np.radians([20, 0, 30, -70, 40, 60, 70]),
    "joint 6 at zero": np.radians([20, 40, 30, -70, 40, 0, 70]),
    "joints 2 and 6 at zero": np.radians([20, 0, 30, -70, 40, 0, 70]),
    "wrist above the shoulder": np.radians([20, 45, 30, 90, 10, -45, 70]),
    "all shared turns near their ends": np.radians([169, 0, 169, 0, 169, 0, 174]),
    "almost joint 2 at zero": np.array([0.3, -1e-7, -0.2, -1.0, 0.1, 1e-7, 0.4]),
}


@arms
@pytest.mark.parametrize("q", SINGULAR.values(), ids=SINGULAR.keys())
def test_singular_poses(arm, q):
    T = arm.forward(q)
    result = arm.inverse(T, q)
    check(arm, result, T)
    np.testing.assert_allclose(result.q, q, atol=1e-6)
    check(arm, arm.inverse(T, HOME), T)
    rng = np.random.default_rng(4)
    for _ in range(20):
        T = arm.forward(q * 0.99 + 1e-3 * rng.normal(size=7))
        check(arm, arm.inverse(T, q), T)


@arms
@pytest.mark.parametrize("tiny", [1e-5, 1e-7, 1e-8, 1e-9, 1e-11, 1e-13, 1e-16])
def test_almost_upright(arm, tiny):
    """Where the pose hardly tells how joints 1, 3, 5 and 7 share their sum, it is reached all the same."""
    q = np.array([0.3, tiny, -0.2, tiny, 0.1, tiny, 0.4])
    T = arm.forward(q)
    check(arm, arm.inverse(T, q), T)


def smooth(rng, steps, size, count=3):
    """A smooth closed path from zero, shape (steps, count), about `size` wide."""
    t = np.linspace(0.0, 1.0, steps)[:, None]
    waves = (rng.normal(size=count) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6, count)) / f for f in (1, 2, 3))
    path = size * sum(waves)
    return path - path[0]


@arms
@settings(max_examples=12)
@given(st.integers(0, 2**32 - 1))
@example(60161)
def test_smooth_paths_are_followed_without_a_flip(arm, seed):
    """As a hand moves the tool: up to 0.5 m and 30 deg about home, some of it out of reach.

    Except next to the ends of their ranges, no joint moves much farther than the step of the tool asks for. Beside a
    zero of joint 2 or 6 its two neighbours turn about almost one axis and may turn against each other.
    """
    rng = np.random.default_rng(seed)
    T_home = arm.forward(HOME)
    positions, rotations = smooth(rng, 400, 0.12), smooth(rng, 400, 0.2)
    q, T_before = HOME, T_home
    followed, lost = 0, False
    for p, r in zip(positions, rotations):
        T = pose(T_home[:3, :3] @ pin.exp3(r), T_home[:3, 3] + p)
        result = arm.inverse(T, q, keep_branch=True)
        if result.q is not None:
            check(arm, result, T)
            if not lost:
                step = joint_step(q, result.q)
                if result.branch != Branch.of(q):
                    assert step < np.radians(25.0), "the branch may change through a zero only"
                if min(room(arm, q), room(arm, result.q)) > np.radians(5.0):
                    assert step < 5.0 * np.abs(least_joint_step(arm, q, T_before, T)).max() + np.radians(0.1)
            followed += 1
            q = result.q
        lost, T_before = result.q is None, T
    assert followed > 0


def joint_step(q, q_next):
    """The largest step of a joint [rad]; two neighbours of a joint that is near zero count by their sum."""
    step = q_next - q
    for joint in (1, 5):
        if min(abs(q[joint]), abs(q_next[joint])) < np.radians(5.0):
            step[joint - 1], step[joint + 1] = step[joint - 1] + step[joint + 1], 0.0
    return np.abs(step).max()


def room(arm, q):
    """How far the joints are from the ends of their ranges [rad]; where one is at an end the others make room."""
    return np.minimum(q - arm.model.lower, arm.model.upper - q).min()


def least_joint_step(arm, q, T_before, T):
    """The smallest joint step, shape (7,) [rad], that a small step of the tool asks for."""
    turn = T_before[:3, :3] @ pin.log3(T_before[:3, :3].T @ T[:3, :3])
    return np.linalg.pinv(arm.jacobian(q)) @ np.concatenate([T[:3, 3] - T_before[:3, 3], turn])


def test_tool_passes_the_place_where_joint_2_is_zero():
    """High and near, with the tool tilted, joint 2 goes through zero and back, off the arm's plane; nothing races."""
    arm = ARMS[0]
    start = np.radians([-45.0, 12.0, 2.0, -85.0, 5.0, 80.0, 0.0])
    T_start, T_end = arm.forward(start), arm.forward(start + np.radians([4.0, -24.0, 0.0, 0.0, 3.0, 0.0, 0.0]))
    way = pin.log6(np.linalg.inv(T_start) @ T_end)
    q, lowest = start, start[1]
    for s in (1.0 - np.cos(np.linspace(0.0, 2 * np.pi, 1000))) / 2.0:
        T = T_start @ pin.exp6(s * way.vector).homogeneous
        result = arm.inverse(T, q, keep_branch=True)
        check(arm, result, T)
        assert np.abs(result.q - q).max() < np.radians(0.5)
        q, lowest = result.q, min(lowest, result.q[1])
    assert lowest < np.radians(-5.0)
    np.testing.assert_allclose(q, start, atol=np.radians(15.0))


def wiggled(arm, q, steps, size=0.02):
    """The last result after the tool of an arm at joints q moved about in circles of radius `size` [m]."""
    T = arm.forward(q)
    for i in range(steps):
        T_moved = translation(0.0, size * np.sin(i / 20.0), size * np.cos(i / 20.0)) @ T
        result = arm.inverse(T_moved, q, keep_branch=True)
        q = result.q
    return result


@arms
def test_elbow_goes_back_to_its_preference_while_the_tool_moves(arm):
    q = HOME + np.radians([0.0, 0.0, 25.0, 0.0, -20.0, 0.0, 0.0])
    assert abs(arm.inverse(arm.forward(q), q).arm_angle) > 0.2
    assert abs(wiggled(arm, q, 2000).arm_angle) < 0.02


@arms
def test_arm_stays_in_its_plane_when_the_tool_goes_sideways(arm):
    q, T, highest = HOME, arm.forward(HOME), 0.0
    for turn in 0.4 * np.sin(np.linspace(0.0, 6.0, 300)):
        result = arm.inverse(pose(rotation_about(2, turn)) @ T, q)
        q, highest = result.q, max(highest, abs(result.arm_angle))
    assert highest < np.radians(0.7)


def test_preference_gives_way_before_the_end_of_a_range():
    arm = Kinematics(ARMS[0].model, TOOL, elbow_preference=0.6)
    q = np.radians([-45.0, 60.0, 20.0, -60.0, -40.0, 114.0, 0.0])
    result = wiggled(arm, q, 1500, size=0.01)
    assert result.q[5] < np.radians(117.0)
    assert result.arm_angle > ARMS[0].inverse(ARMS[0].forward(q), q).arm_angle


def test_elbow_is_not_wound_up_to_go_back_to_its_preference():
    """With the elbow up joint 2 would be negative; while it is positive, up means joints 1 and 3 near their ends."""
    arm = ARMS[0]
    T = arm.forward(np.radians([-45.0, -8.0, 0.0, -90.0, 0.0, 75.0, 0.0]))
    q = arm.inverse(T, np.radians([-105.0, 20.0, 60.0, -90.0, 0.0, 75.0, 0.0]), keep_branch=True).q
    assert q[1] > 0.0 and q[0] > np.radians(-130.0)
    assert wiggled(arm, q, 1500).q[0] > np.radians(-145.0)


def test_arm_that_was_stretched_out_bends_the_way_it_did():
    arm = ARMS[0]
    q = np.radians([20.0, 50.0, 10.0, -20.0, 40.0, 60.0, 70.0])
    straight = q * [1, 1, 1, 0, 1, 1, 1]
    T, T_straight = arm.forward(q), arm.forward(straight)
    shoulder = np.array([0.0, 0.0, arm.model.base_shoulder])
    wrist = (T_straight @ np.linalg.inv(TOOL))[:3, 3] - arm.model.wrist_flange * T_straight[:3, 2]
    rounding = 5e-11 * (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
    out = arm.inverse(pose(p=rounding) @ T_straight, q).q
    assert out[3] == 0.0
    back = arm.inverse(T, out).q
    assert back[3] == pytest.approx(q[3], abs=1e-9)


def test_target_along_the_axis_of_the_present_joint_4():
    """The present elbow says nothing about where the elbow is to be."""
    arm = Kinematics(ARMS[0].model)
    seed = np.array([0.0, 0.5, 0.0, -1.0, 0.0, 0.6, 0.0])
    T = pose(p=(0.0, 0.6 + arm.model.wrist_flange, arm.model.base_shoulder))
    T[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    check(arm, arm.inverse(T, seed), T)


@pytest.mark.parametrize("turn", [-2.0, 0.0, 0.5])
def test_arm_angle_counts_from_base_x_where_the_wrist_is_above_the_shoulder(turn):
    arm = ARMS[0]
    q = np.array([turn, -np.radians(40.0), 0.0, -np.radians(80.0), 0.0, np.radians(30.0), 0.0])
    # Upper arm and forearm are equally long: with joint 2 at half of joint 4 the wrist is above the shoulder.
    expected = (turn + np.pi + np.pi) % (2 * np.pi) - np.pi
    assert arm.inverse(arm.forward(q), q).arm_angle == pytest.approx(expected, abs=1e-6)


def test_arm_angle_is_zero_with_the_elbow_up_and_turns_about_the_line_to_the_wrist():
    arm = ARMS[0]
    assert arm.inverse(arm.forward(HOME), HOME).arm_angle == pytest.approx(0.0, abs=1e-9)
    q = HOME + np.radians([0.0, 0.0, 20.0, 0.0, 0.0, 0.0, 0.0])
    shoulder = np.array([0.0, 0.0, arm.model.base_shoulder])
    T = arm.forward(q)
    wrist = T[:3, 3] - (arm.model.wrist_flange + 0.106) * T[:3, 2]
    elbow = shoulder + arm.model.shoulder_elbow * np.array(
        [np.sin(q[1]) * np.cos(q[0]), np.sin(q[1]) * np.sin(q[0]), np.cos(q[1])]
    )
    u = (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
    up, out = np.cross(u, np.cross([0.0, 0.0, 1.0], u)), np.cross(u, np.cross(elbow - shoulder, u))
    expected = np.arctan2(np.cross(up, out) @ u, up @ out)
    assert arm.inverse(T, q).arm_angle == pytest.approx(expected, abs=1e-9)


@arms
def test_out_of_reach_is_named(arm):
    R = arm.forward(HOME)[:3, :3]
    assert arm.inverse(pose(R, (2.0, 0.0, 0.5)), HOME).failure == IkFailure.TOO_FAR
    down = pose(rotation_about(0, np.pi))
    folded = pose(p=(0.0, 0.0, arm.model.base_shoulder + 0.05)) @ down
    T_wrist_tool = translation(0.0, 0.0, arm.model.wrist_flange) @ arm.T_flange_tool
    assert arm.inverse(folded @ T_wrist_tool, HOME).failure == IkFailure.TOO_NEAR
    assert arm.inverse(pose(p=(0.0, 0.0, arm.model.base_shoulder)) @ T_wrist_tool, HOME).failure == IkFailure.TOO_NEAR
    # The flange looks back along the outstretched forearm: joint 6 would be at 180 deg.
    out = arm.model.shoulder_elbow + arm.model.elbow_wrist - 1e-6
    back = pose(rotation_about(1, -np.pi / 2), (out, 0.0, arm.model.base_shoulder)) @ T_wrist_tool
    result = arm.inverse(back, HOME)
    assert result.failure == IkFailure.NO_ARM_ANGLE
    assert result.q is None
    assert str(result.failure).startswith("The tool pose is out of reach")


@arms
def test_just_beyond_and_just_within_the_outstretched_arm(arm):
    T = arm.forward(np.radians([20, 50, 30, 0, 40, 60, 70]))
    u = T[:3, :3] @ np.linalg.inv(arm.T_flange_tool)[:3, :3]
    wrist = (T @ np.linalg.inv(arm.T_flange_tool))[:3, 3] - arm.model.wrist_flange * u[:, 2]
    outwards = (wrist - [0.0, 0.0, arm.model.base_shoulder]) / np.linalg.norm(
        wrist - [0.0, 0.0, arm.model.base_shoulder]
    )
    for step in (-1e-3, -1e-6, -1e-9, -1e-12, 0.0, 1e-12):
        moved = pose(p=step * outwards) @ T
        check(arm, arm.inverse(moved, HOME), moved)
    assert arm.inverse(pose(p=1e-8 * outwards) @ T, HOME).failure == IkFailure.TOO_FAR


def test_another_branch_is_a_failure_if_it_is_to_be_kept():
    arm = ARMS[0]
    refused = kept = 0
    for q in random_joints(arm, 500, seed=5):
        T = arm.forward(q)
        result = arm.inverse(T, HOME, keep_branch=True)
        if result.q is None:
            assert result.failure == IkFailure.OTHER_BRANCH
            check(arm, arm.inverse(T, HOME), T)
            refused += 1
        else:
            assert result.branch == Branch.of(HOME)
            kept += 1
    assert refused > 0 and kept > 0


def test_measured_joints_may_be_a_little_out_of_range():
    arm = ARMS[0]
    q = arm.model.upper * np.array([1, 0.3, 1, 0.5, 1, 0.5, 1]) + 1e-4
    T = arm.forward(np.minimum(q, arm.model.upper))
    check(arm, arm.inverse(T, q), T)


@pytest.mark.parametrize(
    "T",
    [
        np.full((4, 4), np.nan),
        np.diag([1.0, 1.0, -1.0, 1.0]),
        np.diag([1.1, 1.0, 1.0, 1.0]),
        np.eye(3),
        pose(p=(np.inf, 0.0, 0.0)),
    ],
)
def test_what_is_no_pose_is_refused(T):
    with pytest.raises(ValueError):
        ARMS[0].inverse(T, HOME)


@pytest.mark.parametrize("seed", [np.full(7, np.nan), np.zeros(6)])
def test_present_joints_must_be_seven_numbers(seed):
    with pytest.raises(ValueError, match="seven finite"):
        ARMS[0].inverse(ARMS[0].forward(HOME), seed)


def test_result_cannot_be_changed():
    result = ARMS[0].inverse(ARMS[0].forward(HOME), HOME)
    with pytest.raises(ValueError, match="read-only"):
        result.q[0] = 0.0
