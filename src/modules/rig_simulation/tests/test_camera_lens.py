"""The lens: what the camera's pixels see in the pinhole window, against the camera model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.camera_model import CameraModel, pinhole
from rig_simulation.devices.camera.sensors import CameraLens

K = np.array([[150.0, 0.0, 82.0], [0.0, 148.0, 57.5], [0.0, 0.0, 1.0]])
BARREL = np.array([0.08, -0.12, 0.002, 0.003, 0.0])


@pytest.fixture(scope="module")
def camera() -> CameraModel:
    plain = pinhole("small", 160, 120, K)
    return CameraModel("small", 160, 120, plain.K, BARREL, plain.R, plain.P)


def directions(lens: CameraLens) -> tuple[np.ndarray, np.ndarray]:
    """Returns x (to the right) and y (up) of the window's pixel centres in the plane at 1 m, rows from the bottom."""
    window = lens.window
    x = window.left + (np.arange(window.width) + 0.5) / window.width * (window.right - window.left)
    y = window.bottom + (np.arange(window.height) + 0.5) / window.height * (window.top - window.bottom)
    return np.meshgrid(x, y)


def test_each_pixel_sees_its_own_ray(camera):
    lens = CameraLens(camera)
    x, y = directions(lens)
    u, v = np.meshgrid(np.arange(160), np.arange(120))
    rays = camera.rays(np.stack((u, v), axis=-1))
    # The map's coordinates are whole 1/32 px.
    np.testing.assert_allclose(lens.distort(x.astype(np.float32)), rays[..., 0], atol=0.5 / 32 / 150 + 1e-5)
    np.testing.assert_allclose(lens.distort(y.astype(np.float32)), -rays[..., 1], atol=0.5 / 32 / 148 + 1e-5)


def test_the_nearest_pixel_is_at_most_half_a_pixel_away(camera):
    lens = CameraLens(camera)
    x, _ = directions(lens)
    straight = lens.distort_nearest(x.astype(np.float32), np.zeros((120, 160, 2), np.int16))
    assert np.abs(straight - lens.distort(x.astype(np.float32))).max() <= 0.52 / 150


def test_a_shift_goes_to_the_right_and_up(camera):
    lens = CameraLens(camera)
    shift = np.broadcast_to(np.array([2, 1], np.int16), (120, 160, 2))
    for picture, step in zip(directions(lens), (2 / 150, 1 / 148)):
        picture = picture.astype(np.float32)
        moved = lens.distort_nearest(picture, shift) - lens.distort_nearest(picture, np.zeros_like(shift))
        np.testing.assert_allclose(moved, step, atol=1e-5)


@settings(max_examples=30)
@given(dx=st.floats(-0.5, 0.5), dy=st.floats(-0.5, 0.5))
def test_a_window_sampled_beside_its_centres_shows_the_same(camera, dx, dy):
    lens = CameraLens(camera, (dx, dy))
    x, y = directions(lens)
    expected = CameraLens(camera).distort(x.astype(np.float32))
    np.testing.assert_allclose(lens.distort((x + dx / 150).astype(np.float32)), expected, atol=1.1 / 32 / 150)
    expected = CameraLens(camera).distort(y.astype(np.float32))
    np.testing.assert_allclose(lens.distort((y + dy / 148).astype(np.float32)), expected, atol=1.1 / 32 / 148)
