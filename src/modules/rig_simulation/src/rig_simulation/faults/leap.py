"""Faults of the simulated Leap service, and their effect on its stream of frames."""

from __future__ import annotations

import json
import random
from collections.abc import Callable

import numpy as np

from leap_motion.service import wire
from rig_simulation.faults.injection import DelayLine, Fault, Faults, FaultValue, fraction_of, garbled

RIGHT_MM = "offset to the right [mm]"
LEAP_FAULTS = (
    Fault("cut", "connections are reset, and so is every new one"),
    Fault("half_open", "cable unplugged: nothing is read or sent, not even pongs; connections stay"),
    Fault("silent", "connections stay, but no frames arrive", fraction_of("frames")),
    Fault("slow", "every frame arrives late", FaultValue("delay [s]", 0.3, 0.001, 60.0)),
    Fault("bursts", "frames are held back, then arrive all at once", FaultValue("their period [s]", 0.1, 0.01, 10.0)),
    Fault("low_rate", "most frames are dropped", FaultValue("remaining frame rate [Hz]", 10.0, 0.1, 100.0)),
    Fault("garbled", "frames are truncated, not JSON, without a list of hands, or contain NaN", fraction_of("frames")),
    Fault("restarted", "the service stops and its port closes; when the fault ends, ids and clock start again"),
    Fault("unplugged", "the sensor is unplugged, clients get its event; no frames"),
    Fault("frozen", "the same frame arrives again and again"),
    Fault("hand_lost", "frames contain no hand"),
    Fault("hand_swapped", "the service takes the hand for the other one, left or right, with a new id"),
    Fault("hand_moved", "the hand is detected elsewhere with a new id", FaultValue(RIGHT_MM, 100.0, -500.0, 500.0)),
    Fault("mirrored", "the x axis of all positions and directions points the other way"),
    Fault("scaled", "all lengths are in another unit", FaultValue("factor", 0.1, 0.001, 1000.0)),
    Fault("second_hand", "a second hand appears beside the first", FaultValue(RIGHT_MM, 250.0, -500.0, 500.0)),
    Fault(
        "outliers", "the hand jumps in one of forty frames", FaultValue("upward offset [mm]", 200.0, -1000.0, 1000.0)
    ),
    Fault("low_confidence", "the hand is poorly visible", FaultValue("confidence", 0.02, 0.0, 1.0)),
)
OF_HANDS = {
    *("hand_lost", "hand_swapped", "hand_moved", "mirrored", "scaled", "second_hand", "outliers", "low_confidence"),
}


class FrameStream:
    """Delays, drops and changes the frames on their way out. Time is handed in."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._random = random.Random(0)
        self._waiting: DelayLine[str] = DelayLine()
        self._frozen: str | None = None
        self._next = self._burst = float("-inf")
        self._hands = HandFaults()

    def pass_on(self, frame: str, now: float) -> list[str]:
        """Takes the frame of the time `now` [s]; returns the frames to send now, oldest first."""
        faults = self._faults.active()
        if "silent" in faults and self._random.random() < faults["silent"]:
            return []
        if "low_rate" in faults:
            if now < self._next:
                return []
            self._next = max(self._next + 1.0 / faults["low_rate"], now)
        frame = self._hands.change(frame, faults)
        self._frozen = (self._frozen or frame) if "frozen" in faults else None
        frame = self._frozen or frame
        if "garbled" in faults and self._random.random() < faults["garbled"]:
            frame = broken(frame, self._random)
        self._waiting.put(frame, now + faults.get("slow", 0.0))
        if "bursts" in faults:
            if now < self._burst + faults["bursts"]:
                return []
            self._burst = now
        return self._waiting.take(now)


class HandFaults:
    """Changes the hands of frames; counts new ids, and frames between outliers."""

    def __init__(self) -> None:
        self._renamed = 0
        self._moved: set[str] = set()
        self._frames = 0

    def change(self, frame: str, faults: dict[str, float]) -> str:
        new_id = 1000  # offsets of hand ids: the service never uses an id twice
        second_id = 500
        outlier_period = 40
        moved = {"hand_swapped", "hand_moved"} & faults.keys()
        self._renamed += moved != self._moved
        self._moved = moved
        if not OF_HANDS & faults.keys() and not self._renamed:
            return frame
        self._frames += 1
        message = wire.with_ids(json.loads(frame), new_id * self._renamed)
        if "hand_lost" in faults:
            message = {**message, "hands": [], "pointables": []}
        if "hand_swapped" in faults:
            message = _swapped(message)
        if "hand_moved" in faults:
            message = wire.shifted(message, (faults["hand_moved"], 0.0, 0.0))
        if "mirrored" in faults:
            message = wire.reflected(message, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        if "scaled" in faults:
            message = wire.scaled(message, faults["scaled"])
        if "low_confidence" in faults:
            message["hands"] = [{**hand, "confidence": faults["low_confidence"]} for hand in message["hands"]]
        if "outliers" in faults and self._frames % outlier_period == 0:
            message = wire.shifted(message, (0.0, faults["outliers"], 0.0))
        if "second_hand" in faults:
            other = wire.with_ids(wire.shifted(message, (faults["second_hand"], 0.0, 0.0)), second_id)
            message.update({key: message[key] + other[key] for key in ("hands", "pointables")})
        return wire.text(message)


def broken(frame: str, rng: random.Random) -> str:
    """Returns an invalid frame, broken in one of several ways."""
    message = json.loads(frame)
    ways: list[Callable[[], str]] = [
        lambda: frame[: rng.randrange(len(frame))],
        lambda: garbled(frame.encode("ascii"), rng).decode("latin-1"),
        lambda: wire.text({key: value for key, value in message.items() if key != "hands"}),
        lambda: wire.text({**message, "hands": [{"id": "none", "palmPosition": [0, 0]}]}),
        lambda: json.dumps({**message, "timestamp": float("nan")}),
    ]
    return rng.choice(ways)()


def _swapped(message: dict) -> dict:
    """Returns the hands as those of the other side: their fingers change places across the palm's length."""
    other = {"left": "right", "right": "left"}
    hands, pointables = [], list(message["pointables"])
    for hand in message["hands"]:
        across = np.cross(hand["direction"], hand["palmNormal"])
        own = {"hands": [hand], "pointables": [p for p in pointables if p["handId"] == hand["id"]]}
        mirrored = wire.reflected(own, across.tolist(), hand["palmPosition"])
        pointables = [p for p in pointables if p["handId"] != hand["id"]] + mirrored["pointables"]
        hands.append({**mirrored["hands"][0], "type": other[hand["type"]]})
    return {**message, "hands": hands, "pointables": pointables}
