"""Text on the WebSocket of the Leap service to records; millimetres end here.

The first message of a connection is the header; later messages with the key `event` are events, the others frames.
Fields that control depends on must be present, finite and plausible, or the frame is refused with a reason; a hand with
such a fault is left out alone, with its reason, and the others stay. Unknown fields are ignored, and fields that some
services leave out have defaults:

| missing | default |
| --- | --- |
| carpPosition | the metacarpal starts at the knuckle and has no length, as the thumb's always has |
| btipPosition | the last bone ends at tipPosition, as it does in the early frames without this field |
| bases | z of each bone from its two joints, x as near to the palm's x axis as that allows |
| elbow, wrist, armBasis | no arm |
| velocity, sphere, widths, grab, pinch | zero |

Handedness is taken from `type`: some services write right-handed bases for left hands.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NoReturn, TypeVar

import numpy as np

from leap_motion.frames import LeapBone, LeapFinger, LeapFrame, LeapHand

VERSIONS = range(1, 7)  # versions of the protocol that exist
POLICY_MESSAGES = ('{"background":true}', '{"focused":true}')
"""A client that sends these gets frames whatever window has the focus; all services take one key and no spaces."""

UNIT_TOLERANCE = 0.01  # how far the length of a unit vector, or a product of two axes, may be off
LIMIT = 1e9  # numbers beyond this are not measurements; they would not fit into the fields of messages either
MM = 1e-3
ZERO = (0, 0, 0)
Read = TypeVar("Read")


class LeapProtocolError(ValueError):
    """A message that breaks the protocol; the text is one sentence."""


@dataclass(frozen=True)
class DeviceEvent:
    """A change of the device: whether it is plugged in and sends frames."""

    id: str
    attached: bool
    streaming: bool


def read_header(text: str | bytes) -> str:
    """Returns the version of the service, if given, in `text`, the first message of a connection.

    Raises:
        LeapProtocolError: it is not a header, or its version does not exist.
    """
    message = _object(text)
    if "version" not in message:
        raise LeapProtocolError("The first message has no protocol version, so this is not a Leap service.")
    version = message["version"]
    if isinstance(version, bool) or not isinstance(version, int) or version not in VERSIONS:
        raise LeapProtocolError(f"The Leap service announces protocol version {str(version)[:40]!r}; known are 1 to 6.")
    return str(message.get("serviceVersion", ""))


def read_message(text: str | bytes) -> LeapFrame | DeviceEvent | None:
    """Returns the frame or device event in `text`, or None for an event of another kind.

    Raises:
        LeapProtocolError: the text is torn, or the frame is unusable.
    """
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
        message = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        if isinstance(error, LeapProtocolError):
            raise
        raise LeapProtocolError("The text is not JSON.") from error
    if not isinstance(message, dict):
        raise LeapProtocolError("The text is not a JSON object.")
    return message


def _refuse_constant(token: str) -> NoReturn:
    raise LeapProtocolError(f"The text holds the number {token}.")


def _event(event: Any) -> DeviceEvent | None:
    kind, state = event.get("type"), event.get("state")
    if kind == "deviceConnect":
        return DeviceEvent("", bool(state), bool(state))
    if kind != "deviceEvent":
        return None
    return DeviceEvent(str(state.get("id", "")), state["attached"] is True, state["streaming"] is True)


def _frame(message: dict) -> LeapFrame:
    fingers_of: dict[int, list[dict]] = {}
    for pointable in _field(message, "pointables"):
        if not pointable.get("tool") and "dipPosition" in pointable:
            fingers_of.setdefault(pointable.get("handId"), []).append(pointable)
    hands, left_out = [], []
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


def _hand(hand: dict, fingers_of: dict[int, list[dict]]) -> LeapHand:
    pointables = fingers_of.get(_whole(hand, "id"), [])
    if _field(hand, "type") not in ("right", "left"):
        raise LeapProtocolError(f"A hand has the type {str(hand['type'])[:40]!r}.")
    normal, direction = _unit(hand, "palmNormal"), _unit(hand, "direction")
    if abs(normal @ direction) > UNIT_TOLERANCE:
        raise LeapProtocolError("palmNormal and direction of a hand are not orthogonal.")
    confidence = _number(hand, "confidence")
    if not 0.0 <= confidence <= 1.0:
        raise LeapProtocolError(f"The confidence of a hand is {confidence:g}, not between 0 and 1.")
    palm_axes = np.stack([_cross(normal, direction), -normal, -direction], axis=1)
    return LeapHand(
        id=_whole(hand, "id"),
        side=hand["type"],
        palm=_vectors(_field(hand, "palmPosition"), "palmPosition", 3, scale=MM),
        normal=normal,
        direction=direction,
        velocity=_vectors(hand.get("palmVelocity", ZERO), "palmVelocity", 3, scale=MM),
        confidence=confidence,
        grab=_number(hand, "grabStrength", 0.0),
        pinch=_number(hand, "pinchStrength", 0.0),
        time_visible=_number(hand, "timeVisible", 0.0),
        palm_width=_number(hand, "palmWidth", 0.0) * MM,
        sphere_center=_vectors(hand.get("sphereCenter", ZERO), "sphereCenter", 3, scale=MM),
        sphere_radius=_number(hand, "sphereRadius", 0.0) * MM,
        fingers=_fingers(pointables, palm_axes) if pointables else (),
        arm=_arm(hand) if "armBasis" in hand else None,
    )


def _fingers(pointables: list[dict], palm_axes: np.ndarray) -> tuple[LeapFinger, ...]:
    pointables = sorted(pointables, key=lambda pointable: _whole(pointable, "type"))
    types = [pointable["type"] for pointable in pointables]
    if len(set(types)) < len(types) or not set(types) <= set(range(5)):
        raise LeapProtocolError(f"The fingers of a hand have the types {types}.")
    n = len(pointables)
    tips = _vectors([_field(p, "tipPosition") for p in pointables], "tipPosition", n, 3, scale=MM)
    joints = _joints(pointables)
    rotations = _rotations(pointables, joints, palm_axes)
    return tuple(
        LeapFinger(
            id=_whole(p, "id"),
            type=p["type"],
            bones=tuple(LeapBone(joints[i, j], joints[i, j + 1], rotations[i, j]) for j in range(4)),
            tip=tips[i],
            length=_number(p, "length", 0.0) * MM,
            width=_number(p, "width", 0.0) * MM,
            extended=p.get("extended") is True,
        )
        for i, p in enumerate(pointables)
    )


def _joints(pointables: list[dict]) -> np.ndarray:
    """Returns the five joints of each finger, shape (n, 5, 3) [m]."""
    chains = []
    for p in pointables:
        mcp, tip = _field(p, "mcpPosition"), _field(p, "tipPosition")
        carp, btip = p.get("carpPosition", mcp), p.get("btipPosition", tip)
        chains.append([carp, mcp, _field(p, "pipPosition"), p["dipPosition"], btip])
    return _vectors(chains, "the joints of a finger", len(pointables), 5, 3, scale=MM)


def _rotations(pointables: list[dict], joints: np.ndarray, palm_axes: np.ndarray) -> np.ndarray:
    """Returns the orientations of the four bones of each finger, shape (n, 4, 3, 3), axes as columns."""
    back = joints[:, :-1] - joints[:, 1:]
    length = np.linalg.norm(back, axis=-1)
    no_length = length < 1e-6
    if all("bases" in p for p in pointables):
        bases = _vectors([p["bases"] for p in pointables], "bases", len(pointables), 4, 3, 3)
        wrong = _not_orthonormal(bases)
        if (wrong & ~no_length).any():
            raise LeapProtocolError("The axes of a bone are not orthonormal.")
        rotations = np.where((wrong & no_length)[..., None, None], palm_axes, _proper(bases.swapaxes(-1, -2)))
    else:
        z = np.where(no_length[..., None], palm_axes[:, 2], back / np.maximum(length, 1e-6)[..., None])
        x = palm_axes[:, 0] - (z @ palm_axes[:, 0])[..., None] * z
        sideways = np.linalg.norm(x, axis=-1) < 0.1
        x[sideways] = _cross(palm_axes[:, 1], z[sideways])
        x /= np.linalg.norm(x, axis=-1)[..., None]
        rotations = np.stack([x, _cross(z, x), z], axis=-1)
    return _read_only(rotations)


def _arm(hand: dict) -> LeapBone:
    ends = _vectors([_field(hand, "elbow"), _field(hand, "wrist")], "the arm", 2, 3, scale=MM)
    basis = _vectors(hand["armBasis"], "armBasis", 3, 3)
    if _not_orthonormal(basis):
        raise LeapProtocolError("The axes of an arm are not orthonormal.")
    return LeapBone(ends[0], ends[1], _proper(basis.T))


def _not_orthonormal(bases: np.ndarray) -> np.ndarray:
    """Returns for each of the matrices, shape (..., 3, 3), whether its rows are not orthonormal."""
    return np.abs(bases @ bases.swapaxes(-1, -2) - np.eye(3)).max(axis=(-1, -2)) > UNIT_TOLERANCE


def _proper(axes: np.ndarray) -> np.ndarray:
    """Returns the matrices, shape (..., 3, 3), with the x column negated where they mirror, as for left hands."""
    axes = axes.copy()
    axes[..., 0] *= np.where(np.linalg.det(axes) < 0.0, -1.0, 1.0)[..., None]
    return _read_only(axes)


def _field(message: dict, key: str) -> Any:
    if key not in message:
        raise LeapProtocolError(f"The field {key} is missing.")
    return message[key]


def _whole(message: dict, key: str) -> int:
    value = _field(message, key)
    if isinstance(value, bool) or not isinstance(value, int):
        raise LeapProtocolError(f"The field {key} is {str(value)[:40]!r}, not a whole number.")
    return value


def _number(message: dict, key: str, missing: float | None = None) -> float:
    if missing is not None and key not in message:
        return missing
    value = _field(message, key)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < LIMIT:
        raise LeapProtocolError(f"The field {key} is {str(value)[:40]!r}, not a number below 1e9.")
    return float(value)


def _vectors(value: Any, name: str, *shape: int, scale: float = 1.0) -> np.ndarray:
    """Returns `value` as a read-only array of the shape, times `scale`."""
    try:
        array = np.array(value)
    except ValueError:
        array = np.array(None)
    if array.shape != shape or array.dtype.kind not in "fi" or not (np.abs(array) < LIMIT).all():
        raise LeapProtocolError(f"The field {name} does not hold {' x '.join(map(str, shape))} numbers.")
    return _read_only(array * scale)


def _unit(message: dict, key: str) -> np.ndarray:
    vector = _vectors(_field(message, key), key, 3)
    norm = float(np.linalg.norm(vector))
    if abs(norm - 1.0) > UNIT_TOLERANCE:
        raise LeapProtocolError(f"The field {key} has the length {norm:g}, not 1.")
    return _read_only(vector / norm)


def _read_only(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns a x b along the last axis; numpy's own function takes ten times as long for single vectors."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
