"""Laws of the kinematics of a calibrated arm: right or refused, steady, and as the data sheet if nothing deviates."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.poses import pose, translation
from common.rotations import rotation_about
from iiwa_kinematics import (
    Branch,
    CalibratedKinematics,
    DhParameters,
    IkFailure,
    Kinematics,
    nominal_parameters,
    robot_model,
)

MODELS = [robot_model("LBR7R800", "MF_elektrisch"), robot_model("LBR14R820", "MF_touch_pneumatisch")]
TOOL = pose(rotation_about(0, 0.2), (0.02, -0.01, 0.106))
HOME = np.radians([-45.0, 30.0, 0.0, -65.0, 0.0, 85.0, 0.0])
NONE = np.zeros(28)
models = pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
seeds = st.integers(0, 2**32 - 1)


def deviations(fractions):
    """The deviations that are these fractions, shape (28,) from -1 to 1, of what is plausible: 5 mm and 1 deg."""
    a, alpha, d, theta = np.reshape(fractions, (4, 7))
    return DhParameters(a=5e-3 * a, alpha=np.radians(alpha), d=5e-3 * d, theta=np.radians(theta))


def arm_of(model, fractions):
    return CalibratedKinematics(model, nominal_parameters(model).plus(deviations(fractions)), TOOL)


def random_arm(model, rng, most=1.0):
    return arm_of(model, rng.uniform(-most, most, 28))


def inner_joints(model, rng):
    """Joints in their ranges; joint 4 neither nearly outstretched nor nearly at its end."""
    q = rng.uniform(model.lower, model.upper)
    q[3] = rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(20.0, 110.0))
    return q


def check(arm, result, T):
    assert result.failure is None
    np.testing.assert_allclose(arm.forward(result.q), T, atol=1e-9)
    assert np.all(arm.model.lower <= result.q) and np.all(result.q <= arm.model.upper)
    assert result.branch == Branch.of(result.q)


def turn(axis, angle):
    return pose(rotation_about(axis, angle))


@models
@given(seeds)
def test_forward_kinematics_are_the_product_of_the_table(model, seed):
    rng = np.random.default_rng(seed)
    shares, q = rng.uniform(-1.0, 1.0, 28), rng.uniform(model.lower, model.upper)
    off = deviations(shares)
    d = [model.base_shoulder, 0.0, model.shoulder_elbow, 0.0, model.elbow_wrist, 0.0, model.wrist_flange]
    T = np.eye(4)
    for i, alpha in enumerate((-90.0, 90.0, 90.0, -90.0, -90.0, 90.0, 0.0)):
        T = T @ turn(2, q[i] + off.theta[i])
        T = T @ translation(off.a[i], 0.0, d[i] + off.d[i])
        T = T @ turn(0, np.radians(alpha) + off.alpha[i])
    np.testing.assert_allclose(arm_of(model, shares).forward(q), T @ TOOL, atol=1e-12)


@models
@given(seeds)
def test_the_jacobian_is_the_derivative(model, seed):
    rng = np.random.default_rng(seed)
    arm, q = random_arm(model, rng), rng.uniform(model.lower, model.upper)
    J, R = arm.jacobian(q), arm.forward(q)[:3, :3]
    for i in range(7):
        step = 1e-6 * np.eye(7)[i]
        before, after = arm.forward(q - step), arm.forward(q + step)
        np.testing.assert_allclose((after - before)[:3, 3] / 2e-6, J[:3, i], atol=1e-7)
        np.testing.assert_allclose(pin.log3(before[:3, :3].T @ after[:3, :3]) / 2e-6, R.T @ J[3:, i], atol=1e-7)


@models
@given(seeds)
def test_the_tool_point_is_that_of_the_pose_and_no_point_is_faster_than_its_reach_allows(model, seed):
    rng = np.random.default_rng(seed)
    arm, q = random_arm(model, rng), rng.uniform(model.lower, model.upper)
    point, reaches = arm.tool_point(q.tolist())
    np.testing.assert_allclose(point, arm.forward(q)[:3, 3], atol=1e-12)
    assert np.all(np.array(reaches) >= np.linalg.norm(arm.jacobian(q)[:3], axis=0) - 1e-12)
    tool, reaches = [(*TOOL[:3, 3].tolist(), 0.0)], arm.tool_point(q.tolist(), float(np.linalg.norm(TOOL[:3, 3])))[1]
    for turn, reach in zip(np.eye(7).tolist(), reaches):
        assert arm.fastest_point(tool, q.tolist(), turn) <= reach + 1e-12


@models
@given(seeds)
def test_the_fastest_point_is_the_fastest_of_elbow_wrist_flange_and_tool(model, seed):
    rng = np.random.default_rng(seed)
    arm, q, v = random_arm(model, rng), rng.uniform(model.lower, model.upper), rng.uniform(-2.0, 2.0, 7)

    def points(q):
        frames = arm._parameters.frames(q)
        return np.array([frames[3][:3, 3], frames[5][:3, 3], frames[7][:3, 3], arm.forward(q)[:3, 3]])

    speeds = np.linalg.norm(points(q + 1e-6 * v) - points(q - 1e-6 * v), axis=1) / 2e-6
    fastest = arm.fastest_point([(*TOOL[:3, 3].tolist(), 0.0)], q.tolist(), v.tolist())
    np.testing.assert_allclose(fastest, np.max(speeds), atol=1e-7)


@models
@given(seeds)
def test_without_deviations_it_is_the_arm_of_the_data_sheet(model, seed):
    rng = np.random.default_rng(seed)
    plain, arm = Kinematics(model, TOOL), arm_of(model, NONE)
    q = inner_joints(model, rng)
    near = np.clip(q + rng.uniform(-0.2, 0.2, 7), model.lower, model.upper)  # far away, two ways can be equally good
    np.testing.assert_allclose(arm.forward(q), plain.forward(q), atol=1e-12)
    np.testing.assert_allclose(arm.jacobian(q), plain.jacobian(q), atol=1e-12)
    expected, found = plain.inverse(plain.forward(q), near), arm.inverse(plain.forward(q), near)
    assert found.branch == expected.branch and found.arm_angle == pytest.approx(expected.arm_angle, abs=1e-6)
    np.testing.assert_allclose(found.q, expected.q, atol=1e-6)


@models
@pytest.mark.parametrize("degrees", [0.5, 3.0, 15.0])
@settings(max_examples=12)
@given(seed=seeds)
def test_every_pose_near_the_present_one_is_reached(model, degrees, seed):
    rng = np.random.default_rng(seed)
    arm, q = random_arm(model, rng), inner_joints(model, rng)
    near = np.clip(q + np.radians(rng.uniform(-degrees, degrees, 7)), model.lower, model.upper)
    T = arm.forward(q)
    check(arm, arm.inverse(T, near), T)


@models
def test_poses_all_over_are_reached_from_home_or_refused_but_never_missed(model):
    rng = np.random.default_rng(1)
    refused = 0
    for k in range(200):
        if k % 20 == 0:
            arm = random_arm(model, rng, most=0.4)
        T = arm.forward(rng.uniform(model.lower, model.upper))
        result = arm.inverse(T, HOME)
        if result.q is None:
            assert isinstance(result.failure, IkFailure)
            refused += 1
        else:
            check(arm, result, T)
    assert refused < 20, "outstretched and fully bent arms alone"


@models
@given(seeds)
def test_a_tool_that_stands_still_leaves_the_joints_where_they_are(model, seed):
    rng = np.random.default_rng(seed)
    arm, q = random_arm(model, rng), rng.uniform(model.lower, model.upper)
    T, present = arm.forward(q), q
    for _ in range(5):
        present = arm.inverse(T, present, keep_branch=True).q
    np.testing.assert_allclose(present, q, atol=1e-6)  # an outstretched elbow turns rounding into its square root


@models
@settings(max_examples=4)
@given(seeds)
def test_paths_are_followed_with_small_steps_and_the_elbow_of_the_closed_form(model, seed):
    """As a hand moves the tool; the arm of the data sheet on the same way sets the measure."""
    rng = np.random.default_rng(seed)
    plain, arm = Kinematics(model, TOOL), random_arm(model, rng)
    t = np.linspace(0.0, np.pi, 150)[:, None]
    way = 0.1 * np.sin(t) * rng.normal(size=3) + 0.05 * np.sin(2.0 * t) * rng.normal(size=3)
    tilt = 0.15 * np.sin(t) * rng.normal(size=3)
    T_home = arm.forward(HOME)
    q, q_plain = HOME, plain.inverse(T_home, HOME).q
    least = np.radians([0.0, 0.0, 0.0, 20.0, 0.0, 0.0, 0.0])
    for p, r in zip(way, tilt):
        T = pose(T_home[:3, :3] @ pin.exp3(r), T_home[:3, 3] + p)
        result, expected = arm.inverse(T, q, keep_branch=True), plain.inverse(T, q_plain, keep_branch=True)
        if result.q is None or expected.q is None:
            break
        check(arm, result, T)
        turns = np.abs([result.q, expected.q])
        if np.any(turns < least) or np.any(turns > model.upper - np.radians(5.0)):
            break  # near an end of the reach or of a range both must hurry, and not at the same place
        assert np.abs(result.q - q).max() < 2.0 * np.abs(expected.q - q_plain).max() + np.radians(0.5)
        assert abs(result.arm_angle - expected.arm_angle) < np.radians(6.0)
        q, q_plain = result.q, expected.q
    np.testing.assert_array_less(np.abs(q - HOME), np.pi)


@models
def test_joints_keep_to_their_ranges_where_the_closed_form_is_at_an_end(model):
    """With the joint zeros off, poses with joints at their ends are reached by the other joints, or refused."""
    rng = np.random.default_rng(2)
    reached = 0
    for _ in range(100):
        arm, q = random_arm(model, rng), inner_joints(model, rng)
        joint = rng.choice([0, 1, 2, 4, 5, 6])
        q[joint] = rng.choice([model.lower[joint], model.upper[joint]])
        T = arm.forward(q) @ pose(p=rng.uniform(-0.002, 0.002, 3))
        result = arm.inverse(T, q)
        if result.q is not None:
            check(arm, result, T)
            reached += 1
    assert reached > 60


@models
def test_a_pose_of_joints_at_their_limits_is_reached_from_these_joints(model):
    rng = np.random.default_rng(3)
    for _ in range(200):
        arm, q = random_arm(model, rng, most=0.1), inner_joints(model, rng)
        joints = rng.choice([0, 1, 2, 4, 5, 6], rng.integers(2, 6), replace=False)
        q[joints] = rng.choice([-1.0, 1.0], len(joints)) * model.upper[joints]
        T = arm.forward(q)
        check(arm, arm.inverse(T, q), T)


@models
def test_what_only_the_arm_of_the_data_sheet_reaches_is_refused_by_name(model):
    """Both arms 5 mm shorter: the outstretched one does not come to the end of the reach in the data sheet."""
    shares = np.zeros(28)
    shares[[14 + 2, 14 + 4]] = -1.0
    plain, arm = Kinematics(model, TOOL), arm_of(model, shares)
    T = plain.forward(np.radians([20, 50, 30, -2, 40, 60, 70]))
    for near in (HOME, np.radians([20, 50, 30, -5, 40, 60, 70])):
        result = arm.inverse(T, near)
        assert result.q is None and str(result.failure).startswith("The tool pose is out of reach")
    assert arm.refined(HOME, pose(p=(3.0, 0.0, 0.0))) is None


@pytest.mark.parametrize("T", [np.full((4, 4), np.nan), np.diag([1.0, 1.0, -1.0, 1.0]), np.eye(3)])
def test_what_is_no_pose_is_refused(T):
    with pytest.raises(ValueError):
        arm_of(MODELS[0], NONE).inverse(T, HOME)
