"""MediaPipe Hands: finds hands and their landmarks in images."""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from collections.abc import Iterator

import cv2
import numpy as np

from leap_motion.webcam.hand_tracks import SeenHand
from leap_motion.webcam.lens import WebcamError, WebcamLens

SIDES = {"Left": "right", "Right": "left"}  # MediaPipe names the side of a hand in a mirror


class HandDetector:
    """Finds hands in the images of one camera, which are not mirrored: one, or all. One takes half the time, as
    nobody looks for another one while it is tracked. Raises WebcamError without MediaPipe."""

    def __init__(self, single: bool) -> None:
        warnings.filterwarnings("ignore", module="google.protobuf")
        with _quiet():
            try:
                from mediapipe.python.solutions.hands import Hands
            except ImportError as error:
                cure = "`make setup` installs it, pip the extra leap-rig-leap-motion[webcam]"
                raise WebcamError(f"MediaPipe, which finds hands in images, is missing ({error}); {cure}.") from error
            # The small model has the same jitter at 0.6 of the processor time.
            most, certain = 1 if single else 3, {"min_detection_confidence": 0.6, "min_tracking_confidence": 0.5}
            self._hands = Hands(max_num_hands=most, model_complexity=0, **certain)
            self._hands.process(np.zeros((64, 64, 3), dtype=np.uint8))  # it loads, and warns, at the first image

    def find(self, image: np.ndarray, lens: WebcamLens) -> list[SeenHand]:
        """Returns the hands in an image, shape (height, width, 3), blue first."""
        found = self._hands.process(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
        hands = []
        for points, world, sides in zip(
            found.multi_hand_landmarks or (), found.multi_hand_world_landmarks or (), found.multi_handedness or ()
        ):
            landmarks = np.array([[point.x, point.y] for point in points.landmark])
            side = sides.classification[0]
            rays = lens.rays(landmarks, image.shape)
            shape = np.array([[point.x, point.y, point.z] for point in world.landmark])
            hands.append(SeenHand(SIDES[side.label], float(side.score), landmarks, rays, shape))
        return hands


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Hides what libraries write to the standard error, from Python and from C++."""
    sys.stderr.flush()
    kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null)
