"""Laws of the report of a hand that is made from its joints, against hands of the service's own template."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

from leap_motion.codec import read_message
from leap_motion.service import wire
from leap_motion.service.hand import hand_from_joints
from rig_simulation.devices.leap.sensing import at_rest
from rig_simulation.operator.hand_model import HandModel, HandPose, fingers_for

seeds = st.integers(0, 2**32)


def any_hand(seed, curl=None):
    """A report of the service's own hand, in any place and posture."""
    rng = np.random.default_rng(seed)
    flexion, spread = fingers_for(rng.uniform() if curl is None else curl)
    flexion = flexion + rng.uniform(-0.05, 0.05, (5, 3))
    pose = HandPose(rng.uniform(-300, 300, 3), *rng.uniform(-1.2, 1.2, 3), flexion, spread)
    model = HandModel(str(rng.choice(["right", "left"])), rng.uniform(0.8, 1.2))
    return at_rest(int(rng.integers(1, 99)), model, pose, 0.9, 1.5)


def from_joints(hand, **changed):
    given_hand = {"hand_id": hand.id, "side": hand.side, "joints": hand.joints, "wrist": hand.wrist}
    return hand_from_joints(**{**given_hand, "confidence": 0.9, "time_visible": 1.5, **changed})


@given(seeds)
def test_the_services_own_hand_is_found_from_its_joints(seed):
    hand = any_hand(seed)
    found = from_joints(hand)
    assert (found.id, found.side) == (hand.id, hand.side)
    for name in {field.name for field in fields(hand)} - {"id", "side", "bases", "curl", "extended"}:
        assert_allclose(getattr(found, name), getattr(hand, name), atol=1e-6, err_msg=name)
    assert abs(found.curl - hand.curl) < np.radians(6.0)
    assert abs(found.grab - hand.grab) < 0.07 and abs(found.pinch - hand.pinch) < 1e-9
    across = np.degrees(np.arccos(np.clip((found.bases[:, :, 0] * hand.bases[:, :, 0]).sum(axis=-1), -1, 1)))
    assert across[1:].max() < 15.0, "x of the bones"


@given(seeds, st.sampled_from([0.0, 1.0]))
def test_fingers_of_an_open_hand_are_extended_and_those_of_a_fist_are_not(seed, curl):
    assert from_joints(any_hand(seed, curl)).extended == (curl == 0.0,) * 5


@given(seeds, seeds)
def test_a_hand_that_is_moved_and_turned_is_reported_moved_and_turned(seed, motion):
    rng = np.random.default_rng(motion)
    R, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    R[:, 0] *= np.linalg.det(R)
    t = rng.uniform(-300, 300, 3)
    hand = any_hand(seed)
    here, there = from_joints(hand), from_joints(hand, joints=hand.joints @ R.T + t, wrist=R @ hand.wrist + t)
    for name in ("palm", "wrist", "elbow", "tips", "joints"):
        assert_allclose(getattr(there, name), getattr(here, name) @ R.T + t, atol=1e-6)
    for name in ("direction", "normal", "bases", "arm_basis"):
        assert_allclose(getattr(there, name), getattr(here, name) @ R.T, atol=1e-6)
    assert_allclose([there.curl, there.grab, there.palm_width], [here.curl, here.grab, here.palm_width], atol=1e-6)
    assert there.extended == here.extended


@given(seeds)
def test_the_mirror_image_is_a_hand_of_the_other_side(seed):
    hand = any_hand(seed)
    mirror, other = np.array([-1.0, 1.0, 1.0]), {"left": "right", "right": "left"}[hand.side]
    here = from_joints(hand)
    there = from_joints(hand, side=other, joints=hand.joints * mirror, wrist=hand.wrist * mirror)
    for name in ("palm", "direction", "normal", "tips", "elbow", "bases", "arm_basis"):
        assert_allclose(getattr(there, name), getattr(here, name) * mirror, atol=1e-6)
    assert_allclose(np.linalg.det(there.bases), -1.0 if other == "left" else 1.0)


@given(seeds)
def test_a_palm_that_is_measured_flat_has_its_normal_on_the_right_side(seed):
    """Nothing but the sides of thumb and pinky tells palm and back of a flat hand apart."""
    hand, rng = any_hand(seed), np.random.default_rng(seed)
    points = np.vstack([hand.joints[:, 1], hand.wrist])
    height = (points - hand.palm) @ hand.normal
    flat = points - np.outer(height + rng.normal(0.0, 0.3, 6), hand.normal)
    joints = hand.joints.copy()
    joints[:, 1] = flat[:5]
    found = from_joints(hand, joints=joints, wrist=flat[5])
    assert np.degrees(np.arccos(min(found.normal @ hand.normal, 1.0))) < 6.0
    assert_allclose(np.linalg.det(found.arm_basis), -1.0 if hand.side == "left" else 1.0)


@given(seeds, st.sampled_from(wire.SERVICES))
def test_the_driver_reads_the_hand_as_it_was(seed, service):
    hand = from_joints(any_hand(seed))
    frame = read_message(wire.frame([hand], 30.0, service).text(7, 8_000))
    read = frame.hands[0]
    assert not frame.left_out and (read.id, read.side, len(read.fingers)) == (hand.id, hand.side, 5)
    assert_allclose(read.palm, 1e-3 * hand.palm, atol=1e-5)
    assert_allclose(read.normal, hand.normal, atol=1e-4)
    assert_allclose(read.direction, hand.direction, atol=1e-4)
    assert_allclose(read.fingers[1].joints[:4], 1e-3 * hand.joints[1, :4], atol=1e-5)
    assert_allclose(np.linalg.det([finger.rotations for finger in read.fingers]), 1.0, atol=1e-3)


def test_velocities_follow_from_the_frame_before():
    first = from_joints(any_hand(3), time_visible=1.0)
    last, step = first, np.array([3.0, 0.0, 0.0])
    for i in range(1, 40):
        joints, wrist = first.joints + i * step, first.wrist + i * step
        last = from_joints(first, joints=joints, wrist=wrist, time_visible=1.0 + i / 30, before=last)
    assert_allclose(last.velocity, [90.0, 0, 0], atol=1e-3)
    assert_allclose(last.tip_velocities, np.tile([90.0, 0, 0], (5, 1)), atol=1e-3)
    assert_allclose(last.palm - last.stable_palm, [12.0, 0, 0], atol=0.1)
    again = from_joints(first, joints=first.joints + step, wrist=first.wrist + step, time_visible=1.0, before=first)
    assert_allclose(again.velocity, first.velocity), "a frame without a step of time says nothing about the velocity"


GARBAGE = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([0.0, -0.0, 1e-300, 1e300, np.nan, np.inf])
)


@given(
    arrays(float, (5, 5, 3), elements=GARBAGE), arrays(float, 3, elements=GARBAGE), st.sampled_from(["left", "right"])
)
def test_garbage_is_refused_or_gives_a_hand_that_the_driver_takes(joints, wrist, side):
    try:
        hand = hand_from_joints(1, side, joints, wrist, 0.0)
    except ValueError:
        return
    assert not read_message(wire.frame([hand], 30.0).text(1, 1)).left_out


@pytest.mark.parametrize(
    "broken",
    [
        lambda hand: {"side": "middle"},
        lambda hand: {"joints": np.zeros((5, 5, 3))},
        lambda hand: {"joints": 1e-3 * hand.joints, "wrist": 1e-3 * hand.wrist},  # metres
        lambda hand: {"joints": hand.joints[:4]},
        lambda hand: {"confidence": float("nan")},
        lambda hand: {"confidence": 1.1},
        lambda hand: {"time_visible": float("inf")},
        lambda hand: {"joints": np.where(np.arange(5)[:, None, None] == 2, np.nan, hand.joints)},
        lambda hand: {"joints": np.broadcast_to(np.linspace(0, 60, 5)[:, None, None] * [1.0, 0, 0], (5, 5, 3))},
    ],
)
def test_what_no_hand_has_is_refused(broken):
    hand = any_hand(0)
    changed = broken(hand)
    if "joints" in changed and np.ptp(changed["joints"][..., 1]) == 0.0:
        changed["wrist"] = np.zeros(3)
    with pytest.raises(ValueError):
        from_joints(hand, **changed)
