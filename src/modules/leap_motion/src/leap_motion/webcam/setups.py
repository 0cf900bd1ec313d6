"""From camera axes to Leap axes: where the camera stands, and what orientation of the hand counts as level. Leap
axes: x to the user's right, y up, z towards the user; millimetres. The Leap frame is placed so that a point
`distance` in front of the camera lies where leap_kuka's interaction box has its centre."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from leap_motion.webcam.palm_pose import CameraHand

BOX_CENTRE_MM = np.array([0.0, 350.0, 0.0])  # with the shipped workspace
STILL_RAD = math.radians(15.0)
"""A neutral pose is taken of a hand that stays so near to its mean for so long; a still hand seems to move by a third
of this while its fingers move."""


@dataclass(frozen=True)
class CameraPlacement:
    """The camera's pose in the Leap frame."""

    axes: np.ndarray  # camera axes as columns, shape (3, 3)
    origin: np.ndarray  # of the camera, shape (3,) [mm]
    neutral: bool  # whether hands are seen relative to a neutral pose

    def palm(self, hand: CameraHand) -> np.ndarray:
        """Returns the centre of the palm in the Leap frame, shape (3,) [mm]."""
        return self.origin + self.axes @ hand.palm

    def in_camera(self, points: np.ndarray) -> np.ndarray:
        """Returns points of the Leap frame, shape (n, 3) [mm], in camera axes."""
        return (points - self.origin) @ self.axes

    def centred(self, middle: np.ndarray) -> CameraPlacement:
        """Returns the pose with which a point of the Leap frame, shape (3,) [mm], is the centre of the box."""
        return replace(self, origin=self.origin + BOX_CENTRE_MM - middle)


FRONT, ABOVE = "front", "above"
SETUPS = {
    FRONT: (np.diag([-1.0, -1.0, 1.0]), 500.0),  # on a laptop's lid: the image's right is the user's left
    ABOVE: (np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), 400.0),  # the image's top is away
}
"""Camera axes in Leap axes as columns, and the distance from the camera to the centre of the box [mm]."""


def placement(setup: str, tilt: float = 0.0, distance: float | None = None) -> CameraPlacement:
    """Returns the pose of the camera of a set-up that looks up by `tilt` [rad] more than its picture shows."""
    axes, usual = SETUPS[setup]
    c, s = math.cos(tilt), math.sin(tilt)
    axes = axes @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return CameraPlacement(axes, BOX_CENTRE_MM - axes[:, 2] * (distance or usual), setup == FRONT)


class NeutralPose:
    """The pose of a hand that counts as level, and as the middle: taken while the hand is held still. `level` turns
    palm axes so that the neutral ones are Leap axes: shape (3, 3), or None before it is taken; `middle` is where the
    palm was then, shape (3,) [mm]."""

    def __init__(self) -> None:
        self.level: np.ndarray | None = None
        self.middle: np.ndarray | None = None
        self._samples: deque[tuple[float, np.ndarray, np.ndarray]] = deque()

    def forget(self) -> None:
        self.level = None
        self._samples.clear()

    def step(self, palm: np.ndarray, axes: np.ndarray, now: float) -> None:
        """Takes a sample at `now` [s]: `palm`, shape (3,) [mm], and palm axes, shape (3, 3), in the Leap frame."""
        # A neutral pose is taken of a hand that stays so near to its mean for so long; a still hand seems to move by
        # a third of this while its fingers move.
        still_s = 1.0
        still_mm = 40.0
        least_samples = 5
        if self.level is not None:
            return
        self._samples.append((now, palm, axes))
        while len(self._samples) > 1 and now - self._samples[1][0] >= still_s:
            self._samples.popleft()
        if now - self._samples[0][0] < still_s or len(self._samples) < least_samples:
            return
        palms = np.array([palm for _, palm, _ in self._samples])
        left, _, right = np.linalg.svd(sum(axes for _, _, axes in self._samples))
        mean, middle = left @ right, palms.mean(axis=0)
        turns = [0.5 * (float(np.trace(axes.T @ mean)) - 1.0) for _, _, axes in self._samples]
        if np.linalg.norm(palms - middle, axis=1).max() < still_mm and min(turns) > math.cos(STILL_RAD):
            self.level, self.middle = mean.T, middle
