"""The operator's grasp against GGCNN's: zero where they are equal, and turned and shifted with the image."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from episodes import CAMERA, episode
from hypothesis import given, settings
from hypothesis import strategies as st

from common.camera_model import CameraModel
from common.poses import pose, read_only, translation
from common.rotations import rotation_about, rotation_angle, rotation_from_zyx
from grasping.lab.dataset.labels import map_pixel, own_grasp, relative_label, tilt_and_angle
from grasping.network.depth_image import Crop
from grasping.pipeline.projection import camera_pixel

ANGLES = st.floats(-3.0, 3.0)
SMALL = st.floats(-0.1, 0.1)
TILTS = st.floats(-1.2, 1.2)
DISTORTED = CameraModel(
    "camera", 640, 480, CAMERA.K, read_only([-0.0608, 0.1215, 0.0075, 0.0, 0.0]), CAMERA.R, CAMERA.P
)
FRAME = episode(1).frame(0)


def grasped(frame, T_camera_grasp):
    """The frame with another grasp of the operator."""
    return frame._replace(T_base_grasp=frame.T_base_camera @ T_camera_grasp)


def rotation(about_x, about_y, turn):
    """A grasp's rotation before the camera: within 90 degrees of the optical axis."""
    return rotation_from_zyx(0.0, about_y, about_x) @ rotation_about(2, turn)


def pose_from_label(frame, label):
    """The label's pose before the camera; undoes `relative_label` up to half a turn about the approach."""
    own = own_grasp(frame)
    ray = frame.camera.rays(camera_pixel(label.row, label.column, frame.crop, frame.maps.shape[-1]))
    R = pin.exp3(np.append(label.tilt, 0.0)) @ rotation_about(2, -(own.angle + label.angle))
    return pose(R, (own.T_camera_grasp[2, 3] + label.depth) * ray)


@pytest.mark.parametrize("camera", [CAMERA, DISTORTED], ids=["pinhole", "distorted"])
def test_the_label_is_zero_where_the_person_grasps_as_ggcnn_proposes(camera):
    frame = FRAME._replace(camera=camera)
    label = relative_label(grasped(frame, own_grasp(frame).T_camera_grasp))
    np.testing.assert_allclose([label.row_shift, label.column_shift], 0.0, atol=1e-6)
    np.testing.assert_allclose([label.depth, label.angle, *label.tilt], 0.0, atol=1e-9)
    np.testing.assert_allclose([label.row, label.column], [(140.5) / 2 - 0.5, (160.5) / 2 - 0.5], atol=1e-6)


@given(SMALL, SMALL, SMALL, ANGLES, TILTS, TILTS)
@settings(max_examples=50)
def test_the_label_tells_the_whole_grasp_but_for_half_a_turn(x, y, z, turn, about_x, about_y):
    T = pose(rotation(about_x, about_y, turn), (x, y, 0.9 + z))
    frame = grasped(FRAME._replace(camera=DISTORTED), T)
    found = pose_from_label(frame, relative_label(frame))
    np.testing.assert_allclose(found[:3, 3], T[:3, 3], atol=1e-7)
    off = min(rotation_angle(found[:3, :3].T @ T[:3, :3] @ rotation_about(2, a)) for a in (0.0, np.pi))
    assert off < 1e-6


@given(ANGLES, ANGLES, TILTS, TILTS, SMALL, SMALL)
@settings(max_examples=50)
def test_a_image_that_turns_about_the_optical_axis_turns_the_label(by, turn, about_x, about_y, x, y):
    frame = grasped(FRAME, pose(rotation(about_x, about_y, turn), (x, y, 0.9)))
    before = relative_label(frame)
    # The camera turns by `by`: the image, GGCNN's pixel and its angle turn the other way, here anticlockwise.
    c, s = np.cos(by), np.sin(by)
    middle = 149.5
    row, column = frame.peak.row - middle, frame.peak.column - middle
    turned = frame._replace(
        T_base_camera=frame.T_base_camera @ pose(rotation_about(2, by)),
        peak=frame.peak._replace(
            column=c * column + s * row + middle, row=-s * column + c * row + middle, angle=frame.peak.angle + by
        ),
    )
    after = relative_label(turned)
    R = np.array([[c, s], [-s, c]])
    np.testing.assert_allclose(
        (after.column - 74.5, after.row - 74.5), R @ (before.column - 74.5, before.row - 74.5), atol=1e-6
    )
    np.testing.assert_allclose(
        (after.column_shift, after.row_shift), R @ (before.column_shift, before.row_shift), atol=1e-6
    )
    np.testing.assert_allclose(after.tilt, R @ before.tilt, atol=1e-7)
    assert after.depth == pytest.approx(before.depth, abs=1e-9)
    assert np.sin(after.angle - before.angle) == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize(("rows", "columns"), [(8, -12), (-40, 60)])
def test_a_window_that_moves_shifts_the_pixel_alone(rows, columns):
    before = relative_label(FRAME)
    crop = Crop(FRAME.crop.row + rows, FRAME.crop.column + columns, FRAME.crop.side)
    peak = FRAME.peak._replace(row=FRAME.peak.row - rows * 0.75, column=FRAME.peak.column - columns * 0.75)
    after = relative_label(FRAME._replace(crop=crop, peak=peak))
    np.testing.assert_allclose(
        (after.row - before.row, after.column - before.column), (-rows * 0.375, -columns * 0.375), atol=1e-6
    )
    for name in ("row_shift", "column_shift", "depth", "angle", "tilt"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), atol=1e-9)


@given(ANGLES, TILTS, TILTS)
@settings(max_examples=50)
def test_half_a_turn_of_the_hand_changes_nothing(turn, about_x, about_y):
    T = pose(rotation(about_x, about_y, turn), (0.01, 0.02, 0.9))
    labels = [relative_label(grasped(FRAME, T @ pose(rotation_about(2, a)))) for a in (0.0, np.pi)]
    np.testing.assert_allclose(labels[0].tilt, labels[1].tilt, atol=1e-9)
    assert np.sin(labels[0].angle - labels[1].angle) == pytest.approx(0.0, abs=1e-9)
    assert -np.pi / 2 <= labels[0].angle < np.pi / 2


def test_a_frame_whose_grasps_have_no_place_has_no_label():
    blind = FRAME._replace(depth=np.zeros_like(FRAME.depth))
    assert relative_label(blind) is None
    behind = grasped(FRAME, translation(0.0, 0.0, -0.5))
    assert relative_label(behind) is None
    against = grasped(FRAME, pose(rotation_about(0, np.pi), (0.0, 0.0, 0.9)))
    assert relative_label(against) is None
    with pytest.raises(ValueError, match="no definite tilt"):
        tilt_and_angle(rotation_about(0, np.pi))


@given(st.floats(0.0, 300.0), st.floats(0.0, 300.0), st.sampled_from([75, 150, 300]))
def test_pixels_of_map_and_camera_undo_each_other(row, column, side):
    peak = FRAME.peak._replace(row=row, column=column)
    found = map_pixel(np.array(camera_pixel(peak.row, peak.column, FRAME.crop, side)), FRAME.crop, side)
    np.testing.assert_allclose(found, (row, column), atol=1e-9)


def test_maps_of_any_size_give_the_same_label():
    small, large = (relative_label(replace(episode(1, m=m)).frame(0)) for m in (150, 300))
    assert large.row_shift == pytest.approx(2 * small.row_shift)
    assert large.depth == small.depth
