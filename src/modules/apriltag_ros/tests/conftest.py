"""Makes the tag renderer importable, and the cameras and targets of the tests."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from common.camera_model import CameraModel, pinhole
from common.poses import pose

sys.path.append(str(Path(__file__).parent))

BUNDLE = (
    (0, 0.100, 0.0, 0.0),
    (1, 0.060, -0.105, 0.105),
    (2, 0.060, 0.105, 0.105),
    (3, 0.060, -0.105, -0.105),
    (4, 0.060, 0.105, -0.105),
)
"""Tags of the marker board: id, size [m], x, y [m]."""


@pytest.fixture(scope="session")
def camera():
    """A camera with the strong distortion of a cheap lens."""
    straight = pinhole("test", 640, 480, [[545.8, 0, 326.2], [0, 547.2, 249.0], [0, 0, 1]])
    D = np.array([0.12, -0.25, 0.0017, 0.0032, 0.05])
    return CameraModel("test", 640, 480, straight.K, D, straight.R, straight.P)


@pytest.fixture(scope="session")
def bundle():
    """The marker board with five tags."""
    from apriltag_ros.settings import TagTarget, TargetTag

    return TagTarget("panel", tuple(TargetTag(i, size, pose(p=(x, y, 0.0))) for i, size, x, y in BUNDLE))


@pytest.fixture(scope="session")
def single():
    """The middle tag of the marker board alone."""
    from apriltag_ros.settings import TagTarget, TargetTag

    return TagTarget("tag", (TargetTag(*BUNDLE[0][:2]),))
