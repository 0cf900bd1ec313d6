"""The metric hand in a camera's axes, from the landmarks that MediaPipe Hands finds in an image.

Camera axes: x to the image's right, y down, z out of the camera; millimetres. Landmarks are MediaPipe's 21: wrist, then
four joints of thumb to pinky. "Rays" are landmarks in the image plane at distance 1: (x / z, y / z). "World landmarks"
are MediaPipe's estimate of the hand's shape: without place, of unsure size, turned as seen along the ray to the hand.

The palm is the Leap's own rigid template, scaled to the person's palm width: orientation from the world landmarks,
position by least squares of the rays. Solving for the orientation as well (PnP) doubles the jitter of the angles."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from leap_motion.service.hand import KNUCKLES_MM, PALM_WIDTH_MM, WRIST_MM

PALM = [0, 5, 9, 13, 17]  # wrist and knuckles: the rigid landmarks
TEMPLATE_MM = np.vstack([[6.3, 4.0, 59.5], KNUCKLES_MM[1:]])
"""PALM of a right hand in palm axes (x to the pinky's side, y out of the back of the hand, z to the wrist), from the
centre of the palm. MediaPipe's wrist is 10 mm farther from the knuckles than the Leap's, in a filmed hand's mean."""
CARPS_MM = np.array([[-11.87, 12.10, 43.26], [-0.88, 13.58, 40.60], [10.41, 12.60, 39.65], [21.41, 5.68, 41.81]])
"""Starts of the metacarpals of index to pinky, which MediaPipe does not find; in palm axes."""
OPEN_CURL, FIST_CURL = math.radians(100.0), math.radians(250.0)  # sum of the bends of a finger from the wrist on


@dataclass(frozen=True)
class CameraHand:
    """A hand as the camera sees it."""

    side: str  # "right" or "left"
    axes: np.ndarray  # palm axes as columns of a rotation, shape (3, 3); of a left hand x points to the thumb's side
    palm: np.ndarray  # centre of the palm in camera axes, shape (3,) [mm]
    joints: np.ndarray  # carp, mcp, pip, dip, btip of thumb to pinky in palm axes from the palm, shape (5, 5, 3) [mm]
    wrist: np.ndarray  # in palm axes from the palm, shape (3,) [mm]
    residual: float  # RMS distance of the palm's landmarks from where this palm projects to, relative to its size

    @property
    def distance(self) -> float:
        """Distance from the camera along its axis [mm]."""
        return float(self.palm[2])


def camera_hand(side: str, rays: np.ndarray, world: np.ndarray, palm_width: float) -> CameraHand | None:
    """Returns the hand whose landmarks have these rays, shape (21, 2), and world landmarks, shape (21, 3) [any
    unit]; `palm_width` [mm]. None where no hand in front of the camera has them."""
    max_ray = 3.0  # beyond this no camera sees
    # A fist folds the palm: its landmarks span so much less. Two fists of the filmed hand, whose forearm keeps its
    # width within 1 %, without this seem 14 % farther away.
    fist_fold = 0.13
    flatness = 0.02  # least ratio of the palm's breadth to its length in world landmarks
    if not (np.isfinite(rays).all() and np.isfinite(world).all() and np.abs(rays).max() < max_ray):
        return None
    world = world - world[PALM].mean(axis=0)
    mirror = np.array([-1.0 if side == "left" else 1.0, 1.0, 1.0])
    scale = palm_width / PALM_WIDTH_MM * (1.0 - fist_fold * _fist(world))
    template = TEMPLATE_MM * mirror * scale
    centred = template - template.mean(axis=0)
    left, stretch, right = np.linalg.svd(centred.T @ world[PALM])
    size = float(np.linalg.norm(world[PALM]))
    if not 1e-9 < size < 1e9 or stretch[1] < flatness * stretch[0]:
        return None
    left[:, 2] *= np.linalg.det(left) * np.linalg.det(right)
    axes = _along(rays[PALM].mean(axis=0)) @ (left @ right).T
    palm, residual = _position(template @ axes.T, rays[PALM])
    if palm is None:
        return None
    shape = world * (float(np.linalg.norm(centred)) / size) @ (left @ right).T  # in palm axes
    return CameraHand(side, axes, palm, _joints(shape, template, scale * mirror), WRIST_MM * mirror * scale, residual)


def _along(ray: np.ndarray) -> np.ndarray:
    """Returns the shortest rotation of the camera's axis to a ray, shape (3, 3)."""
    z = np.array([ray[0], ray[1], 1.0])
    z /= np.linalg.norm(z)
    x, y, c = z
    k = 1.0 / (1.0 + c)
    return np.array([[1.0 - k * x * x, -k * x * y, x], [-k * x * y, 1.0 - k * y * y, y], [-x, -y, c]])


def _position(points: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray | None, float]:
    """Returns the shift that brings points, shape (n, 3) [mm], onto rays, shape (n, 2), by least squares, and the
    RMS distance of the rays from the shifted points' against the spread of the rays; None for one behind the camera."""
    n = len(points)
    matrix = np.zeros((2 * n, 3))
    matrix[0::2, 0] = matrix[1::2, 1] = 1.0
    matrix[:, 2] = -rays.ravel()
    shift = np.linalg.lstsq(matrix, (rays * points[:, 2:] - points[:, :2]).ravel(), rcond=None)[0]
    seen = points + shift
    spread = float(np.linalg.norm(rays - rays.mean(axis=0)))
    if not (seen[:, 2] > 1.0).all() or spread < 1e-4:
        return None, 0.0
    return shift, float(np.linalg.norm(seen[:, :2] / seen[:, 2:] - rays)) / spread


def _fist(world: np.ndarray) -> float:
    """Returns how far index to pinky are closed, 0 open to 1 fist."""
    wrist = 0
    chains = np.concatenate([np.broadcast_to(world[wrist], (4, 1, 3)), world[5:].reshape(4, 4, 3)], axis=1)
    bones = np.diff(chains, axis=1)
    bones /= np.maximum(np.linalg.norm(bones, axis=2, keepdims=True), 1e-12)
    bends = np.arccos(np.clip((bones[:, :-1] * bones[:, 1:]).sum(axis=2), -1.0, 1.0))
    return float(np.clip((bends.sum(axis=1).mean() - OPEN_CURL) / (FIST_CURL - OPEN_CURL), 0.0, 1.0))


def _joints(shape: np.ndarray, template: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Returns the joints as CameraHand has them: knuckles of the template, fingers of the shape, shape (21, 3)."""
    joints = np.empty((5, 5, 3))
    joints[0, 1] = KNUCKLES_MM[0] * scale
    joints[1:, 1] = template[1:]
    chains = shape[1:].reshape(5, 4, 3)
    joints[:, 2:] = joints[:, 1:2] + chains[:, 1:] - chains[:, :1]
    joints[0, 0], joints[1:, 0] = joints[0, 1], CARPS_MM * scale
    return joints
