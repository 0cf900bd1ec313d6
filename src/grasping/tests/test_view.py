"""The view from above the table, and the planes that it is found by."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from table_scene import CAMERA, depth_picture, looking_at

from common.config import parse
from common.poses import check_pose, inverse
from grasping.network.depth_image import NETWORK_SIDE, best_plane, prepare
from grasping.pipeline import view as view_module
from grasping.pipeline.projection import ApproachConfig, surface_normal
from grasping.pipeline.view import CameraView, CropConfig, NoView, TableConfig, TableView

YAML = yaml.safe_load((Path(__file__).parents[1] / "config" / "ggcnn.yaml").read_text())
CROP = parse(CropConfig, YAML["crop"])
BOX = (0.02, 0.03, 0.4, (0.06, 0.10, 0.08))
ABOVE = looking_at((0.0, 0.0, 0.8), (0.0, 0.0, 0.0))
rng = np.random.default_rng(0)


def table_view(**changes) -> TableView:
    return TableView(CROP, parse(TableConfig, {**YAML["table"], **changes}))


places = st.tuples(st.floats(0.0, 55.0), st.floats(-3.1, 3.1), st.floats(0.7, 1.1)).map(
    lambda t: (
        t[2] * np.sin(np.radians(t[0])) * np.cos(t[1]),
        t[2] * np.sin(np.radians(t[0])) * np.sin(t[1]),
        t[2] * np.cos(np.radians(t[0])),
    )
)


@settings(max_examples=10)
@given(places)
def test_from_wherever_the_camera_looks_the_view_shows_the_table_from_above(place):
    T_base_camera = looking_at(place, (0.0, 0.0, 0.0))
    view = table_view().step(depth_picture(T_base_camera, [BOX]), CAMERA)
    T_base_view = check_pose(T_base_camera @ view.T_camera_view)
    np.testing.assert_allclose(T_base_view[:3, 2], (0.0, 0.0, -1.0), atol=5e-3)
    assert T_base_view[2, 3] == pytest.approx(YAML["table"]["distance"], abs=5e-3)
    # The box's top is seen where it is, as high as it is.
    top = np.array([0.02, 0.03, 0.08, 1.0])
    u, v = view.camera.project((inverse(T_base_view) @ top)[:3])
    found = view.depth[round(v), round(u)]
    assert found == pytest.approx(T_base_view[2, 3] - 0.08, abs=6e-3)
    # What is no box is table: nothing is nearer than its top, and little of the view is nearer than the table.
    assert view.depth.min() > T_base_view[2, 3] - 0.08 - 6e-3
    assert 0.01 < view.graspable.mean() < 0.06
    np.testing.assert_array_equal(view.graspable, view.depth < np.float32(YAML["table"]["distance"]))


def test_the_views_input_is_the_networks():
    image = table_view().step(depth_picture(ABOVE, [BOX]), CAMERA).image
    assert image.input.shape == (NETWORK_SIDE, NETWORK_SIDE)
    assert image.input.dtype == np.float32
    assert abs(image.input.mean()) < 1e-4
    np.testing.assert_allclose(image.input, image.depth - image.mean, atol=1e-6)


def test_the_view_stands_while_the_table_shakes_and_follows_when_it_turns():
    views, depth = table_view(), depth_picture(looking_at((0.5, 0.0, 0.7), (0.0, 0.0, 0.0)), [BOX])
    first = views.step(depth, CAMERA).T_camera_view
    for _ in range(5):
        noisy = depth + (0.002 * rng.normal(size=depth.shape)).astype(np.float32)
        assert views.step(noisy, CAMERA).T_camera_view is first
    turned = depth_picture(looking_at((0.5, 0.1, 0.72), (0.0, 0.0, 0.0)), [BOX])
    assert views.step(turned, CAMERA).T_camera_view is not first
    views.reset()
    again = views.step(depth, CAMERA).T_camera_view
    np.testing.assert_allclose(again, first, atol=1e-6)


def test_the_view_follows_a_table_that_turns_about_its_nearest_point():
    """The distance stays as it was: only the angle says so."""
    views = table_view()
    first = views.step(depth_picture(looking_at((0.3, 0.0, 0.7), (0.0, 0.0, 0.0)), [BOX]), CAMERA).T_camera_view
    turned = views.step(depth_picture(looking_at((0.3, 0.0, 0.7), (0.05, 0.0, 0.0)), [BOX]), CAMERA).T_camera_view
    assert turned is not first


@pytest.mark.parametrize(
    ("depth", "reason"),
    [
        (np.full((480, 640), np.nan, np.float32), "no reading inside the crop"),
        (rng.uniform(0.5, 2.0, (480, 640)).astype(np.float32), "no table is seen"),
        (depth_picture(ABOVE, []), "nothing stands on the table"),
        (np.ones((300, 300), np.float32), "does not fit"),
    ],
    ids=["empty", "no table", "bare table", "small"],
)
def test_without_a_view_there_is_a_reason(depth, reason):
    with pytest.raises(NoView, match=reason):
        table_view().step(depth, CAMERA)


def test_a_wall_is_no_table():
    flat = depth_picture(looking_at((0.6, 0.0, 0.1), (0.0, 0.0, 0.0)), [])
    with pytest.raises(NoView, match=r"too flatly|no table"):
        table_view(max_slope=60.0).step(flat, CAMERA)


def test_the_cameras_view_is_the_published_nodes_image():
    depth = depth_picture(ABOVE, [BOX])
    view = CameraView(CROP).step(depth, CAMERA)
    np.testing.assert_array_equal(view.image.input, prepare(depth, view.image.crop).input)
    np.testing.assert_array_equal(view.T_camera_view, np.eye(4))
    with pytest.raises(NoView, match="no reading inside the crop"):
        CameraView(CROP).step(np.full((480, 640), np.nan, np.float32), CAMERA)


normals = st.tuples(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7)).map(lambda t: np.array([*t, 1.0]))


@settings(max_examples=30)
@given(normals, st.floats(0.4, 2.0), st.integers(0, 1000))
def test_a_plane_is_found_among_a_third_of_outliers(n, distance, seed):
    random = np.random.default_rng(seed)
    a = n / np.linalg.norm(n) / distance
    rays = np.column_stack([random.uniform(-0.3, 0.3, (600, 2)), np.ones(600)])
    depth = 1.0 / (rays @ a + 0.002 * random.normal(size=600))
    depth[:200] = random.uniform(0.3, 3.0, 200)
    plane = best_plane(rays, depth, 0.003)
    assert np.degrees(np.arccos(min(1.0, plane.direction @ (a / np.linalg.norm(a))))) < 1.0
    assert plane.distance == pytest.approx(distance, rel=0.01)
    assert 0.6 < plane.share < 0.8


@settings(max_examples=8)
@given(places, st.integers(0, 1000))
def test_the_heights_are_those_of_all_readings_one_by_one(place, seed):
    random = np.random.default_rng(seed)
    depth = depth_picture(looking_at(place, (0.0, 0.0, 0.0)), [BOX, (-0.2, 0.1, 0.0, (0.1, 0.2, 0.3))])
    depth += (0.003 * random.normal(size=depth.shape)).astype(np.float32)
    for value in (np.nan, np.inf, 0.0, -1.0):
        depth[random.random(depth.shape) < 0.02] = value
    view = table_view().step(depth, CAMERA)
    c, R, p = YAML["table"], view.T_camera_view[:3, :3], view.T_camera_view[:3, 3]
    turned = (view_module.Rays().of(CAMERA) @ R).astype(np.float32)
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y, z = np.moveaxis(depth[..., None] * turned + (-R.T @ p).astype(np.float32), -1, 0)
        u, v = (np.rint(q / z * view.camera.K[0, 0] + view.camera.K[0, 2]) for q in (x, y))
        height = np.float32(c["distance"]) - z
        shown = (height > c["min_height"]) & (height < c["max_height"]) & (depth > 0.0)
        shown &= (u >= 0) & (u < NETWORK_SIDE) & (v >= 0) & (v < NETWORK_SIDE)
    wanted = np.zeros((NETWORK_SIDE, NETWORK_SIDE), np.float32)
    for row, column, h in zip(v[shown].astype(int), u[shown].astype(int), height[shown]):
        wanted[row, column] = max(wanted[row, column], h)
    closed = cv2.morphologyEx(wanted, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    wanted = np.where(wanted > 0.0, wanted, closed)
    np.testing.assert_array_equal(view.depth, np.float32(c["distance"]) - wanted)


def test_too_few_pixels_and_pixels_in_a_row_make_no_plane():
    assert best_plane(np.ones((2, 3)), np.ones(2), 0.003) is None
    assert best_plane(np.ones((50, 3)), np.ones(50), 0.003) is None


@settings(max_examples=8)
@given(st.floats(-40.0, 40.0), st.floats(-3.1, 3.1))
def test_the_normal_at_a_grasp_is_that_of_its_own_surface(tilt, yaw):
    """A box on the table, seen from above: its top has the normal of the table; the table beside it has no say."""
    place = np.array(
        [np.sin(np.radians(tilt)) * np.cos(yaw), np.sin(np.radians(tilt)) * np.sin(yaw), np.cos(np.radians(tilt))]
    )
    T_base_camera = looking_at(0.8 * place, (0.0, 0.0, 0.0))
    depth = depth_picture(T_base_camera, [BOX])
    point = (inverse(T_base_camera) @ [0.02, 0.03, 0.08, 1.0])[:3]
    pixel = tuple(CAMERA.project(point))
    u, v = np.meshgrid(np.arange(640), np.arange(480))
    rays = CAMERA.rays(np.stack((u, v), axis=-1))
    config = parse(ApproachConfig, {**YAML["approach"], "radius": 0.04, "max_tilt": 60.0})
    found = surface_normal(depth, rays, pixel, point[2], 570.0, config)
    down = T_base_camera[:3, :3] @ found
    assert np.degrees(np.arccos(np.clip(-down[2], -1.0, 1.0))) < 2.0


def test_a_thin_thing_before_a_large_background_has_its_own_normal():
    config = parse(ApproachConfig, {**YAML["approach"], "radius": 0.03})
    u, v = np.meshgrid(np.arange(640), np.arange(480))
    rays = CAMERA.rays(np.stack((u, v), axis=-1))
    depth = np.full((480, 640), 0.9)
    strip = np.abs(u - 320) < 6
    n = np.array([0.0, np.sin(0.4), np.cos(0.4)])
    depth[strip] = (0.8 * n[2] / (rays @ n))[strip]
    found = surface_normal(depth, rays, (320.0, 240.0), 0.8, 570.0, config)
    np.testing.assert_allclose(found, n, atol=1e-3)


def test_a_surface_without_a_clear_normal_has_none():
    config = parse(ApproachConfig, YAML["approach"])
    u, v = np.meshgrid(np.arange(640), np.arange(480))
    rays = CAMERA.rays(np.stack((u, v), axis=-1))
    empty = np.full((480, 640), np.nan)
    assert surface_normal(empty, rays, (320.0, 240.0), 0.8, 570.0, config) is None
    rough = 0.8 + rng.uniform(-0.012, 0.012, (480, 640))
    assert surface_normal(rough, rays, (320.0, 240.0), 0.8, 570.0, config) is None
    steep = 0.8 / (1.0 + 2.5 * rays[..., 0])
    assert surface_normal(steep, rays, (319.5, 239.5), 0.8, 570.0, config) is None
