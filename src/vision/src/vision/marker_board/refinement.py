"""Sights of the panel made better by the whole pattern, where the pictures of a view allow it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from apriltag_ros.photometric import PhotometricRefiner
from common.camera_model import CameraModel
from vision.calibration.acceptance import Sight


def refined(
    seen: list[tuple[Sight, np.ndarray]], camera: CameraModel, refiner: PhotometricRefiner
) -> tuple[list[Sight], str]:
    """Returns the sights with refined poses, or, if one picture of the view does not allow that, all as they were, and
    the reason as a sentence without its end; poses of both kinds are not mixed, because they err in different ways.

    Args:
        seen: sights by the corners, each with its picture, shape (height, width), uint8.
        camera: that took the pictures, distortion included.
        refiner: of the panel.

    Raises:
        ValueError: a picture is not of the camera's size.
    """
    better = []
    for sight, grey in seen:
        found = refiner.refine(grey, camera, sight.T_camera_panel)
        if found.covariance is None:
            return [sight for sight, _ in seen], found.refused
        better.append(replace(sight, T_camera_panel=found.T_camera_tag, covariance=found.covariance))
    return better, ""
