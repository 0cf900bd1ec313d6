"""Grasps in six degrees of freedom: opposed contacts, a free way, and the physics that judges them."""

from __future__ import annotations

import numpy as np
import pytest

from common.lift_trial import COLLISION
from grasping.lab.evaluation.lifting import lift
from grasping.lab.synthetic import scene, shapes
from grasping.lab.synthetic.full_poses import PoseSampler
from grasping.lab.synthetic.shapes import Geom
from grasping.poses.gripper import GRIPPER
from grasping.poses.hypotheses import MAX_TILT_RAD

BAR = (Geom("box", (0.06, 0.015, 0.02)),)
LYING = np.array([0.0, 0.0, 0.02, 1.0, 0.0, 0.0, 0.0])


def bar_scene(fixed: shapes.Shape = ()) -> scene.HeapScene:
    return scene.HeapScene(scene.world_xml((BAR,), fixed=fixed), LYING, (BAR,), ("box",), fixed)


def sampled(of: scene.HeapScene, tries: int, max_tilt: float = MAX_TILT_RAD, target: int = 0):
    return list(PoseSampler(of, GRIPPER).free(np.random.default_rng(5), target, tries, max_tilt))


def tips(candidate):
    """Returns the middles of both pads' lower edges when the hand has come down."""
    T = candidate.T_world_grasp
    middle = T[:3, 3] + GRIPPER.reach * T[:3, 2]
    return [middle + side * 0.5 * candidate.opening * T[:3, 0] for side in (-1.0, 1.0)]


def test_a_bar_is_held_by_its_long_faces_only():
    """Its ends are 12 cm apart, which the gripper does not span."""
    found = sampled(bar_scene(), 600)
    assert len(found) > 40
    for candidate in found:
        T = candidate.T_world_grasp
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
        assert np.linalg.det(T[:3, :3]) > 0.0
        assert candidate.tilt <= MAX_TILT_RAD + 1e-9
        assert 0.03 <= candidate.opening <= GRIPPER.opening
        assert candidate.steep <= np.arctan(GRIPPER.friction)
        assert abs(T[1, 0]) > 0.7, "across the bar"
        for tip in tips(candidate):
            assert tip[2] > -1e-6, "above the table"
            assert abs(tip[1]) > 0.014, "outside the bar"
    assert max(candidate.tilt for candidate in found) > 0.5
    assert min(candidate.tilt for candidate in found) < 0.2


def test_the_same_numbers_are_the_same_grasps():
    first, second = (sampled(bar_scene(), 60) for _ in range(2))
    assert len(first) == len(second) > 0
    for a, b in zip(first, second):
        np.testing.assert_array_equal(a.T_world_grasp, b.T_world_grasp)


def test_from_above_means_from_above():
    found = sampled(bar_scene(), 200, max_tilt=0.1)
    assert found and max(candidate.tilt for candidate in found) <= 0.1


def test_a_wall_leaves_no_room_for_the_finger_behind():
    """A wall along one long face, one centimetre away: the finger is 8 mm thick and opens 5 mm wider than the bar."""
    wall = Geom("box", (0.08, 0.004, 0.06), (0.0, 0.015 + 0.01 + 0.004, 0.06))
    assert not sampled(bar_scene((wall,)), 300)


@pytest.mark.parametrize("seed", range(3))
def test_the_hand_reaches_what_was_called_free(seed):
    """Its way is judged at three places; the physics moves it all along."""
    rng, settled = np.random.default_rng(seed), None
    while settled is None:
        settled = scene.settled_scene(rng, (shapes.box, shapes.bottle, shapes.tee), 3)
    sampler = PoseSampler(settled, GRIPPER)
    found = [one for target in range(3) for one in list(sampler.free(rng, target, 150, MAX_TILT_RAD))[:2]]
    assert found
    for one in found:
        reason = lift(settled, one.T_world_grasp, one.opening, GRIPPER, 0.6).reason
        assert reason != COLLISION


def test_a_hand_in_free_air_touches_nothing():
    """Palm and fingers meet one another."""
    sampler = PoseSampler(bar_scene(), GRIPPER)
    for one in sampled(bar_scene(), 300):
        high = one.T_world_grasp.copy()
        high[2, 3] += 1.0
        assert not sampler.touches(one._replace(T_world_grasp=high))


def test_a_tilted_grasp_lifts_the_bar():
    tilted = [one for one in sampled(bar_scene(), 300) if one.tilt > 0.4][:3]
    assert len(tilted) == 3
    assert all(lift(bar_scene(), one.T_world_grasp, one.opening, GRIPPER, 0.6, 0, True).lifted for one in tilted)


def test_what_stands_fast_stops_the_hand_that_lifts():
    """The same grasp with and without a wall in its way."""
    one = next(each for each in sampled(bar_scene(), 300) if each.tilt < 0.2)
    side = np.sign(one.T_world_grasp[1, 0]) * 0.5 * (one.opening + GRIPPER.thickness)
    x, y, _ = one.T_world_grasp[:3, 3] + side * one.T_world_grasp[:3, 0]
    wall = Geom("box", (0.08, 0.004, 0.03), (float(x), float(y), 0.03))
    assert lift(bar_scene(), one.T_world_grasp, one.opening, GRIPPER, 0.6, 0).reached
    assert not lift(bar_scene((wall,)), one.T_world_grasp, one.opening, GRIPPER, 0.6, 0).reached
