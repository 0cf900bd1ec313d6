"""Messages of the service as JSON text: header, device event, frames in both field sets; millimetres, six digits.

Field set "2.x" is that of services 2.0 to 2.3.1, "new" that of later services and of the bridge for current ones.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any

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


def frame(hands: Sequence[ReportedHand], rate: float, fields: str, order: Sequence[int] = range(5)) -> dict:
    """Returns a frame without `id` and `timestamp`, which the playback adds. `rate`: the service's estimate of the
    frame rate [Hz]; `fields`: one of FIELD_SETS; `order`: of the fingers of a hand, which the service does not sort.
    """
    message = {
        "currentFrameRate": six(rate),
        "hands": [_hand(hand, fields) for hand in hands],
        "pointables": [_finger(hand, i, fields) for hand in hands for i in order],
    }
    if fields == "new":
        return {**message, "devices": []}
    return {**message, **MOTION_FACTORS, "gestures": [], "interactionBox": BOX}


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


def _hand(hand: ReportedHand, fields: str) -> dict:
    g = hand.geometry
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
        pinch = float(np.linalg.norm(g.tips[0] - g.tips[1]))
        return {
            **message,
            "grabAngle": six(min(float(hand.flexion[1:].sum(axis=1).mean()), np.pi)),
            "pinchDistance": six(pinch),
        }
    radius = 60.0 - 25.0 * hand.grab
    sphere = {"sphereCenter": six(g.palm + radius * g.normal), "sphereRadius": six(radius)}
    return {**message, **MOTION_FACTORS, **sphere, "stabilizedPalmPosition": six(hand.stable_palm)}


def _finger(hand: ReportedHand, i: int, fields: str) -> dict:
    g = hand.geometry
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
    return {
        **message,
        "stabilizedTipPosition": six(hand.stable_tips[i]),
        "tipVelocity": six(hand.tip_velocities[i]),
        "tool": False,
        "touchDistance": 1,
        "touchZone": "none",
    }
