"""Text on the WebSocket of the Leap service to records; millimetres end here.

The first message is the header; later ones with the key `event` are events, the others frames. What control depends on
must be present, finite and plausible, or the frame, or the hand alone, is refused with a reason. Unknown fields are
ignored. Missing ones: a metacarpal without carpPosition starts at the knuckle; without btipPosition the last bone ends
at tipPosition; without bases z comes from the joints and x is near the palm's; no elbow, wrist or armBasis: no arm; id
of a finger: 10 * id of the hand + type; velocity, sphere, widths, grab and pinch: zero.

Handedness is `type`: some services write right-handed bases for left hands. The knuckles must agree with it and be as
far apart as a person's."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn, TypeVar

import numpy as np

from leap_motion.frames import INDEX, PINKY, LeapBone, LeapFinger, LeapFrame, LeapHand

VERSIONS = range(1, 7)  # versions of the protocol that exist
POLICY_MESSAGES = ('{"background":true}', '{"optimizeHMD":false}', '{"focused":true}')
"""A client that sends these gets frames whatever window has the focus, of a tracker that lies on the desk, not of one
that is worn or hangs above a screen. UltraleapTrackingWebSocket takes these texts only as they are, one key each, below
32 characters.
"""
THREE_HANDS = '"hands": undefined'  # UltraleapTrackingWebSocket writes this for more than two hands

UNIT_TOLERANCE = 0.01  # how far the length of a unit vector, or a product of two axes, may be off
LIMIT = 1e9  # numbers beyond this are not measurements; they would not fit into the fields of messages either
WHOLE_LIMIT = 2**53  # likewise for counts, numbers of hands and microseconds, of which a float holds each
MM = 1e-3
KNUCKLES_M = (0.03, 0.13)  # from the index finger's knuckle to the little finger's; adults have 0.06 to 0.1
LEAST_ACROSS = 0.3  # cosine between that line and the axis across the palm; the service's hands have 0.99
ZERO = (0, 0, 0)
IDENTITY = np.eye(3)
Read = TypeVar("Read")


class LeapProtocolError(ValueError):
    """A message that breaks the protocol; the text is one sentence."""


class UnknownVersion(LeapProtocolError):
    """The header of a Leap service whose version of the protocol does not exist."""


@dataclass(frozen=True)
class DeviceEvent:
    """A change of the device: whether it is plugged in and sends frames."""

    serial: str  # of the device; empty where the service gives a mere number instead
    attached: bool
    streaming: bool


def read_header(text: str | bytes) -> str:
    """Returns the version of the service, if given, in `text`, the first message of a connection. Raises
    LeapProtocolError: it is not a header; UnknownVersion: its version does not exist."""
    message = _object(text)
    if "version" not in message:
        raise LeapProtocolError("The first message has no protocol version, so this is not a Leap service.")
    version = message["version"]
    if isinstance(version, bool) or not isinstance(version, int) or version not in VERSIONS:
        raise UnknownVersion(f"The Leap service announces protocol version {str(version)[:40]!r}; known are 1 to 6.")
    return str(message.get("serviceVersion") or "")


def is_simulated(header: str | bytes) -> bool:
    """Returns whether a service says in its `header`, of `read_header`, that its hands are simulated or recorded."""
    return _object(header).get("simulated") is True


def read_message(text: str | bytes) -> LeapFrame | DeviceEvent | None:
    """Returns the frame or device event in `text`, or None for an event of another kind. Raises LeapProtocolError:
    the text is torn, or the frame is unusable."""
    message = _object(text)
    return _checked(_event, message["event"]) if "event" in message else _checked(_frame, message)


def _checked(read: Callable[..., Read], *fields: Any) -> Read:
    """Returns what `read` makes of the fields; a LeapProtocolError where their form is not as expected."""
    try:
        return read(*fields)
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        if isinstance(error, LeapProtocolError):
            raise
        raise LeapProtocolError(f"A field has an unexpected form: {type(error).__name__} {str(error)[:80]}.") from error


def _object(text: str | bytes) -> dict:
    try:
        message = DECODER.decode(
            text if isinstance(text, str) else text.decode(json.detect_encoding(text), "surrogatepass")
        )
    except (ValueError, RecursionError) as error:
        if isinstance(error, LeapProtocolError):
            raise
        three = isinstance(text, str) and THREE_HANDS in text
        reason = "Ultraleap's server writes no frame with more than two hands; take one out." if three else ""
        raise LeapProtocolError(reason or "The text is not JSON.") from error
    if not isinstance(message, dict):
        raise LeapProtocolError("The text is not a JSON object.")
    return message


def _refuse_constant(token: str) -> NoReturn:
    raise LeapProtocolError(f"The text holds the number {token}.")


DECODER = json.JSONDecoder(parse_constant=_refuse_constant)


def _event(event: Any) -> DeviceEvent | None:
    kind, state = event.get("type"), event.get("state")
    if kind == "deviceConnect":
        return DeviceEvent("", bool(state), bool(state))
    if kind != "deviceEvent":
        return None
    serial = state.get("id")
    serial = serial if isinstance(serial, str) else ""
    return DeviceEvent(serial, state["attached"] is True, state["streaming"] is True)


def _frame(message: dict) -> LeapFrame:
    fingers_of: dict[int | None, list[dict]] = {}
    hands, left_out = [], []
    for pointable in _field(message, "pointables"):
        try:
            fingers_of.setdefault(_checked(_owner, pointable), []).append(pointable)
        except LeapProtocolError as error:
            left_out.append(str(error))
    for hand in _field(message, "hands"):
        try:
            hands.append(_checked(_hand, hand, fingers_of))
        except LeapProtocolError as error:
            left_out.append(str(error))
    if len({hand.id for hand in hands}) < len(hands):
        raise LeapProtocolError("Two hands have the same id.")
    return LeapFrame(
        id=_whole(message, "id"),
        timestamp_us=_whole(message, "timestamp"),
        rate=_number(message, "currentFrameRate", 0.0),
        hands=tuple(hands),
        left_out=tuple(left_out),
        gestures=len(message.get("gestures", ())),
    )


def _owner(pointable: dict) -> int | None:
    """Returns the id of the hand whose finger it is, None for a tool or a finger without joints."""
    is_finger = not pointable.get("tool") and "dipPosition" in pointable
    return _whole(pointable, "handId") if is_finger else None


def _hand(hand: dict, fingers_of: dict[int | None, list[dict]]) -> LeapHand:
    pointables = sorted(fingers_of.get(_whole(hand, "id"), []), key=lambda pointable: _whole(pointable, "type"))
    if _field(hand, "type") not in ("right", "left"):
        raise LeapProtocolError(f"A hand has the type {str(hand['type'])[:40]!r}.")
    n, has_arm, has_bases = len(pointables), "armBasis" in hand, all("bases" in p for p in pointables)
    palm = _vectors("palmPosition", _field(hand, "palmPosition"), (3,), MM)
    velocity = _vectors("palmVelocity", hand.get("palmVelocity", ZERO), (3,), MM)
    sphere_center = _vectors("sphereCenter", hand.get("sphereCenter", ZERO), (3,), MM)
    tips = _vectors("tipPosition", [_field(p, "tipPosition") for p in pointables], (n, 3), MM)
    joints = _vectors("the joints of a finger", [_joints(p) for p in pointables], (n, 5, 3), MM)
    arm = _vectors("the arm", [_field(hand, "elbow"), _field(hand, "wrist")] if has_arm else [], (2 * has_arm, 3), MM)
    normal = _unit(_vectors("palmNormal", _field(hand, "palmNormal"), (3,)), "palmNormal")
    direction = _unit(_vectors("direction", _field(hand, "direction"), (3,)), "direction")
    bases = _vectors("bases", [p["bases"] for p in pointables] if has_bases else [], (n * has_bases, 4, 3, 3))
    arm_basis = _vectors("armBasis", hand["armBasis"] if has_arm else [], (3 * has_arm, 3))
    bases = np.concatenate([bases.reshape(-1, 3, 3), arm_basis.reshape(-1, 3, 3)])
    wrong, rotations = _not_orthonormal(bases), _proper(bases.swapaxes(-1, -2))
    if abs(normal @ direction) > UNIT_TOLERANCE:
        raise LeapProtocolError("palmNormal and direction of a hand are not orthogonal.")
    _check_knuckles(hand["type"], {p["type"]: joint[1] for p, joint in zip(pointables, joints)}, direction, normal)
    confidence = _number(hand, "confidence")
    if not 0.0 <= confidence <= 1.0:
        raise LeapProtocolError(f"The confidence of a hand is {confidence:g}, not between 0 and 1.")
    count = 4 * n * has_bases
    bones = rotations[:count].reshape(-1, 4, 3, 3)
    if n and (not has_bases or wrong[:count].any()):
        palm_axes = np.stack([_cross(normal, direction), -normal, -direction], axis=1)
        bones = _completed(bones, wrong[:count].reshape(-1, 4), joints, palm_axes)
    fingers = _fingers(pointables, tips, joints, bones)
    if has_arm and wrong[-1]:
        raise LeapProtocolError("The axes of an arm are not orthonormal.")
    return LeapHand(
        id=hand["id"],
        side=hand["type"],
        palm=palm,
        normal=normal,
        direction=direction,
        velocity=velocity,
        confidence=confidence,
        grab=_number(hand, "grabStrength", 0.0),
        pinch=_number(hand, "pinchStrength", 0.0),
        time_visible=_number(hand, "timeVisible", 0.0),
        palm_width=_number(hand, "palmWidth", 0.0) * MM,
        sphere_center=sphere_center,
        sphere_radius=_number(hand, "sphereRadius", 0.0) * MM,
        fingers=fingers,
        arm=LeapBone(arm[0], arm[1], rotations[-1]) if has_arm else None,
    )


def _check_knuckles(side: str, knuckles: dict[int, np.ndarray], direction: np.ndarray, normal: np.ndarray) -> None:
    """Refuses a hand whose knuckles, shape (3,) [m] by type of the finger, show other axes or units than a Leap's."""
    if INDEX not in knuckles or PINKY not in knuckles:
        return
    line = knuckles[INDEX] - knuckles[PINKY]
    width = math.sqrt(line @ line)
    least, most = KNUCKLES_M
    if not least <= width <= most:
        raise LeapProtocolError(
            f"The knuckles of a hand are {1e3 * width:.4g} mm apart, not {1e3 * least:g} to {1e3 * most:g}: the "
            "tracker's lengths are not millimetres."
        )
    across = float(_cross(direction, normal) @ line) / width
    if (across if side == "right" else -across) < LEAST_ACROSS:
        raise LeapProtocolError(
            f"The fingers of a {side} hand are in the order of the other one: the tracker's axes are mirrored."
        )


def _fingers(
    pointables: list[dict], tips: np.ndarray, joints: np.ndarray, rotations: np.ndarray
) -> tuple[LeapFinger, ...]:
    types = [pointable["type"] for pointable in pointables]
    if len(set(types)) < len(types) or not set(types) <= set(range(5)):
        raise LeapProtocolError(f"The fingers of a hand have the types {types}.")
    return tuple(
        LeapFinger(
            id=_whole(p, "id") if "id" in p else 10 * p["handId"] + p["type"],
            type=p["type"],
            joints=joints[i],
            rotations=rotations[i],
            tip=tips[i],
            length=_number(p, "length", 0.0) * MM,
            width=_number(p, "width", 0.0) * MM,
            extended=p.get("extended") is True,
        )
        for i, p in enumerate(pointables)
    )


def _joints(pointable: dict) -> list:
    mcp, tip = _field(pointable, "mcpPosition"), _field(pointable, "tipPosition")
    carp, btip = pointable.get("carpPosition", mcp), pointable.get("btipPosition", tip)
    return [carp, mcp, _field(pointable, "pipPosition"), pointable["dipPosition"], btip]


def _completed(rotations: np.ndarray, wrong: np.ndarray, joints: np.ndarray, palm_axes: np.ndarray) -> np.ndarray:
    """Returns the orientations of the four bones of each finger, shape (n, 4, 3, 3), axes as columns: the service's
    where they are not `wrong`, the palm's for a bone without length, and without any of the service those that fit."""
    if rotations.size:
        no_length = np.linalg.norm(joints[:, :-1] - joints[:, 1:], axis=-1) < 1e-6
        if (wrong & ~no_length).any():
            raise LeapProtocolError("The axes of a bone are not orthonormal.")
        return _read_only(np.where(wrong[..., None, None], palm_axes, rotations))
    return _read_only(bone_axes(joints, palm_axes))


def bone_axes(joints: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Returns axes x, y, z as columns of the four bones of n fingers, shape (n, 4, 3, 3), from their joints, shape
    (n, 5, 3): z against the bone, x as near as that allows to the x of the axes `across`, shape (3, 3) or (n, 1, 3,
    3), which a bone without length has itself."""
    back = joints[:, :-1] - joints[:, 1:]
    length = np.linalg.norm(back, axis=-1, keepdims=True)
    z = np.where(length < 1e-6, across[..., 2], back / np.maximum(length, 1e-6))
    x = across[..., 0] - (z * across[..., 0]).sum(axis=-1, keepdims=True) * z
    sideways = np.linalg.norm(x, axis=-1, keepdims=True) < 0.1
    x = np.where(sideways, _cross(np.broadcast_to(across[..., 1], z.shape), z), x)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, _cross(z, x), z], axis=-1)


def _not_orthonormal(bases: np.ndarray) -> np.ndarray:
    """Returns for each of the matrices, shape (..., 3, 3), whether its rows are not orthonormal."""
    return np.abs(bases @ bases.swapaxes(-1, -2) - IDENTITY).max(axis=(-1, -2)) > UNIT_TOLERANCE


def _proper(axes: np.ndarray) -> np.ndarray:
    """Returns the matrices, shape (..., 3, 3), with the x column negated where they mirror, as for left hands."""
    mirrored = np.linalg.det(axes) < 0.0
    if mirrored.any():
        axes = axes.copy()
        axes[..., 0] *= np.where(mirrored, -1.0, 1.0)[..., None]
    return _read_only(axes)


def _field(message: dict, key: str) -> Any:
    if key not in message:
        raise LeapProtocolError(f"The field {key} is missing.")
    return message[key]


def _whole(message: dict, key: str) -> int:
    value = _field(message, key)
    if isinstance(value, bool) or not isinstance(value, int) or not abs(value) <= WHOLE_LIMIT:
        raise LeapProtocolError(f"The field {key} is {str(value)[:40]!r}, not a whole number up to 2^53.")
    return value


def _number(message: dict, key: str, missing: float | None = None) -> float:
    if missing is not None and key not in message:
        return missing
    value = _field(message, key)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < LIMIT:
        raise LeapProtocolError(f"The field {key} is {str(value)[:40]!r}, not a number below 1e9.")
    return float(value)


def _vectors(name: str, value: Any, shape: tuple[int, ...], scale: float = 1.0) -> np.ndarray:
    try:
        array = np.array(value)
    except ValueError:
        array = np.array(None)
    empty = 0 in shape
    if not empty and (array.shape != shape or array.dtype.kind not in "fi" or not (np.abs(array) < LIMIT).all()):
        raise LeapProtocolError(f"The field {name} does not hold {' x '.join(map(str, shape))} numbers.")
    return _read_only(np.empty(shape) if empty else array * scale)


def _unit(vector: np.ndarray, name: str) -> np.ndarray:
    norm = math.sqrt(vector @ vector)
    if abs(norm - 1.0) > UNIT_TOLERANCE:
        raise LeapProtocolError(f"The field {name} has the length {norm:g}, not 1.")
    return _read_only(vector / norm)


def _read_only(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns a x b along the last axis; numpy's own function takes ten times as long for single vectors."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
