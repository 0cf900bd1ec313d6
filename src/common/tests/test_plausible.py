"""What is refused as of another unit or another image, and that true data never are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.plausible import FARTHEST_M, OFF_CENTRE_RECTIFIED, check_intrinsics, check_near, plausible_depth
from common.poses import pose

SHAPE = 48, 64
TRUE = {  # scenes that cameras see [m]
    "a table": np.full(SHAPE, 0.7),
    "a wall of a hall": np.full(SHAPE, 8.0),
    "the end of a Kinect's range": np.full(SHAPE, 4.5),
    "the end of a D435's": np.full(SHAPE, 10.0),
    "the end of a D455's": np.full(SHAPE, 20.0),
    "the near end of a D405's": np.full(SHAPE, 0.07),
    "nothing": np.full(SHAPE, np.nan),
    "nothing, as 0": np.zeros(SHAPE),
    "all too far, by REP 117": np.full(SHAPE, np.inf),
    "all too near, by REP 117": np.full(SHAPE, -np.inf),
}
CAMERAS = {  # width, height, fx, fy, cx, cy as published
    "Kinect v1 of TUM freiburg1": (640, 480, 517.3, 516.5, 318.6, 255.3),
    "Azure Kinect WFOV binned": (512, 512, 252.3, 252.4, 256.9, 258.9),
    "pico flexx": (224, 171, 213.3, 213.3, 113.6, 86.2),
    "KITTI raw": (1392, 512, 984.2, 980.8, 690.0, 233.2),
    "EuRoC": (752, 480, 458.7, 457.3, 367.2, 248.4),
    "25 mm lens on 1/2.5 inch": (2592, 1944, 11364.0, 11364.0, 1290.0, 980.0),
    "PAL video, 4:3": (720, 576, 750.0, 820.0, 362.0, 290.0),
    "portrait": (480, 640, 525.0, 525.0, 239.5, 319.5),
}
MODES = [(2.0, 2.0), (0.5, 0.5), (1.0, 0.7), (3.0, 3.0)]  # factors of a size, for whose image the matrix is not


def matrix(fx, fy, cx, cy) -> np.ndarray:
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("name", TRUE)
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_true_depth_stays_itself(name, kind):
    depth = TRUE[name].astype(kind)
    seen = plausible_depth(depth)
    np.testing.assert_array_equal(seen[np.isfinite(depth)], depth[np.isfinite(depth)])
    assert seen.dtype == depth.dtype and not np.isfinite(seen[~np.isfinite(depth)]).any()


@given(st.floats(0.05, FARTHEST_M), st.sampled_from([0.001, 1000.0, 100.0, -1.0]), st.integers(0, 3071))
def test_another_unit_is_refused_in_any_image_that_has_a_reading(distance, factor, place):
    """Centimetres of scenes nearer than 20 cm, and metres taken for millimetres of those beyond 10 m, pass for true."""
    refused = factor < 0.0 or not 0.01 <= distance * factor <= FARTHEST_M
    sparse = np.full(SHAPE, np.nan, np.float32)
    sparse.ravel()[place] = distance
    for depth in (sparse, np.full(SHAPE, distance, np.float32)):
        assert plausible_depth(depth) is depth
        if refused:
            with pytest.raises(ValueError, match="not between 0.01 and 20 m"):
                plausible_depth(factor * depth)


@given(st.integers(0, 15), st.integers(16, 40))
def test_flying_pixels_are_no_readings_and_a_scene_of_them_is_refused(few, many):
    depth = np.full(SHAPE, 0.7, np.float32)
    depth[:few] = 65.535
    seen = plausible_depth(depth)
    np.testing.assert_array_equal(np.isnan(seen), depth > 1.0)
    np.testing.assert_array_equal(seen[few:], depth[few:])
    depth[: many + 8] = 65.535
    with pytest.raises(ValueError, match=r"65\.54|33\.12"):
        plausible_depth(depth)


@pytest.mark.parametrize("name", CAMERAS)
def test_true_cameras_are_taken_and_those_of_another_mode_or_unit_refused(name):
    width, height, *numbers = CAMERAS[name]
    K = matrix(*numbers)
    check_intrinsics(K, width, height)
    for across, down in MODES:
        with pytest.raises(ValueError, match="cannot belong to an image of"):
            check_intrinsics(K, round(width * across), round(height * down))
    for unit in (1.0 / width, 0.001, 0.003):  # normalised, and focal lengths in mm or of other units
        with pytest.raises(ValueError, match="focal lengths are 0.1 to 8 sides"):
            check_intrinsics(K * unit, width, height)


def test_a_squeezed_or_cut_image_is_named_and_rectification_may_shift_the_centre():
    for height, cut in ((360, 480), (480, 360)):
        check_intrinsics(matrix(525.0, 525.0, 319.5, 0.5 * height - 0.5), 640, height)
        with pytest.raises(ValueError, match="principal point is within 0.11"):
            check_intrinsics(matrix(525.0, 525.0, 319.5, 0.5 * height - 0.5), 640, cut)
    with pytest.raises(ValueError, match="fx / fy is 0.8 to 1.25"):
        check_intrinsics(matrix(462.0, 616.0, 319.5, 239.5), 640, 480)
    shifted = matrix(435.2, 435.2, 480.0, 252.2)
    check_intrinsics(shifted, 752, 480, OFF_CENTRE_RECTIFIED)
    with pytest.raises(ValueError, match="within 0.11 sides of the middle"):
        check_intrinsics(shifted, 752, 480)


@given(st.tuples(*[st.floats(-5.0, 5.0)] * 3))
def test_poses_in_millimetres_are_refused(position):
    T = pose(p=position)
    assert check_near(T) is T
    if np.linalg.norm(position) > 0.02:
        with pytest.raises(ValueError, match="must be at most 10 m: lengths are in metres"):
            check_near(pose(p=1000.0 * np.array(position)))
