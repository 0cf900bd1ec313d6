"""Laws of the simulated hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

from common.rotations import rotation_about
from rig_simulation.devices.leap.sensing import at_rest
from rig_simulation.operator.hand_model import BONE_LENGTHS_MM, HandModel, HandPose, fingers_for

angles = st.floats(-0.9, 0.9)
hinges = st.floats(-1.5, 1.5)
models = st.builds(HandModel, st.sampled_from(["right", "left"]), st.floats(0.9, 1.2), st.booleans())


@st.composite
def poses(draw):
    palm = np.array([draw(st.floats(-300, 300)) for _ in range(3)])
    flexion = np.array([[draw(st.floats(-0.2, 1.6)) for _ in range(3)] for _ in range(5)])
    spread = np.array([draw(st.floats(-0.7, 0.7)) for _ in range(5)])
    return HandPose(palm, draw(angles), draw(angles), draw(angles), flexion, spread)


def flat(curl=0.0, **angles):
    flexion, spread = fingers_for(curl)
    return HandPose(np.zeros(3), **{"pitch": 0.0, "yaw": 0.0, "roll": 0.0, **angles}, flexion=flexion, spread=spread)


@given(models, poses())
def test_axes_are_orthonormal_and_mirrored_on_a_left_hand(model, pose):
    hand = model.place(pose)
    axes = np.concatenate([hand.bases.reshape(20, 3, 3), hand.arm_basis[None]])
    assert_allclose(axes @ axes.swapaxes(-1, -2), np.broadcast_to(np.eye(3), axes.shape), atol=1e-9)
    assert_allclose(np.linalg.det(axes), -1.0 if model.side == "left" else 1.0)
    assert_allclose([hand.direction @ hand.direction, hand.normal @ hand.normal], [1.0, 1.0])
    assert_allclose(hand.direction @ hand.normal, 0.0, atol=1e-12)


@given(models, poses())
def test_bones_have_the_lengths_of_the_template_and_lie_along_their_axes(model, pose):
    hand = model.place(pose)
    bones = hand.joints[:, :-1] - hand.joints[:, 1:]
    lengths = np.linalg.norm(bones, axis=-1)
    expected = BONE_LENGTHS_MM * model.scale * ([1, 1, 1, 0.77] if model.ends_at_tip else 1)
    assert_allclose(lengths, expected, atol=0.01)
    assert_allclose(lengths[:, 1:], expected[:, 1:], atol=1e-9)
    assert_allclose(hand.bases[:, :, 2] * lengths[..., None], bones, atol=1e-9)
    assert lengths[0, 0] == 0.0
    shared = hand.bases[:, 1:, 0]
    assert_allclose(shared, np.broadcast_to(shared[:, :1], shared.shape), atol=1e-9)


@given(models, poses())
def test_the_hand_has_the_angles_it_was_given(model, pose):
    hand = model.place(pose)
    d, n = hand.direction, hand.normal
    assert_allclose(np.arctan2(d[1], -d[2]), pose.pitch, atol=1e-9)
    assert_allclose(np.arctan2(d[0], -d[2]), pose.yaw, atol=1e-9)
    assert_allclose(np.arctan2(n[0], -n[1]), pose.roll, atol=1e-9)


@given(poses(), st.floats(0.9, 1.2))
def test_a_left_hand_is_the_mirror_image_of_a_right_one(pose, scale):
    mirrored = HandPose(pose.palm * [-1, 1, 1], pose.pitch, -pose.yaw, -pose.roll, pose.flexion, pose.spread)
    right, left = HandModel("right", scale).place(pose), HandModel("left", scale).place(mirrored)
    for a, b in ((right.joints, left.joints), (right.tips, left.tips), (right.elbow, left.elbow)):
        assert_allclose(a * [-1, 1, 1], b, atol=1e-9)


@given(models, poses())
def test_the_hand_is_rigid(model, pose):
    """Wherever the hand is, its joints have the same place in palm axes."""
    hand = model.place(pose)
    still = model.place(HandPose(np.zeros(3), 0.0, 0.0, 0.0, pose.flexion, pose.spread))
    axes, still_axes = hand.arm_basis, still.arm_basis
    assert_allclose((hand.joints - hand.palm) @ axes.T, still.joints @ still_axes.T, atol=1e-9)


def test_directions_of_a_flat_right_hand():
    hand = HandModel("right").place(flat())
    assert_allclose(hand.direction, [0, 0, -1], atol=1e-12)
    assert_allclose(hand.normal, [0, -1, 0], atol=1e-12)
    assert hand.joints[1, 1, 0] < hand.joints[4, 1, 0], "the index is left of the pinky"
    assert hand.joints[0, 4, 0] < hand.joints[1, 1, 0], "the thumb is left of the index"
    assert hand.joints[2, 4, 2] < hand.joints[2, 1, 2] < hand.joints[2, 0, 2], "fingers point to -z"
    assert hand.elbow[2] > hand.wrist[2] > 0.0
    assert HandModel("right").place(flat(curl=1.0)).tips[2, 1] < hand.tips[2, 1], "fingers curl to the palm's side"


def test_the_tip_lies_on_the_last_bone():
    old, new = (HandModel("right", ends_at_tip=ends).place(flat(0.3)) for ends in (False, True))
    assert_allclose(new.tips, new.joints[:, 4])
    assert_allclose(old.tips, old.joints[:, 3] + 0.77 * (old.joints[:, 4] - old.joints[:, 3]))
    assert_allclose(old.tips, new.tips)


def test_strengths_between_open_hand_and_fist():
    hands = [at_rest(1, HandModel(), flat(curl), 1.0, 0.0) for curl in np.linspace(0.0, 1.0, 11)]
    strengths = [(hand.grab, hand.pinch) for hand in hands]
    grab = [strength[0] for strength in strengths]
    assert (grab[0], grab[-1]) == (0.0, 1.0)
    assert grab == sorted(grab)
    assert strengths[0][1] == 0.0
    assert max(strength[1] for strength in strengths) > 0.8
    assert hands[0].extended == (True,) * 5
    assert hands[-1].extended == (False,) * 5


def test_only_right_and_left_hands_exist():
    with pytest.raises(ValueError):
        HandModel("middle")


@given(arrays(float, (5, 3), elements=hinges), arrays(float, 5, elements=hinges), models)
def test_bones_turn_hinge_by_hinge(flexion, spread, model):
    hand = model.place(HandPose(np.zeros(3), 0.1, -0.2, 0.3, flexion, spread))
    axes = np.array(hand.arm_basis).T
    for finger in range(5):
        R = rotation_about(1, -spread[finger])
        if finger == 0:
            R = R @ rotation_about(2, np.radians(45.0))
        for hinge in range(3):
            R = R @ rotation_about(0, -flexion[finger, hinge])
            assert_allclose(hand.bases[finger, hinge + 1], (axes @ R).T, atol=1e-12)
