"""Messages of the services as JSON text: header, device event, frames in the field sets of both; millimetres.
Service "2.3" is leapd 2.0 to 2.3.1, which prints six digits; "gemini" is UltraleapTrackingWebSocket, the server for
Ultraleap's tracking services 5 and 6, with its departures (https://github.com/ultraleap/UltraleapTrackingWebSocket)."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from leap_motion.service.hand import ReportedHand

SERVICES = ("2.3", "gemini")
HIGHEST_VERSION = 6
MODES = {"optimizeHMD": "head-mounted", "optimizeScreentop": "screen-top"}
"""Policies that ask for a tracking mode other than desktop."""
BOX = {"center": [0, 200, 0], "size": [235.247, 235.247, 147.751]}
MOTION_FACTORS = {"r": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "s": 1, "t": [0, 0, 0]}
POSITIONS = (
    *("palmPosition", "stabilizedPalmPosition", "sphereCenter", "elbow", "wrist", "carpPosition", "mcpPosition"),
    *("pipPosition", "dipPosition", "btipPosition", "tipPosition", "stabilizedTipPosition"),
)
"""Fields that a shift of the whole scene changes."""
DIRECTIONS = ("palmNormal", "direction", "armBasis", "bases")
_ID, _TIMESTAMP = r'"\u0000"', r'"\u0001"'  # JSON texts in their places


def version_of(path: str, service: str) -> int | None:
    """Returns the protocol version that a path requests of the service, or None for one that it does not know."""
    if path in ("", "/"):
        return 1 if service == "2.3" else None
    match = re.fullmatch(r"/v(\d+)\.json", path)
    version = int(match.group(1)) if match else 0
    return version if (1 if service == "2.3" else HIGHEST_VERSION) <= version <= HIGHEST_VERSION else None


def policies(message: str | bytes, service: str) -> dict[str, bool]:
    """Returns the policies that a client's message sets; none for a message that the service ignores."""
    if service == "gemini":
        match = _POLICY.fullmatch(message) if isinstance(message, str) else None
        return {match.group(1): match.group(2) == "true"} if match else {}
    try:
        request = json.loads(message)
    except (ValueError, RecursionError):
        return {}
    return {key: value is True for key, value in request.items()} if isinstance(request, dict) else {}


def text(message: dict) -> str:
    """Returns the message as the service writes it: no spaces."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False)


def header(version: int, service: str, service_version: str, simulated: bool = False) -> dict:
    """Returns the first message of a connection; a service whose hands are simulated or recorded says that in a key
    of its own, as programs that do not know it read the others."""
    named = service == "2.3" and version >= 5
    first = {"serviceVersion": service_version, "version": version} if named else {"version": version}
    return {**first, "simulated": True} if simulated else first


def device_event(version: int, service: str, serial: str, attached: bool) -> dict | None:
    """Returns the event for a client of a device that was plugged in or out; None for versions without it."""
    if version < 3:
        return None
    if version < 5:
        return {"event": {"state": attached, "type": "deviceConnect"}}
    if service == "gemini":
        state = {"attached": attached, "id": 1, "streaming": attached, "type": "peripheral"}
        return {"event": {"type": "deviceEvent", "state": state}}
    state = {"attached": attached, "id": serial, "streaming": attached, "type": "Peripheral"}
    return {"event": {"state": state, "type": "deviceEvent"}}


class Frame(NamedTuple):
    """A frame as text with places for its `id` and `timestamp`, which the playback adds."""

    marked: str
    hand_id: int  # the highest of its hands; 0 without a hand

    def text(self, frame_id: int, timestamp: int) -> str:
        """Returns the frame as the service writes it; `timestamp` [us]."""
        return self.marked.replace(_ID, str(frame_id), 1).replace(_TIMESTAMP, str(timestamp), 1)

    def with_ids(self, added: int) -> Frame:
        return frame_from(with_ids(json.loads(self.marked), added))


def frame(hands: Sequence[ReportedHand], rate: float, service: str = "2.3", order: Sequence[int] = range(5)) -> Frame:
    """Returns a frame. `rate`: the service's estimate of the frame rate [Hz]; `order`: of the fingers of a hand,
    which service 2.3 does not sort. Raises ValueError for a number that is not finite."""
    if not math.isfinite(rate):
        raise ValueError(f"The frame rate is {rate}.")
    hand_id = max((hand.id for hand in hands), default=0)
    if service == "gemini":
        return Frame(_gemini_frame(hands, rate), hand_id)
    hand_texts = [_hand(hand) for hand in hands]
    fingers = [finger for hand in hands for finger in _fingers(hand, order)]
    listed = f'"hands":[{",".join(hand_texts)}],"pointables":[{",".join(fingers)}]'
    ids = f'"id":{_ID},"timestamp":{_TIMESTAMP}'
    return Frame(f'{{"currentFrameRate":{rate:.6g},{listed},{_FRAME_END},{ids}}}', hand_id)


def frame_from(message: dict) -> Frame:
    """Returns the frame of a decoded message; raises ValueError for a number that is not finite."""
    marked = text({**message, "id": json.loads(_ID), "timestamp": json.loads(_TIMESTAMP)})
    return Frame(marked, max((hand["id"] for hand in message["hands"]), default=0))


def shifted(message: dict, offset: Sequence[float]) -> dict:
    """Returns the frame with every position moved by `offset` [mm]; directions and velocities stay."""
    return _changed(message, lambda p: [v + o for v, o in zip(p, offset)], list)


def scaled(message: dict, factor: float) -> dict:
    """Returns the frame with every position multiplied by a factor."""
    return _changed(message, lambda p: [factor * v for v in p], list)


def reflected(message: dict, normal: Sequence[float], point: Sequence[float]) -> dict:
    """Returns the frame in a mirror, the plane of a unit vector and a point [mm]; velocities stay."""
    n, c = np.array(normal), np.array(point)

    def turned(vector: Any) -> list:
        v = np.array(vector)
        return (v - 2.0 * np.outer(v @ n, n).reshape(v.shape)).tolist()

    return _changed(message, lambda p: (np.array(turned(np.array(p) - c)) + c).tolist(), turned)


def _changed(message: dict, place: Callable[[Any], list], vector: Callable[[Any], list]) -> dict:
    changes = {**dict.fromkeys(POSITIONS, place), **dict.fromkeys(DIRECTIONS, vector)}

    def changed(part: dict) -> dict:
        return {key: six(changes[key](value)) if key in changes else value for key, value in part.items()}

    return {**message, **{key: [changed(part) for part in message[key]] for key in ("hands", "pointables")}}


def with_ids(message: dict, added: int) -> dict:
    """Returns the frame with the ids of hands, and accordingly of fingers, raised."""
    return {
        **message,
        "hands": [{**hand, "id": hand["id"] + added} for hand in message["hands"]],
        "pointables": [
            {**finger, "handId": finger["handId"] + added, "id": finger["id"] + 10 * added}
            for finger in message["pointables"]
        ],
    }


def six(values: float | np.ndarray | list[Any]) -> Any:
    """Returns numbers, or nested arrays of them, with the six digits that the service prints."""
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if isinstance(values, list):
        return [six(value) for value in values]
    value = float(f"{values:.6g}")
    return int(value) if value.is_integer() else value


def _slots(number: str, *shape: int) -> str:
    return "[" + ",".join([_slots(number, *shape[1:]) if shape[1:] else number] * shape[0]) + "]"


_VECTOR, _BASIS = _slots("%.6g", 3), _slots("%.6g", 3, 3)
_MOTION = text(MOTION_FACTORS)[1:-1]
_FRAME_END = f'{_MOTION},"gestures":[],"interactionBox":{text(BOX)}'
_HAND = (
    f'{{"armBasis":{_BASIS},"armWidth":%.6g,"confidence":%.6g,"direction":{_VECTOR},"elbow":{_VECTOR},'
    f'"grabStrength":%.6g,"id":%d,"palmNormal":{_VECTOR},"palmPosition":{_VECTOR},"palmVelocity":{_VECTOR},'
    f'"palmWidth":%.6g,"pinchStrength":%.6g,"timeVisible":%.6g,"type":"%s","wrist":{_VECTOR},'
    f'{_MOTION},"sphereCenter":{_VECTOR},"sphereRadius":%.6g,"stabilizedPalmPosition":{_VECTOR}}}'
)
_FINGER = (
    f'{{"bases":{_slots("%.6g", 4, 3, 3)},"btipPosition":{_VECTOR},"carpPosition":{_VECTOR},"dipPosition":{_VECTOR},'
    f'"direction":{_VECTOR},"extended":%s,"handId":%d,"id":%d,"length":%.6g,"mcpPosition":{_VECTOR},'
    f'"pipPosition":{_VECTOR},"timeVisible":%.6g,"tipPosition":{_VECTOR},"type":%d,"width":%.6g,'
    f'"stabilizedTipPosition":{_VECTOR},"tipVelocity":{_VECTOR},"tool":false,"touchDistance":1,"touchZone":"none"}}'
)


def _hand(hand: ReportedHand) -> str:
    grab = hand.grab
    radius = 60.0 - 25.0 * grab
    basis, direction, elbow = hand.arm_basis.ravel().tolist(), hand.direction.tolist(), hand.elbow.tolist()
    first = [*basis, hand.arm_width, hand.confidence, *direction, *elbow, grab]
    palm = [*hand.normal.tolist(), *hand.palm.tolist(), *hand.velocity.tolist(), hand.palm_width]
    ball = [*(hand.palm + radius * hand.normal).tolist(), radius, *hand.stable_palm.tolist()]
    numbers = _finite([*first, *palm, hand.pinch, hand.time_visible, *hand.wrist.tolist(), *ball])
    return _HAND % (*numbers[:18], hand.id, *numbers[18:30], hand.side, *numbers[30:])


def _fingers(hand: ReportedHand, order: Sequence[int]) -> list[str]:
    carp, mcp, pip, dip, btip = hand.joints.swapaxes(0, 1)
    times = np.full((5, 1), hand.time_visible)
    columns = [hand.bases.reshape(5, 36), btip, carp, dip, -hand.bases[:, 2, 2], hand.lengths[:, None], mcp, pip]
    columns += [times, hand.tips, hand.widths[:, None], hand.stable_tips, hand.tip_velocities]
    rows = np.concatenate(columns, axis=1) + 0.0  # no negative zeros
    if not np.isfinite(rows).all():
        raise ValueError("A number of a finger is not finite.")
    fingers = []
    for i in order:
        row = rows[i].tolist()
        ids = _TRUTH[hand.extended[i]], hand.id, 10 * hand.id + i
        fingers.append(_FINGER % (*row[:48], *ids, *row[48:59], i, *row[59:]))
    return fingers


def _finite(numbers: list[float]) -> list[float]:
    """Returns the numbers without negative zeros; raises ValueError for one that is not finite."""
    if not all(map(math.isfinite, numbers)):
        raise ValueError("A number of the hand is not finite.")
    return [number + 0.0 for number in numbers]


_TRUTH = "false", "true"
_POLICY = re.compile(r'\{"(background|focused|optimizeHMD|optimizeScreentop)":(true|false)\}')
_GEMINI_WIDTH = 0.325  # of the width of a finger's bones: the server adds three and a quarter, and divides by ten
_GEMINI_VECTOR, _GEMINI_BASIS = _slots("%f", 3), _slots("%f", 3, 3)
_GEMINI_HAND = (
    f'{{"armBasis": {_GEMINI_BASIS},"armWidth": %f,"confidence": %f,"direction": {_GEMINI_VECTOR},'
    f'"elbow": {_GEMINI_VECTOR},"grabAngle": %f,"grabStrength": %f,"id": %d,"palmNormal": {_GEMINI_VECTOR},'
    f'"palmPosition": {_GEMINI_VECTOR},"palmVelocity": {_GEMINI_VECTOR},"palmWidth": %f,"pinchDistance": %f,'
    f'"pinchStrength": %f,"timeVisible": %f,"type": "%s","wrist": {_GEMINI_VECTOR}}}'
)
_GEMINI_FINGER = (
    f'{{"bases": {_slots("%f", 4, 3, 3)},"btipPosition": {_GEMINI_VECTOR},"carpPosition": {_GEMINI_VECTOR},'
    f'"dipPosition": {_GEMINI_VECTOR},"mcpPosition": {_GEMINI_VECTOR},"pipPosition": {_GEMINI_VECTOR},'
    f'"tipPosition": {_GEMINI_VECTOR},"direction": {_GEMINI_VECTOR},"extended": %s,"handId": %d,"id": %d,'
    '"length": %f,"type": %d,"width": %f}'
)


def _gemini_frame(hands: Sequence[ReportedHand], rate: float) -> str:
    """Returns the text of a frame with places for its numbers; with more than two hands it is not JSON, as there."""
    listed = '"hands": undefined,"pointables": '
    if len(hands) <= 2:
        fingers = ",".join(", ".join(_gemini_finger(hand, i) for i in range(5)) for hand in hands)
        listed = f'"hands": [{",".join(map(_gemini_hand, hands))}],"pointables": [{fingers}]'
    return f'{{"currentFrameRate": {rate:f},"devices": [],"id": {_ID},"timestamp": {_TIMESTAMP},{listed}}}'


def _gemini_hand(hand: ReportedHand) -> str:
    arm = [*_proper(hand, hand.arm_basis).ravel().tolist(), hand.arm_width, 1.0]  # it is always confident
    angle = min(hand.curl, math.pi)
    distance = float(np.linalg.norm(hand.tips[0] - hand.tips[1]))
    first = [*arm, *hand.direction.tolist(), *hand.elbow.tolist(), angle, hand.grab]
    palm = [*hand.normal.tolist(), *hand.palm.tolist(), *hand.velocity.tolist(), hand.palm_width, distance]
    numbers = _finite([*first, *palm, hand.pinch, hand.time_visible, *hand.wrist.tolist()])
    return _GEMINI_HAND % (*numbers[:19], hand.id, *numbers[19:32], hand.side, *numbers[32:])


def _gemini_finger(hand: ReportedHand, i: int) -> str:
    if not np.isfinite(hand.tips).all():
        raise ValueError("A number of a finger is not finite.")
    carp, mcp, pip, dip = hand.joints[i, :4].tolist()
    tip, width = hand.tips[i].tolist(), float(hand.widths[i])
    along = hand.tips[i] - hand.joints[i, 0]
    direction = (along / max(float(np.linalg.norm(along)), 1e-6)).tolist()
    bases = _proper(hand, hand.bases[i]).ravel().tolist()
    numbers = _finite([*bases, *tip, *carp, *dip, *mcp, *pip, *tip, *direction, width, _GEMINI_WIDTH * width])
    ids = _TRUTH[hand.extended[i]], hand.id, 10 * hand.id + i
    return _GEMINI_FINGER % (*numbers[:57], *ids, numbers[57], i, numbers[58])


def _proper(hand: ReportedHand, bases: np.ndarray) -> np.ndarray:
    """Returns bases, axes as rows, as rotations also of a left hand."""
    return bases * [[-1.0], [1.0], [1.0]] if hand.side == "left" else bases
