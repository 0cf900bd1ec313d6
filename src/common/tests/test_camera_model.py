"""The camera model: there and back, against OpenCV, and what it refuses."""

import copy

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.camera_model import CameraModel, distortion, from_calibration, pinhole
from common.errors import ConfigError

XTION = {
    "image_width": 640,
    "image_height": 480,
    "camera_name": "rgb",
    "camera_matrix": {"rows": 3, "cols": 3, "data": [545.8, 0, 326.2, 0, 547.2, 249.0, 0, 0, 1]},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0439, -0.1180, 0.0017, 0.0032, 0.0]},
    "rectification_matrix": {"rows": 3, "cols": 3, "data": [1, 0, 0, 0, 1, 0, 0, 0, 1]},
    "projection_matrix": {"rows": 3, "cols": 4, "data": [540.0, 0, 320.0, 0, 0, 541.0, 240.0, 0, 0, 0, 1, 0]},
}
u, v = st.floats(-0.5, 639.5), st.floats(-0.5, 479.5)


@pytest.fixture(scope="module")
def camera() -> CameraModel:
    return from_calibration(XTION)


@given(u, v, st.floats(0.1, 10.0))
def test_what_a_pixel_looks_at_is_projected_back_onto_it(camera, u, v, z):
    np.testing.assert_allclose(camera.project(z * camera.rays([u, v])), [u, v], atol=1e-6)


@given(st.lists(st.tuples(st.floats(-0.6, 0.6), st.floats(-0.5, 0.5), st.floats(0.9, 3.0)), min_size=1, max_size=9))
def test_projection_agrees_with_opencv(camera, points):
    expected, _ = cv2.projectPoints(np.array(points), np.zeros(3), np.zeros(3), camera.K, camera.D)
    np.testing.assert_allclose(camera.project(points), expected[:, 0], atol=1e-9)


def test_the_rectified_camera_has_no_distortion_and_the_projections_matrix(camera):
    rectified = camera.rectified()
    np.testing.assert_array_equal(rectified.K, camera.P[:, :3])
    np.testing.assert_array_equal(rectified.D, np.zeros(5))
    np.testing.assert_allclose(rectified.project([0.1, 0.2, 1.0]), [320.0 + 54.0, 240.0 + 108.2])


def test_a_distortion_that_folds_the_picture_over_is_refused():
    model = pinhole("wild", 640, 480, [[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]])
    wild = CameraModel(model.name, 640, 480, model.K, np.array([-5.0, 0, 0, 0, 0]), model.R, model.P)
    with pytest.raises(ValueError), np.errstate(all="ignore"):
        wild.rays([0.0, 0.0])


@pytest.mark.parametrize(
    "key, value",
    [
        ("image_width", 0),
        ("image_height", 480.0),
        ("camera_name", ""),
        ("distortion_model", "equidistant"),
        ("camera_matrix", {"data": [0.0] * 9}),
        ("camera_matrix", {"data": [1.0] * 8}),
        ("camera_matrix", {"data": [272.9, 0, 163.1, 0, 273.6, 124.5, 0, 0, 1]}),
        ("camera_matrix", {"data": [0.853, 0, 0.51, 0, 1.14, 0.519, 0, 0, 1]}),
        ("projection_matrix", {"data": [1080.0, 0, 640.0, 0, 0, 1082.0, 480.0, 0, 0, 0, 1, 0]}),
        ("distortion_coefficients", {"data": [float("nan")] * 5}),
        ("distortion_coefficients", {"data": "0.1"}),
        ("rectification_matrix", None),
        ("projection_matrix", {"data": ["a"] * 12}),
    ],
)
def test_a_bad_calibration_is_refused_and_names_the_key(key, value):
    calibration = copy.deepcopy(XTION)
    calibration[key] = value
    with pytest.raises(ConfigError, match=key):
        from_calibration(calibration)


@pytest.mark.parametrize(
    ("key", "index", "number", "said"),
    [
        ("camera_matrix", 1, 100.0, "is no camera matrix"),
        ("camera_matrix", 3, 50.0, "is no camera matrix"),
        ("camera_matrix", 8, 0.0, "is no camera matrix"),
        ("projection_matrix", 1, 80.0, "is no camera matrix"),
        ("rectification_matrix", 0, -1.0, "is no rotation"),
    ],
)
def test_a_number_of_a_calibration_that_no_camera_has_is_named(key, index, number, said):
    calibration = copy.deepcopy(XTION)
    calibration[key]["data"][index] = number
    with pytest.raises(ConfigError, match=f"{key}.*{said}"):
        from_calibration(calibration)


def test_a_rectification_of_zeros_turns_nothing():
    assert np.array_equal(from_calibration({**XTION, "rectification_matrix": {"data": [0.0] * 9}}).R, np.eye(3))


def test_all_faults_of_a_calibration_are_reported_at_once():
    with pytest.raises(ConfigError) as error:
        from_calibration({})
    assert len(error.value.faults) == 7


@pytest.mark.parametrize(
    ("model", "given", "used"),
    [
        ("plumb_bob", [], []),
        ("", [], []),
        ("none", [], []),
        ("plumb_bob", [0.1, -0.2, 0.003, 0.004], [0.1, -0.2, 0.003, 0.004]),
        ("plumb_bob", [0.1, -0.2, 0.003, 0.004, 0.05, 0, 0, 0], [0.1, -0.2, 0.003, 0.004, 0.05]),
        ("rational_polynomial", [0.1, -0.2, 0.003, 0.004, 0.05, 0, 0, 0], [0.1, -0.2, 0.003, 0.004, 0.05]),
        ("rational_polynomial", [0.1, 0, 0, 0, 0, 0.2, 0, 0], [0.1, 0, 0, 0, 0, 0.2, 0, 0]),
        ("plumb_bob", [0.1, 0, 0, 0, 0, 0.2, 0, 0], None),
        ("rational_polynomial", [0.1] * 9, None),
        ("plumb_bob", [0.1, 0, 0], None),
        ("plumb_bob", [float("inf"), 0, 0, 0, 0], None),
        ("equidistant", [0, 0, 0, 0], None),
        (None, [0, 0, 0, 0, 0], None),
    ],
)
def test_coefficients_that_drivers_give_are_taken(model, given, used):
    """Reported in https://github.com/ros-perception/image_pipeline/issues/576: distortions have 4, 5 or 8 numbers.
    Tried: camera_info with 4.
    Reported in https://github.com/orbbec/OrbbecSDK_ROS2/issues/216: plumb_bob with 8 numbers, the last three 0.
    Tried: that camera_info.
    Reported in https://github.com/realsenseai/realsense-ros/issues/2640: D is empty. Tried: that camera_info.
    """
    if used is None:
        with pytest.raises(ValueError, match="calibrate"):
            distortion(model, given)
    else:
        np.testing.assert_array_equal(distortion(model, given), np.append(used, np.zeros(max(0, 5 - len(used)))))


def test_a_calibration_of_melodics_calibrator_is_read(camera):
    """It wrote camera_model instead of distortion_model.

    Reported in https://github.com/ros-drivers/video_stream_opencv/issues/100: Melodic's calibrator writes
    `camera_model`. Tried: that calibration file.
    """
    melodic = {"camera_model" if key == "distortion_model" else key: value for key, value in XTION.items()}
    np.testing.assert_array_equal(from_calibration(melodic).D, camera.D)
