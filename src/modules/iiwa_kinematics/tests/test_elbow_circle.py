"""The self-motion of the arm: every angle, every branch, against forward kinematics and against the joint ranges."""

from __future__ import annotations

import math

import numpy as np
import pytest

from common.rotations import unit
from iiwa_kinematics import Branch, forward
from iiwa_kinematics.arcs import TURN
from iiwa_kinematics.elbow_circle import BRANCHES, ElbowCircle, Limits
from iiwa_kinematics.robot_model import robot_model

MODELS = [robot_model("LBR7R800", "MF_elektrisch"), robot_model("LBR14R820", "MF_touch_pneumatisch")]
ANGLES = np.linspace(-math.pi, math.pi, 73)


def circle_of(model, q, rng):
    """The circle of the pose at joints q, from a reference direction that has nothing to do with q."""
    T = forward(model, q)
    u = unit(T[:3, 3] - model.wrist_flange * T[:3, 2] - [0.0, 0.0, model.base_shoulder])
    reference = unit(np.cross(u, unit(rng.normal(size=3))))
    lengths = (model.shoulder_elbow, model.elbow_wrist)
    flange = tuple(tuple(column) for column in T[:3, :3].T)
    return T, ElbowCircle(abs(q[3]), lengths, tuple(u), tuple(reference), flange)


def random_circles(model, count, seed):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield circle_of(model, rng.uniform(model.lower, model.upper), rng)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_every_angle_in_every_branch_keeps_the_flange(model):
    limits = Limits(model.lower, model.upper)
    for T, circle in random_circles(model, 10, seed=1):
        for branch in BRANCHES:
            for angle in ANGLES[::6]:
                q = circle.joints(angle, branch, [0.0] * 7, limits)
                np.testing.assert_allclose(forward(model, q), T, atol=1e-9)
                assert Branch.of(q) == branch


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
@pytest.mark.parametrize("margin, least_bend", [(0.0, 0.0), (0.3, 0.2)])
def test_free_intervals_are_where_the_joints_are_in_range(model, margin, least_bend):
    lower, upper = model.lower + margin, model.upper - margin
    limits = Limits(lower, upper, least_bend)
    checked = 0
    for _, circle in random_circles(model, 25, seed=2):
        for branch in BRANCHES:
            intervals = circle.free(branch, limits)
            for angle in ANGLES:
                q = np.array(circle.joints(angle, branch, [0.0] * 7, limits))
                slack = np.minimum(q - lower, upper - q)[[0, 1, 2, 4, 5, 6]]
                slack = np.append(slack, np.abs(q[[1, 5]]) - least_bend)
                if abs(slack.min()) < 1e-6:
                    continue
                free = any((angle - low) % TURN <= high - low for low, high in intervals)
                assert free == (slack.min() > 0.0)
                checked += free
    assert checked > 1000


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_self_motion_is_the_derivative(model):
    limits = Limits(model.lower, model.upper)
    for _, circle in random_circles(model, 20, seed=3):
        for branch in BRANCHES:
            angle, h = 0.7, 1e-6
            before, q, after = (circle.joints(angle + d, branch, [0.0] * 7, limits) for d in (-h, 0.0, h))
            if min(abs(math.sin(q[1])), abs(math.sin(q[5]))) < 0.05:
                continue
            change = (np.subtract(after, before) + math.pi) % TURN - math.pi
            np.testing.assert_allclose(circle.self_motion(q), change / (2 * h), atol=1e-5)


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_joint_3_is_held_where_it_can_be(model):
    limits = Limits(model.lower, model.upper)
    rng = np.random.default_rng(4)
    for _ in range(100):
        q = rng.uniform(model.lower, model.upper)
        _, circle = circle_of(model, q, rng)
        angles = circle.keeping_joint_3(q[2], Branch.of(q))
        found = [circle.joints(angle, Branch.of(q), [0.0] * 7, limits) for angle in angles]
        assert min(np.abs(np.subtract(solution, q)).max() for solution in found) < 1e-6
        for angle, solution in zip(angles, found):
            assert abs(solution[2] - q[2]) < 1e-6
            assert circle.cosine_of_joint_3(angle, Branch.of(q)) == pytest.approx(math.cos(q[2]), abs=1e-6)
