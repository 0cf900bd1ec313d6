"""What a structured-light camera (Asus Xtion, Kinect 1) makes of an exact depth image.

Noise after Nguyen, Izadi and Lovell (2012) and Khoshelham and Elberink (2012); errors are alike in neighbouring
pixels, because the camera compares windows. Missing pixels are NaN.
"""

from __future__ import annotations

import cv2
import numpy as np

FOCAL_PX = 570.3
"""Focal length of the 640 x 480 image."""
BASELINE_M = 0.075
"""Between projector and camera, along the rows."""
NEAREST_M = 0.45
DISPARITY_STEP_PX = 0.125
DEPTH_STEP_M = 0.001
LATERAL_PX = 0.8
CORRELATION_PX = 2.0
"""Standard deviation of the blur that makes neighbouring errors alike."""
SCALE_ERROR = 0.005
"""Of the distances of one camera, standard deviation."""
WARP = 0.0015
"""Smooth error over the image that grows with the distance squared, standard deviation at 1 m [m]."""
STEEPEST_RAD = 1.3
"""Surfaces further from the line of sight return no pattern."""
EDGE_STEP_M = 0.01
EDGE_LOSS = 0.3
"""Share of the pixels at an edge that is lost."""
DARK_SHARE = 0.3
"""Share of the images with spots that return no pattern."""


def observe(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Returns the camera's image, shape as `depth`, float32 [m], NaN where it sees nothing.

    Args:
        depth: exact distances along the optical axis, shape (h, w) [m], at the scale of `FOCAL_PX`.
    """
    h, w = depth.shape
    angle = _incidence(depth)
    lost = shadow(depth) | (depth < NEAREST_M) | (angle > STEEPEST_RAD + 0.1 * _field(rng, depth.shape, 3.0))
    step = cv2.morphologyEx(depth.astype(np.float32), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    lost |= (step > EDGE_STEP_M) & (rng.random(depth.shape) < EDGE_LOSS)
    if rng.random() < DARK_SHARE:
        lost |= _field(rng, depth.shape, 6.0) > rng.uniform(2.4, 3.2)
    row, column = np.mgrid[:h, :w].astype(np.float32)
    shift = [LATERAL_PX * _field(rng, depth.shape, CORRELATION_PX) for _ in range(2)]
    seen = cv2.remap(
        depth.astype(np.float32), column + shift[0], row + shift[1], cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE
    )
    # The angle's term is Nguyen's for steep surfaces; beyond the steepest the reading is lost anyway.
    steep = np.minimum(angle, STEEPEST_RAD)
    sigma = 0.0012 + 0.0019 * (seen - 0.4) ** 2 + 1e-4 / np.sqrt(seen) * (steep / (0.5 * np.pi - steep)) ** 2
    seen = seen * (1.0 + SCALE_ERROR * rng.standard_normal()) + sigma * _field(rng, depth.shape, CORRELATION_PX)
    seen = seen + WARP * seen**2 * _field(rng, depth.shape, 60.0)
    disparity = np.round(FOCAL_PX * BASELINE_M / seen / DISPARITY_STEP_PX) * DISPARITY_STEP_PX
    seen = np.round(FOCAL_PX * BASELINE_M / disparity / DEPTH_STEP_M) * DEPTH_STEP_M
    return np.where(lost, np.nan, seen).astype(np.float32)


def shadow(depth: np.ndarray) -> np.ndarray:
    """Returns where the projector, `BASELINE_M` to the left, does not shine, shape as `depth`, bool.

    A point is dark when one to its left in the same row lies further right in the projector's image.
    """
    in_projector = np.arange(depth.shape[1]) + FOCAL_PX * BASELINE_M / depth
    return np.maximum.accumulate(in_projector, axis=1) > in_projector + 1e-6


def _incidence(depth: np.ndarray) -> np.ndarray:
    """Returns the angle between optical axis and surface normal [rad]; a step between two surfaces is no surface."""
    slopes = []
    for axis in (0, 1):
        step = np.abs(np.diff(depth, axis=axis))
        before, after = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
        before[axis], after[axis] = (1, 0), (0, 1)
        slopes.append(np.minimum(np.pad(step, before, mode="edge"), np.pad(step, after, mode="edge")))
    return np.arctan(np.hypot(*slopes) * FOCAL_PX / depth)


def _field(rng: np.random.Generator, shape: tuple[int, ...], blur: float) -> np.ndarray:
    """Returns normal noise of unit variance that is blurred over `blur` pixels, float32."""
    shrink = max(1, int(blur / 3.0))
    small = (max(2, -(-shape[0] // shrink)), max(2, -(-shape[1] // shrink)))
    noise = cv2.GaussianBlur(rng.standard_normal(small, dtype=np.float32), (0, 0), blur / shrink)
    noise = np.multiply(noise, np.float32(2.0 * np.sqrt(np.pi) * blur / shrink))
    return noise if shrink == 1 else cv2.resize(noise, shape[::-1], interpolation=cv2.INTER_LINEAR)
