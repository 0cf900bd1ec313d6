"""The text of a frame, written by template, against the plain way: a dictionary of numbers with six digits, as JSON."""

import json

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from leap_motion.service import wire
from leap_motion.service.hand import ReportedHand

SPECIAL = [0.0, -0.0, 1.0, -20.0, 9999.9951, 12345.65, 1e-5, 0.0001, -3e-7, 1.19209289e-07]


def any_hand(rng):
    """A hand of random numbers of every size below ten thousand, some of them round."""

    def numbers(*shape):
        values = rng.choice([-1.0, 1.0], shape) * 10.0 ** rng.uniform(-9.0, 4.0, shape)
        return np.where(rng.random(shape) < 0.3, rng.choice(SPECIAL, shape), values)

    vectors = "palm", "direction", "normal", "wrist", "elbow", "velocity", "stable_palm"
    return ReportedHand(
        id=int(rng.integers(1, 5000)),
        side=str(rng.choice(["right", "left"])),
        confidence=float(rng.random()),
        time_visible=float(rng.random()),
        joints=numbers(5, 5, 3),
        bases=numbers(5, 4, 3, 3),
        arm_basis=numbers(3, 3),
        palm_width=float(numbers()),
        arm_width=float(numbers()),
        lengths=numbers(5),
        widths=numbers(5),
        curl=float(rng.uniform(-0.5, 5.0)),
        extended=tuple(map(bool, rng.integers(0, 2, 5))),
        **{name: numbers(3) for name in vectors},
        **{name: numbers(5, 3) for name in ("tips", "tip_velocities", "stable_tips")},
    )


def plain_frame(hands, rate, order):
    return {
        "currentFrameRate": wire.six(rate),
        "hands": [plain_hand(hand) for hand in hands],
        "pointables": [plain_finger(hand, i) for hand in hands for i in order],
        **wire.MOTION_FACTORS,
        "gestures": [],
        "interactionBox": wire.BOX,
    }


def plain_hand(hand):
    six, radius = wire.six, 60.0 - 25.0 * hand.grab
    return {
        "armBasis": six(hand.arm_basis),
        "armWidth": six(hand.arm_width),
        "confidence": six(hand.confidence),
        "direction": six(hand.direction),
        "elbow": six(hand.elbow),
        "grabStrength": six(hand.grab),
        "id": hand.id,
        "palmNormal": six(hand.normal),
        "palmPosition": six(hand.palm),
        "palmVelocity": six(hand.velocity),
        "palmWidth": six(hand.palm_width),
        "pinchStrength": six(hand.pinch),
        "timeVisible": six(hand.time_visible),
        "type": hand.side,
        "wrist": six(hand.wrist),
        **wire.MOTION_FACTORS,
        "sphereCenter": six(hand.palm + radius * hand.normal),
        "sphereRadius": six(radius),
        "stabilizedPalmPosition": six(hand.stable_palm),
    }


def plain_finger(hand, i):
    six = wire.six
    carp, mcp, pip, dip, btip = six(hand.joints[i])
    bases = six(hand.bases[i])
    return {
        "bases": bases,
        "btipPosition": btip,
        "carpPosition": carp,
        "dipPosition": dip,
        "direction": [-v for v in bases[2][2]],
        "extended": hand.extended[i],
        "handId": hand.id,
        "id": 10 * hand.id + i,
        "length": six(hand.lengths[i]),
        "mcpPosition": mcp,
        "pipPosition": pip,
        "timeVisible": six(hand.time_visible),
        "tipPosition": six(hand.tips[i]),
        "type": i,
        "width": six(hand.widths[i]),
        "stabilizedTipPosition": six(hand.stable_tips[i]),
        "tipVelocity": six(hand.tip_velocities[i]),
        "tool": False,
        "touchDistance": 1,
        "touchZone": "none",
    }


@given(seed=st.integers(0, 2**32), count=st.integers(0, 2))
def test_a_frame_is_written_as_json_writes_it(seed, count):
    rng = np.random.default_rng(seed)
    seen = [any_hand(rng) for _ in range(count)]
    order, number, stamp = rng.permutation(5).tolist(), int(rng.integers(1, 10**9)), 10**6
    frame = wire.frame(seen, 115.3, order=order)
    assert frame.text(number, stamp) == wire.text({**plain_frame(seen, 115.3, order), "id": number, "timestamp": stamp})
    assert frame.hand_id == max((hand.id for hand in seen), default=0)


@pytest.mark.parametrize("service", wire.SERVICES)
@pytest.mark.parametrize("name", ["palm", "tips", "bases"])
@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_a_number_that_is_not_finite_is_refused(service, name, number):
    hand = any_hand(np.random.default_rng(0))
    getattr(hand, name).flat[0] = number
    with pytest.raises(ValueError):
        wire.frame([hand], 115.3, service)
    with pytest.raises(ValueError):
        wire.frame([], number, service)


def test_a_recorded_frame_keeps_its_order_and_gets_its_own_numbers():
    recorded = {"timestamp": 5, "hands": [{"id": 3}], "id": 3, "pointables": [{"handId": 3, "id": 30}]}
    frame = wire.frame_from(recorded)
    assert frame.text(7, 8) == wire.text({**recorded, "timestamp": 8, "id": 7})
    assert json.loads(frame.with_ids(4).text(7, 8)) == wire.with_ids({**recorded, "timestamp": 8, "id": 7}, 4)
    assert (frame.hand_id, frame.with_ids(4).hand_id) == (3, 7)


@pytest.mark.parametrize(
    ("path", "leapd", "gemini"),
    [
        *(("/v6.json", 6, 6), ("/v1.json", 1, None), ("/", 1, None), ("", 1, None)),
        *(("/v7.json", None, None), ("/v0.json", None, None), ("/v6.txt", None, None)),
    ],
)
def test_versions_of_paths(path, leapd, gemini):
    assert (wire.version_of(path, "2.3"), wire.version_of(path, "gemini")) == (leapd, gemini)


def printed(value, between=","):
    """A value as the format strings of UltraleapTrackingWebSocket print it: six decimals, a space after the colon."""
    if isinstance(value, dict):
        return "{" + ",".join(f'"{key}": {printed(part)}' for key, part in value.items()) + "}"
    if isinstance(value, (list, np.ndarray)):
        return "[" + between.join(map(printed, value)) + "]"
    return f"{value:f}" if isinstance(value, float) else json.dumps(value)


def todays_hand(hand):
    rotation = np.diag([-1.0 if hand.side == "left" else 1.0, 1.0, 1.0])
    return {
        "armBasis": rotation @ hand.arm_basis,
        "armWidth": hand.arm_width,
        "confidence": 1.0,
        "direction": hand.direction,
        "elbow": hand.elbow,
        "grabAngle": min(hand.curl, np.pi),
        "grabStrength": hand.grab,
        "id": hand.id,
        "palmNormal": hand.normal,
        "palmPosition": hand.palm,
        "palmVelocity": hand.velocity,
        "palmWidth": hand.palm_width,
        "pinchDistance": float(np.linalg.norm(hand.tips[0] - hand.tips[1])),
        "pinchStrength": hand.pinch,
        "timeVisible": hand.time_visible,
        "type": hand.side,
        "wrist": hand.wrist,
    }


def todays_finger(hand, i):
    rotation = np.diag([-1.0 if hand.side == "left" else 1.0, 1.0, 1.0])
    carp, mcp, pip, dip, _ = hand.joints[i]
    along = hand.tips[i] - carp
    return {
        "bases": rotation @ hand.bases[i],
        "btipPosition": hand.tips[i],
        "carpPosition": carp,
        "dipPosition": dip,
        "mcpPosition": mcp,
        "pipPosition": pip,
        "tipPosition": hand.tips[i],
        "direction": along / max(np.linalg.norm(along), 1e-6),  # [mm]; a finger without a length has none
        "extended": hand.extended[i],
        "handId": hand.id,
        "id": 10 * hand.id + i,
        "length": float(hand.widths[i]),
        "type": i,
        "width": 0.325 * float(hand.widths[i]),
    }


@given(seed=st.integers(0, 2**32), count=st.integers(0, 2))
@example(seed=54584, count=2)  # a finger that is shorter than a nanometre
def test_a_frame_of_todays_service_is_written_as_its_server_prints_it(seed, count):
    rng = np.random.default_rng(seed)
    hands = [any_hand(rng) for _ in range(count)]
    fingers = ",".join(printed([todays_finger(hand, i) for i in range(5)], ", ")[1:-1] for hand in hands)
    expected = (
        f'{{"currentFrameRate": 115.300000,"devices": [],"id": 7,"timestamp": 8000,'
        f'"hands": {printed([todays_hand(hand) for hand in hands])},"pointables": [{fingers}]}}'
    )
    frame = wire.frame(hands, 115.3, "gemini")
    assert frame.text(7, 8000).replace("-0.000000", "0.000000") == expected.replace("-0.000000", "0.000000")


def test_the_bytes_of_todays_service():
    """Golden bytes of the header, device event, empty frame and three hands: no version, serial, or box."""
    hand = any_hand(np.random.default_rng(0))
    assert wire.text(wire.header(6, "gemini", "2.3.1")) == '{"version":6}'
    assert wire.text(wire.header(6, "gemini", "2.3.1", simulated=True)) == '{"version":6,"simulated":true}'
    event = '{"event":{"type":"deviceEvent","state":{"attached":true,"id":1,"streaming":true,"type":"peripheral"}}}'
    assert wire.text(wire.device_event(6, "gemini", "LP1", True)) == event
    assert wire.frame([], 90.0, "gemini").text(4, 5) == (
        '{"currentFrameRate": 90.000000,"devices": [],"id": 4,"timestamp": 5,"hands": [],"pointables": []}'
    )
    assert wire.frame([hand] * 3, 90.0, "gemini").text(4, 5) == (
        '{"currentFrameRate": 90.000000,"devices": [],"id": 4,"timestamp": 5,"hands": undefined,"pointables": }'
    )
