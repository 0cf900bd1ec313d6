"""The direction that a hand approaches from: the camera's axis, the surface's normal, or straight down."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.config import choice, integer, number
from grasping.network.planes import best_plane

VIEW, NORMAL, VERTICAL = "camera", "normal", "vertical"
MAX_PIXELS = 400


@dataclass(frozen=True)
class ApproachConfig:
    """How a hand comes to a grasp."""

    kind: str = choice(VIEW, NORMAL, VERTICAL, doc="along the axis of the view, across the surface, or down")
    radius: float = number("m", above=0.0, high=0.2, doc="of the surface about the grasp that its plane is fitted to")
    noise: float = number("1/m", above=0.0, high=0.1, doc="standard deviation of a pixel's inverse depth")
    min_pixels: int = integer("px", low=10, high=400, doc="fewer pixels make no surface")
    min_share: float = number(above=0.0, high=1.0, doc="of them that must lie in one plane")
    max_tilt: float = number("deg", above=0.0, high=75.0, doc="largest angle between the approach and the view's axis")


def surface_normal(
    depth: np.ndarray, rays: np.ndarray, pixel: tuple[float, float], z: float, focal: float, config: ApproachConfig
) -> np.ndarray | None:
    """Returns the normal of the surface about a grasp, a unit vector into it in the camera's frame, shape (3,).

    None where no normal is clear: too few readings, no plane, or a plane that is tilted too far.

    Only readings within the radius before and behind the grasp are of its surface; what is left of other surfaces has
    no say, as the plane is the one that most pixels lie in.

    Args:
        depth: the image, shape (h, w) [m], NaN = none.
        rays: of its pixels, shape (h, w, 3).
        pixel: of the grasp, u, v.
        z: its depth [m].
        focal: length [px].
    """
    half = max(2, round(config.radius * focal / z))
    column, row = (round(p) for p in pixel)
    window = slice(max(0, row - half), row + half + 1), slice(max(0, column - half), column + half + 1)
    near = depth[window]
    with np.errstate(invalid="ignore"):
        known = np.abs(near - z) < config.radius
    count = int(known.sum())
    if count < config.min_pixels:
        return None
    stride = max(1, count // MAX_PIXELS)
    plane = best_plane(rays[window][known][::stride].astype(float), near[known][::stride], config.noise)
    if plane is None or plane.share < config.min_share:
        return None
    tilt = np.degrees(np.arccos(np.clip(plane.direction[2], -1.0, 1.0)))
    return plane.direction if tilt <= config.max_tilt else None
