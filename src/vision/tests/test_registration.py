"""Laws of registration: where points of the depth image land, which of two stays, what the cloud holds."""

from dataclasses import replace

import depth_scene
import numpy as np
import pytest
from depth_scene import DEPTH, T_RGB_DEPTH
from hypothesis import given, settings
from hypothesis import strategies as st

from common.poses import pose, read_only
from common.rotations import rotation_from_zyx
from vision.camera.registration import Registration, millimetres_from_metres

RGB = replace(depth_scene.RGB, R=read_only(rotation_from_zyx(0.01, -0.02, 0.005)))
REGISTRATION = Registration(RGB, DEPTH, T_RGB_DEPTH)
NONE = np.full((480, 640), np.nan, np.float32)


def one_point(u, v, z):
    image = NONE.copy()
    image[v, u] = z
    return REGISTRATION.register(image)


@settings(max_examples=10)
@given(u=st.integers(60, 580), v=st.integers(60, 420), z=st.floats(0.5, 3.5))
def test_a_point_lands_where_the_rectified_camera_sees_it(u, v, z):
    X = RGB.R @ (T_RGB_DEPTH[:3, :3] @ (DEPTH.rays((u, v)) * z) + T_RGB_DEPTH[:3, 3])
    registered = one_point(u, v, z)
    rows, columns = np.nonzero(np.isfinite(registered))
    assert len(rows) == 1
    assert np.abs(RGB.rectified().project(X) - (columns[0], rows[0])).max() <= 0.501
    assert registered[rows[0], columns[0]] == pytest.approx(X[2], rel=1e-5)


@settings(max_examples=6)
@given(slant=st.floats(-0.4, 0.4), z=st.floats(0.6, 2.0))
def test_unrectified_is_the_depth_of_what_the_raw_colour_image_shows(slant, z):
    """A slanted wall: every pixel of the raw image looks at one place of it."""
    normal = np.array([slant, 0.0, 1.0])
    n = T_RGB_DEPTH[:3, :3].T @ normal
    rays = DEPTH.rays(np.stack(np.meshgrid(np.arange(640), np.arange(480)), axis=-1))
    depth = ((z - normal @ T_RGB_DEPTH[:3, 3]) / (rays @ n)).astype(np.float32)
    taken = REGISTRATION.unrectified(REGISTRATION.register(depth))
    v, u = np.nonzero(np.isfinite(taken[60:420, 80:560]))
    u, v = u + 80, v + 60
    seen = RGB.rays(np.stack((u, v), axis=-1))
    expected = (seen * (z / (seen @ normal))[:, None]) @ RGB.R[2]
    assert len(u) > 0.9 * 360 * 480
    np.testing.assert_allclose(taken[v, u], expected, rtol=0.004)


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_it_is_the_projection_of_every_point_and_the_nearest_of_each_pixel(seed):
    rng = np.random.default_rng(seed)
    depth = np.kron(rng.uniform(0.3, 4.0, (12, 16)), np.ones((40, 40))).astype(np.float32)
    odd = rng.random(depth.shape) < 0.1
    depth[odd] = rng.choice([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-30, 1e30], odd.sum())
    K, R = REGISTRATION.camera.K, RGB.R @ T_RGB_DEPTH[:3, :3]
    z = depth[np.isfinite(depth) & (depth > 0.0)].astype(float)
    points = depth_scene.RAYS[np.isfinite(depth) & (depth > 0.0)] * z[:, None] @ R.T + RGB.R @ T_RGB_DEPTH[:3, 3]
    points = points[points[:, 2] > 0.0]
    pixels = (points @ K.T)[:, :2] / points[:, 2:]
    inside = (np.abs(pixels - (319.5, 239.5)) < (320.0, 240.0)).all(axis=1)
    expected = np.full((480, 640), np.inf)
    u, v = np.rint(pixels[inside]).astype(int).T
    np.minimum.at(expected, (v, u), points[inside, 2])
    registered = REGISTRATION.register(depth)
    same = np.isclose(np.where(np.isnan(registered), np.inf, registered), expected, rtol=1e-5)
    assert same.mean() > 0.9995  # a pixel's border can fall to either side


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_cloud_and_the_millimetres_are_those_of_their_formulas(seed):
    rng = np.random.default_rng(seed)
    registered = rng.uniform(-1.0, 70.0, (480, 640)).astype(np.float32)
    registered[rng.random(registered.shape) < 0.3] = np.nan
    colour = rng.integers(0, 256, (480, 640, 3), np.uint8)
    cloud = REGISTRATION.cloud(registered, colour)
    u, v = np.meshgrid(np.arange(640), np.arange(480))
    K = REGISTRATION.camera.K
    np.testing.assert_allclose(cloud["x"], (u - K[0, 2]) / K[0, 0] * registered, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(cloud["y"], (v - K[1, 2]) / K[1, 1] * registered, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(cloud["z"], registered)
    np.testing.assert_array_equal(cloud["rgb"], colour.astype(np.uint32) @ [1 << 16, 1 << 8, 1])
    with np.errstate(invalid="ignore"):
        scaled = registered * np.float32(1000.0)
        expected = np.where((scaled >= 0.0) & (scaled <= 65535.0), np.rint(scaled), 0.0)
    np.testing.assert_array_equal(millimetres_from_metres(registered), expected)


def test_the_rectified_image_shows_things_where_the_rectified_camera_sees_them():
    X = np.array([0.25, -0.15, 1.0])
    u, v = RGB.project(X)
    colour = np.zeros((480, 640, 3), np.uint8)
    colour[round(v) - 2 : round(v) + 3, round(u) - 2 : round(u) + 3] = 255
    rows, columns = np.nonzero(REGISTRATION.rectify(colour)[..., 0] > 127)
    np.testing.assert_allclose((columns.mean(), rows.mean()), REGISTRATION.camera.project(RGB.R @ X), atol=0.8)


def test_nothing_and_nonsense_register_to_nothing():
    for value in (np.nan, np.inf, -np.inf, 0.0, -1.0):
        assert np.isnan(REGISTRATION.register(np.full((480, 640), value, np.float32))).all()
    behind = Registration(RGB, DEPTH, pose(p=(0.0, 0.0, -5.0)))
    assert np.isnan(behind.register(np.full((480, 640), 1.0, np.float32))).all()


def test_images_of_another_size_are_named():
    with pytest.raises(ValueError, match="depth"):
        REGISTRATION.register(np.ones((240, 320), np.float32))
    with pytest.raises(ValueError, match="colour"):
        REGISTRATION.rectify(np.ones((240, 320, 3), np.uint8))


def test_millimetres():
    metres = np.array([[np.nan, np.inf, -1.0, 0.0, 1.2344, 65.534, 65.6, 100.0]], np.float32)
    np.testing.assert_array_equal(millimetres_from_metres(metres), [[0, 0, 0, 0, 1234, 65534, 0, 0]])
