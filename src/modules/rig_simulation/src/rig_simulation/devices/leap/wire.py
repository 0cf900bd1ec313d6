"""Messages of the service as JSON text: header, device event, frames in both field sets; millimetres, six digits.

Field set "2.x" is that of services 2.0 to 2.3.1, "new" that of later services and of the bridge for current ones.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from rig_simulation.devices.leap.sensing import ReportedHand
from rig_simulation.operator.hand_model import extended, pinch_strength

FIELD_SETS = ("2.x", "new")
HIGHEST_VERSION = 6
SERVICES = {"2.x": "2.3.1+simulated", "new": "4.0.0+simulated"}
DEVICE_ID = "LP00000000001"
BOX = {"center": [0, 200, 0], "size": [235.247, 235.247, 147.751]}
MOTION_FACTORS = {"r": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "s": 1, "t": [0, 0, 0]}
POSITIONS = (
    *("palmPosition", "stabilizedPalmPosition", "sphereCenter", "elbow", "wrist", "carpPosition", "mcpPosition"),
    *("pipPosition", "dipPosition", "btipPosition", "tipPosition", "stabilizedTipPosition"),
)
"""Fields that a shift of the whole scene changes."""
_ID, _TIMESTAMP = r'"\u0000"', r'"\u0001"'  # JSON texts in their places


def version_of(path: str) -> int | None:
    """Returns the protocol version that a path requests, or None for an unknown one."""
    if path in ("", "/"):
        return 1
    match = re.fullmatch(r"/v(\d+)\.json", path)
    version = int(match.group(1)) if match else 0
    return version if 1 <= version <= HIGHEST_VERSION else None


def text(message: dict) -> str:
    """Returns the message as the service writes it: no spaces."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False)


def header(version: int, fields: str) -> dict:
    """Returns the first message of a connection."""
    return {"serviceVersion": SERVICES[fields], "version": version} if version >= 5 else {"version": version}


def device_event(version: int, attached: bool, streaming: bool) -> dict | None:
    """Returns the device event for a client; None for versions without it."""
    if version < 3:
        return None
    if version < 5:
        return {"event": {"state": attached, "type": "deviceConnect"}}
    state = {"attached": attached, "id": DEVICE_ID, "streaming": streaming, "type": "Peripheral"}
    return {"event": {"state": state, "type": "deviceEvent"}}


class Frame(NamedTuple):
    """A frame as text with places for its `id` and `timestamp`, which the playback adds."""

    marked: str
    hand_id: int  # the highest of its hands; 0 without a hand

    def text(self, frame_id: int, timestamp: int) -> str:
        """Returns the frame as the service writes it; `timestamp` [us]."""
        return self.marked.replace(_ID, str(frame_id), 1).replace(_TIMESTAMP, str(timestamp), 1)

    def with_ids(self, added: int) -> Frame:
        """Returns the frame with the ids of hands, and accordingly of fingers, raised."""
        return frame_from(with_ids(json.loads(self.marked), added))


def frame(hands: Sequence[ReportedHand], rate: float, fields: str, order: Sequence[int] = range(5)) -> Frame:
    """Returns a frame. `rate`: the service's estimate of the frame rate [Hz]; `fields`: one of FIELD_SETS; `order`: of
    the fingers of a hand, which the service does not sort. Raises ValueError for a number that is not finite.
    """
    hand_texts = [_hand(hand, fields) for hand in hands]
    fingers = [finger for hand in hands for finger in _fingers(hand, fields, order)]
    listed = f'"hands":[{",".join(hand_texts)}],"pointables":[{",".join(fingers)}]'
    ids = f'"id":{_ID},"timestamp":{_TIMESTAMP}'
    marked = f'{{"currentFrameRate":{rate:.6g},{listed},{_FRAME_ENDS[fields]},{ids}}}'
    return Frame(marked, max((hand.id for hand in hands), default=0))


def frame_from(message: dict) -> Frame:
    """Returns the frame of a decoded message; raises ValueError for a number that is not finite."""
    marked = text({**message, "id": json.loads(_ID), "timestamp": json.loads(_TIMESTAMP)})
    return Frame(marked, max((hand["id"] for hand in message["hands"]), default=0))


def shifted(message: dict, offset: Sequence[float]) -> dict:
    """Returns the frame with every position moved by `offset` [mm]; directions and velocities stay."""

    def moved(part: dict) -> dict:
        places = {key: [six(v + o) for v, o in zip(part[key], offset)] for key in POSITIONS if key in part}
        return {key: places.get(key, value) for key, value in part.items()}

    return {**message, **{key: [moved(part) for part in message[key]] for key in ("hands", "pointables")}}


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


def _slots(*shape: int) -> str:
    """Returns the text of an array with places for its numbers, in the six digits that the service prints."""
    return "[" + ",".join([_slots(*shape[1:]) if shape[1:] else "%.6g"] * shape[0]) + "]"


_VECTOR, _BASIS = _slots(3), _slots(3, 3)
_MOTION = text(MOTION_FACTORS)[1:-1]
_FRAME_ENDS = {"2.x": f'{_MOTION},"gestures":[],"interactionBox":{text(BOX)}', "new": '"devices":[]'}
_HAND = (
    f'{{"armBasis":{_BASIS},"armWidth":%.6g,"confidence":%.6g,"direction":{_VECTOR},"elbow":{_VECTOR},'
    f'"grabStrength":%.6g,"id":%d,"palmNormal":{_VECTOR},"palmPosition":{_VECTOR},"palmVelocity":{_VECTOR},'
    f'"palmWidth":%.6g,"pinchStrength":%.6g,"timeVisible":%.6g,"type":"%s","wrist":{_VECTOR},'
)
_HAND_ENDS = {
    "2.x": f'{_MOTION},"sphereCenter":{_VECTOR},"sphereRadius":%.6g,"stabilizedPalmPosition":{_VECTOR}}}',
    "new": '"grabAngle":%.6g,"pinchDistance":%.6g}',
}
_FINGER = (
    f'{{"bases":{_slots(4, 3, 3)},"btipPosition":{_VECTOR},"carpPosition":{_VECTOR},"dipPosition":{_VECTOR},'
    f'"direction":{_VECTOR},"extended":%s,"handId":%d,"id":%d,"length":%.6g,"mcpPosition":{_VECTOR},'
    f'"pipPosition":{_VECTOR},"timeVisible":%.6g,"tipPosition":{_VECTOR},"type":%d,"width":%.6g'
)
_FINGER_ENDS = {
    "2.x": f',"stabilizedTipPosition":{_VECTOR},"tipVelocity":{_VECTOR},"tool":false,"touchDistance":1,'
    '"touchZone":"none"}',
    "new": "}",
}


def _hand(hand: ReportedHand, fields: str) -> str:
    g, model, grab = hand.geometry, hand.model, hand.grab
    if fields == "new":
        more = [min(float(hand.flexion[1:].sum(axis=1).mean()), np.pi), float(np.linalg.norm(g.tips[0] - g.tips[1]))]
    else:
        radius = 60.0 - 25.0 * grab
        more = [*(g.palm + radius * g.normal).tolist(), radius, *hand.stable_palm.tolist()]
    basis, direction, elbow = g.arm_basis.ravel().tolist(), g.direction.tolist(), g.elbow.tolist()
    first = [*basis, model.arm_width, hand.confidence, *direction, *elbow, grab]
    palm = [*g.normal.tolist(), *g.palm.tolist(), *hand.velocity.tolist(), model.palm_width]
    numbers = [*first, *palm, pinch_strength(g.tips), hand.time_visible, *g.wrist.tolist(), *more]
    if not all(map(math.isfinite, numbers)):
        raise ValueError("A number of the hand is not finite.")
    numbers = [number + 0.0 for number in numbers]  # no negative zeros
    return (_HAND + _HAND_ENDS[fields]) % (*numbers[:18], hand.id, *numbers[18:30], model.side, *numbers[30:])


def _fingers(hand: ReportedHand, fields: str, order: Sequence[int]) -> list[str]:
    g, model, template = hand.geometry, hand.model, _FINGER + _FINGER_ENDS[fields]
    carp, mcp, pip, dip, btip = g.joints.swapaxes(0, 1)
    times = np.full((5, 1), hand.time_visible)
    columns = [g.bases.reshape(5, 36), btip, carp, dip, -g.bases[:, 2, 2], model.finger_lengths[:, None], mcp, pip]
    columns += [times, g.tips, model.finger_widths[:, None], hand.stable_tips, hand.tip_velocities]
    rows = np.concatenate(columns, axis=1) + 0.0  # no negative zeros
    if not np.isfinite(rows).all():
        raise ValueError("A number of a finger is not finite.")
    texts = ["true" if finger else "false" for finger in extended(hand.flexion)]
    fingers = []
    for i in order:
        row = rows[i].tolist()
        ids = texts[i], hand.id, 10 * hand.id + i
        rest = row[60:] if fields == "2.x" else row[60:60]
        fingers.append(template % (*row[:48], *ids, *row[48:59], i, row[59], *rest))
    return fingers
