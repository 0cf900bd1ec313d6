"""Photometric refinement of the board detections in a view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from apriltag_ros.photometric import PhotometricRefiner
from common.camera_model import CameraModel
from vision.calibration.acceptance import BoardDetection


def refined(
    pairs: list[tuple[BoardDetection, np.ndarray]], camera: CameraModel, refiner: PhotometricRefiner
) -> tuple[list[BoardDetection], str]:
    """Returns the detections with refined poses and an empty string.

    If one image cannot be used, all detections stay unrefined, because the errors of both kinds differ; the string is
    then the reason, without a full stop.

    Args:
        pairs: detections by the corners, each with its image, shape (height, width), uint8.
        camera: model of the raw images, distortion included.

    Raises:
        ValueError: an image does not have the camera's size.
    """
    better = []
    for detection, grey in pairs:
        result = refiner.refine(grey, camera, detection.T_camera_board)
        if result.covariance is None:
            return [detection for detection, _ in pairs], result.rejection
        better.append(replace(detection, T_camera_board=result.T_camera_tag, covariance=result.covariance))
    return better, ""
