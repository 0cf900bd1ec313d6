"""The text of a frame, written by template, against the plain way: a dictionary of numbers with six digits, as JSON."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

from common.rotations import rotation_about
from rig_simulation.devices.leap import wire
from rig_simulation.devices.leap.sensing import ReportedHand
from rig_simulation.operator.hand_model import HandGeometry, HandModel, HandPose, extended, pinch_strength

MODELS = {
    (side, fields): HandModel(side, 1.05, fields == "new") for side in ("right", "left") for fields in ("2.x", "new")
}
SPECIAL = [0.0, -0.0, 1.0, -20.0, 9999.9951, 12345.65, 1e-5, 0.0001, -3e-7, 1.19209289e-07]


def any_hand(rng, fields):
    """A hand of random numbers of every size below ten thousand, some of them round."""

    def numbers(*shape):
        values = rng.choice([-1.0, 1.0], shape) * 10.0 ** rng.uniform(-9.0, 4.0, shape)
        return np.where(rng.random(shape) < 0.3, rng.choice(SPECIAL, shape), values)

    bones = numbers(5, 5, 3), numbers(5, 4, 3, 3), numbers(5, 3)
    geometry = HandGeometry(numbers(3), numbers(3), numbers(3), *bones, numbers(3), numbers(3), numbers(3, 3))
    model = MODELS[rng.choice(["right", "left"]), fields]
    filtered = numbers(3), numbers(5, 3), numbers(3), numbers(5, 3)
    flexion, scalars = rng.uniform(-0.5, 2.0, (5, 3)), rng.uniform(0.0, 1.0, 2).tolist()
    return ReportedHand(int(rng.integers(1, 5000)), model, geometry, flexion, *scalars, *filtered)


def plain_frame(hands, rate, fields, order):
    message = {
        "currentFrameRate": wire.six(rate),
        "hands": [plain_hand(hand, fields) for hand in hands],
        "pointables": [plain_finger(hand, i, fields) for hand in hands for i in order],
    }
    if fields == "new":
        return {**message, "devices": []}
    return {**message, **wire.MOTION_FACTORS, "gestures": [], "interactionBox": wire.BOX}


def plain_hand(hand, fields):
    g, six = hand.geometry, wire.six
    message = {
        "armBasis": six(g.arm_basis),
        "armWidth": six(hand.model.arm_width),
        "confidence": six(hand.confidence),
        "direction": six(g.direction),
        "elbow": six(g.elbow),
        "grabStrength": six(hand.grab),
        "id": hand.id,
        "palmNormal": six(g.normal),
        "palmPosition": six(g.palm),
        "palmVelocity": six(hand.velocity),
        "palmWidth": six(hand.model.palm_width),
        "pinchStrength": six(pinch_strength(g.tips)),
        "timeVisible": six(hand.time_visible),
        "type": hand.model.side,
        "wrist": six(g.wrist),
    }
    if fields == "new":
        angle = min(float(hand.flexion[1:].sum(axis=1).mean()), np.pi)
        return {**message, "grabAngle": six(angle), "pinchDistance": six(np.linalg.norm(g.tips[0] - g.tips[1]))}
    radius = 60.0 - 25.0 * hand.grab
    sphere = {"sphereCenter": six(g.palm + radius * g.normal), "sphereRadius": six(radius)}
    return {**message, **wire.MOTION_FACTORS, **sphere, "stabilizedPalmPosition": six(hand.stable_palm)}


def plain_finger(hand, i, fields):
    g, six = hand.geometry, wire.six
    carp, mcp, pip, dip, btip = six(g.joints[i])
    bases = six(g.bases[i])
    message = {
        "bases": bases,
        "btipPosition": btip,
        "carpPosition": carp,
        "dipPosition": dip,
        "direction": [-v for v in bases[2][2]],
        "extended": extended(hand.flexion)[i],
        "handId": hand.id,
        "id": 10 * hand.id + i,
        "length": six(hand.model.finger_lengths[i]),
        "mcpPosition": mcp,
        "pipPosition": pip,
        "timeVisible": six(hand.time_visible),
        "tipPosition": six(g.tips[i]),
        "type": i,
        "width": six(hand.model.finger_widths[i]),
    }
    if fields == "new":
        return message
    stable = {"stabilizedTipPosition": six(hand.stable_tips[i]), "tipVelocity": six(hand.tip_velocities[i])}
    return {**message, **stable, "tool": False, "touchDistance": 1, "touchZone": "none"}


@pytest.mark.parametrize("fields", wire.FIELD_SETS)
@given(seed=st.integers(0, 2**32), count=st.integers(0, 2))
def test_a_frame_is_written_as_json_writes_it(fields, seed, count):
    rng = np.random.default_rng(seed)
    seen = [any_hand(rng, fields) for _ in range(count)]
    order, number, stamp = rng.permutation(5).tolist(), int(rng.integers(1, 10**9)), 10**6
    frame = wire.frame(seen, 115.3, fields, order)
    assert frame.text(number, stamp) == wire.text(
        {**plain_frame(seen, 115.3, fields, order), "id": number, "timestamp": stamp}
    )
    assert frame.hand_id == max((hand.id for hand in seen), default=0)


@pytest.mark.parametrize("name", ["palm", "tips", "bases"])
@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_a_number_that_is_not_finite_is_refused(name, number):
    hand = any_hand(np.random.default_rng(0), "2.x")
    getattr(hand.geometry, name).flat[0] = number
    with pytest.raises(ValueError):
        wire.frame([hand], 115.3, "2.x")


def test_a_recorded_frame_keeps_its_order_and_gets_its_own_numbers():
    recorded = {"timestamp": 5, "hands": [{"id": 3}], "id": 3, "pointables": [{"handId": 3, "id": 30}]}
    frame = wire.frame_from(recorded)
    assert frame.text(7, 8) == wire.text({**recorded, "timestamp": 8, "id": 7})
    assert json.loads(frame.with_ids(4).text(7, 8)) == wire.with_ids({**recorded, "timestamp": 8, "id": 7}, 4)
    assert (frame.hand_id, frame.with_ids(4).hand_id) == (3, 7)


angles = st.floats(-1.5, 1.5)


@given(arrays(float, (5, 3), elements=angles), arrays(float, 5, elements=angles), st.sampled_from([*MODELS.values()]))
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
