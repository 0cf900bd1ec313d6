"""The hands of recorded Leap frames."""

import gzip
import json

import numpy as np

from leap_motion.frames import FingerPoints, TrackedHand


def recorded_hands(path):
    """Yields the hands of each frame of a recording; thumb 0, index 1, middle 2."""
    with gzip.open(path, "rt") as file:
        for line in file:
            frame = json.loads(line)
            hands = []
            for hand in frame["hands"]:
                fingers = {p["type"]: p for p in frame["pointables"] if p["handId"] == hand["id"]}
                bone = {i: np.add(fingers[i]["pipPosition"], fingers[i]["dipPosition"]) / 2e3 for i in (1, 2)}
                tip = {i: np.array(fingers[i]["tipPosition"]) / 1e3 for i in (0, 1, 2)}
                palm = np.array(hand["palmPosition"]) / 1e3
                points = FingerPoints(tip[1], tip[2], tip[0], bone[1], bone[2])
                is_left, vectors = hand["type"] == "left", (palm, hand["direction"], hand["palmNormal"])
                hands.append(TrackedHand(hand["id"], is_left, *vectors, hand["confidence"], points))
            yield hands
