"""From pixels to poses, and the chain from a depth image to a grasp."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from common.camera_model import pinhole
from common.poses import check_pose
from common.rotations import rotation_about, rotation_from_zyx
from grasping.network.depth_image import Crop
from grasping.network.maps import Peak
from grasping.pipeline.pipeline import GraspPipeline, PipelineSettings
from grasping.pipeline.projection import along, camera_pixel, depth_between_fingers, project_grasp, seen_by
from grasping.pipeline.view import CameraView, CropConfig
from grasping.poses.hypotheses import turned

F = 570.3
CAMERA = pinhole("test", 640, 480, [[F, 0.0, 319.5], [0.0, F, 239.5], [0.0, 0.0, 1.0]])
CROP = Crop(40, 120, 400)


@settings(max_examples=50)
@given(st.integers(0, 299), st.integers(0, 299), st.floats(-1.57, 1.57), st.floats(0.5, 1.5))
def test_the_grasp_is_where_its_pixel_looks(row, column, angle, z):
    found = project_grasp(Peak(row, column, 0.8, angle, 60.0), CROP, 300, np.full((480, 640), z), CAMERA)
    T = found.T_camera_grasp
    np.testing.assert_allclose(CAMERA.project(T[:3, 3]), found.pixel, atol=1e-9)
    assert T[2, 3] == pytest.approx(z)
    # Both fingers, projected, lie on a line of that angle (v runs down), `width` apart in the network's image.
    ends = CAMERA.project(np.array([T[:3, 3] + s * 0.5 * found.width * T[:3, 0] for s in (-1.0, 1.0)]))
    line = (ends[1] - ends[0]) * 300 / 400
    np.testing.assert_allclose(line, 60.0 * np.array([np.cos(angle), -np.sin(angle)]), atol=1e-6)
    np.testing.assert_allclose(T[:3, 2], (0.0, 0.0, 1.0))


def test_pixels_are_within_half_a_pixel_of_the_published_rule():
    for row, column in ((0, 0), (150, 150), (299, 299), (17, 203)):
        u, v = camera_pixel(row, column, CROP, 300)
        assert abs(u - (column / 300 * 400 + 120)) < 0.5
        assert abs(v - (row / 300 * 400 + 40)) < 0.5


def test_depth_is_the_median_of_the_readings_near():
    depth = np.full((480, 640), np.nan)
    assert project_grasp(Peak(150, 150, 1.0, 0.0, 30.0), CROP, 300, depth, CAMERA) is None
    depth[239:242, 319:322] = [[0.6, 0.61, 0.62], [9.0, 0.61, np.inf], [0.0, -1.0, 0.6]]
    assert project_grasp(Peak(150, 150, 1.0, 0.0, 30.0), CROP, 300, depth, CAMERA).T_camera_grasp[
        2, 3
    ] == pytest.approx(0.61)


def test_depth_between_the_fingers_is_the_mean_of_the_ten_nearest_readings():
    depth = np.full((480, 640), np.nan)
    assert np.isnan(depth_between_fingers(depth, CROP))
    depth[180:230, 300:340] = 0.5
    depth[200, 300:310] = 0.2 + 0.01 * np.arange(10)
    depth[60, 130] = 0.05  # outside of the fingers' window
    depth[201, 300:330] = 0.0
    assert depth_between_fingers(depth, CROP) == pytest.approx(0.245)


directions = st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6)).map(lambda t: np.array([*t, 1.0]))


@settings(max_examples=50)
@given(st.integers(20, 280), st.integers(20, 280), st.floats(-1.57, 1.57), directions, st.floats(5.0, 60.0))
def test_another_approach_leaves_the_fingers_on_their_line_in_the_image(row, column, angle, direction, width):
    first = project_grasp(Peak(row, column, 0.8, angle, width), CROP, 300, np.full((480, 640), 0.8), CAMERA)
    n = direction / np.linalg.norm(direction)
    turned = along(first, n, CAMERA)
    T = check_pose(turned.T_camera_grasp)
    np.testing.assert_allclose(T[:3, 2], n, atol=1e-9)
    np.testing.assert_allclose(T[:3, 3], first.T_camera_grasp[:3, 3])
    found, pixel, _ = seen_by(CAMERA, T, 1e-6)
    np.testing.assert_allclose(pixel, first.pixel, atol=1e-6)
    assert abs(np.sin(found - angle)) < 1e-4  # modulo half a turn


@settings(max_examples=50)
@given(st.integers(20, 280), st.integers(20, 280), st.floats(-1.5, 1.5), st.floats(1.0, 60.0))
def test_a_grasp_along_the_axis_is_seen_as_the_network_saw_it(row, column, angle, width):
    first = project_grasp(Peak(row, column, 0.8, angle, width), CROP, 300, np.full((480, 640), 0.8), CAMERA)
    for one in (first, along(first, np.array([0.0, 0.0, 1.0]), CAMERA)):
        found, pixel, px = seen_by(CAMERA, one.T_camera_grasp, one.width)
        np.testing.assert_allclose((*pixel, found, px), (*first.pixel, angle, width * 400 / 300), atol=1e-6)


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3), st.floats(-1.5, 1.5), st.integers(0, 2), st.booleans())
def test_a_turn_is_measured_and_half_a_turn_about_the_approach_is_none(first, turn, axis, half):
    R = rotation_from_zyx(*first)
    other = R @ rotation_about(axis, turn) @ rotation_about(2, np.pi if half else 0.0)
    assert turned(R, other) == pytest.approx(abs(turn), abs=1e-6)


def test_the_opening_across_a_slope_is_measured_on_the_slope():
    slope = np.radians(40.0)
    first = project_grasp(Peak(150, 150, 0.8, 0.0, 30.0), CROP, 300, np.full((480, 640), 0.8), CAMERA)
    turned = along(first, np.array([np.sin(slope), 0.0, np.cos(slope)]), CAMERA)
    assert turned.width == pytest.approx(first.width / np.cos(slope), rel=0.01)
    assert along(first, np.array([1.0, 0.0, 0.0]), CAMERA) is None


class Nearest(torch.nn.Module):
    """A network that calls good what is near, with an angle of 30 degrees and an opening of 45 pixels."""

    side_multiple = 1

    def forward(self, depth):
        one = torch.ones_like(depth)
        return torch.cat([-depth, 0.5 * one, 0.8660254 * one, 0.3 * one], dim=1)


def test_single_images_need_no_configuration():
    depth = np.full((480, 640), 0.8)
    depth[200:221, 300:321] = 0.7
    depth[:, 600:] = np.nan
    view = CameraView(CropConfig(400, 0))
    found = GraspPipeline(view, Nearest(), PipelineSettings()).step(depth, CAMERA)
    grasp_found = found.candidates[0].grasp
    assert np.hypot(grasp_found.pixel[0] - 310.0, grasp_found.pixel[1] - 210.0) < 1.5
    assert grasp_found.angle == pytest.approx(np.pi / 6.0, abs=1e-4)
    assert grasp_found.width == pytest.approx(45.0 * 400 / 300 * 0.7 / F, rel=1e-3)
    several = GraspPipeline(view, Nearest(), PipelineSettings(count=3, threshold=0.01)).step(depth, CAMERA)
    assert [c.peak[:2] for c in several.candidates] == [found.candidates[0].peak[:2]]
    assert [g.id for g in several.grasps] == [1] and several.grasps[0].T_base_grasp is None
    np.testing.assert_array_equal(several.grasps[0].T_camera_grasp, several.candidates[0].grasp.T_camera_grasp)
