"""What depth images, cameras and sizes can be: anything else is in another unit, or belongs to another image. The
bounds are wide enough for every camera that an arm may have, and narrow enough that metres, centimetres and
millimetres, and the modes of one camera, are told apart."""

from __future__ import annotations

import numpy as np

FARTHEST_M = 20.0  # the farthest range that an RGB-D camera states (D455); in millimetres every scene is beyond it
NEAREST_M = 0.01  # no such camera measures as near; metres in whole numbers, read as millimetres, are below it
FAR_POSE_M = 10.0  # no part of a rig, nor a camera that sees it, is as far from another
OFF_CENTRE = 0.11  # principal point from the middle, in sides: an Azure Kinect has 0.09, 16:9 cut to 4:3 has 0.125
OFF_CENTRE_RECTIFIED = 0.2  # rectification shifts it; that of half the image is off by 0.25


def plausible_depth(depth: np.ndarray) -> np.ndarray:
    """Returns a depth image, shape (h, w) [m], without the readings beyond `FARTHEST_M`, which become NaN; it stays
    itself where there is no such reading. Not finite or 0 = no reading. Raises ValueError if most readings cannot be
    metres before a camera."""
    step = 4  # between the rows and columns by which an image is judged, if there is a reading
    with np.errstate(invalid="ignore"):
        beyond = depth > FARTHEST_M
        few = depth[::step, ::step]
        readings = few[np.isfinite(few) & (few != 0.0)]
        if not readings.size:
            readings = depth[np.isfinite(depth) & (depth != 0.0)]
    middle = float(np.median(readings)) if readings.size else NEAREST_M
    if not NEAREST_M <= middle <= FARTHEST_M:
        raise ValueError(
            f"the median of the depth is {middle:.4g} m, which is not between {NEAREST_M:g} and {FARTHEST_M:g} m: "
            "depth is in metres as floating-point numbers, in millimetres as 16-bit ones"
        )
    return np.where(beyond, np.float32(np.nan), depth) if beyond.any() else depth


def check_intrinsics(matrix: np.ndarray, width: int, height: int, off_centre: float = OFF_CENTRE) -> None:
    """Raises ValueError if a camera matrix, shape (3, 3) or (3, 4) [px], cannot be that of a whole image of this size:
    it is of another size, mode or aspect, or not in pixels. The principal point is at most `off_centre` sides from the
    middle."""
    shortest = 0.1  # focal length in sides of the image: 157 deg of view, and a 50 mm lens before 7 mm
    longest = 8.0
    non_square = 1.25  # fx / fy of pixels of 4:3 video; an image that was squeezed from 16:9 has 1.33
    skew_px = 0.1  # of what is 0 in a camera matrix
    (fx, cx), (fy, cy) = matrix[0, [0, 2]], matrix[1, [1, 2]]
    side, found = max(width, height), ""
    if not all(shortest * side < f < longest * side for f in (fx, fy)):
        found = f"the focal lengths are {shortest:g} to {longest:g} sides of an image"
    elif not 1.0 / non_square < fx / fy < non_square:
        found = f"fx / fy is {1.0 / non_square:g} to {non_square:g}"
    elif max(abs((cx + 0.5) / width - 0.5), abs((cy + 0.5) / height - 0.5)) > off_centre:
        found = f"the principal point is within {off_centre:g} sides of the middle"
    if found:
        raise ValueError(
            f"the focal lengths {fx:.5g} and {fy:.5g} and the principal point {cx:.5g}, {cy:.5g} px cannot belong to "
            f"an image of {width} x {height}, for which {found}: use the calibration of this image size"
        )
    others = matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] - (0.0, 0.0, 0.0, 0.0, 1.0)
    if not np.all(np.abs(others) < skew_px):
        raise ValueError(f"{matrix[:, :3].tolist()} is no camera matrix, whose rows are fx, 0, cx; 0, fy, cy; 0, 0, 1")


def check_near(T: np.ndarray, farthest: float = FAR_POSE_M) -> np.ndarray:
    """Returns a pose, shape (4, 4) [m]; raises ValueError if its origin is beyond `farthest` [m], so not in metres."""
    distance = float(np.linalg.norm(T[:3, 3]))
    if distance > farthest:
        raise ValueError(f"its distance is {distance:.4g} m, but must be at most {farthest:g} m: lengths are in metres")
    return T
