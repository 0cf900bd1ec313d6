"""Prefers the openings that a hand holds best: the networks do not know the hand.

Where a grasp needs another opening than the hand prefers, its quality shrinks towards the threshold below which there
is no grasp. So such a grasp ranks behind the others, but is published where there is no other.
"""

from __future__ import annotations

import numpy as np

from grasping.network.maps import Maps
from grasping.pipeline.tool_pose import ToolPoseConfig


def preferred(maps: Maps, pixel_m: np.ndarray, tool: ToolPoseConfig, threshold: float) -> Maps:
    """Returns the maps with the quality that they have for a hand; it is nowhere higher than before.

    Args:
        pixel_m: what a pixel shows of the scene, shape (h, w) [m].
        threshold: of the quality; what is not above it stays as it is.
    """
    if tool.outside_quality == 1.0:
        return maps
    opening = pixel_m * np.maximum(maps.width, 0.0)
    low, high = tool.preferred_opening
    outside = np.maximum(low - opening, opening - high) / tool.outside_ramp
    left = 1.0 - (1.0 - tool.outside_quality) * np.clip(outside, 0.0, 1.0)
    shrunk = np.minimum(maps.quality, threshold + left * (maps.quality - threshold))
    quality = np.where((maps.quality > threshold) & (left < 1.0), shrunk, maps.quality)
    return maps._replace(quality=quality.astype(maps.quality.dtype))
