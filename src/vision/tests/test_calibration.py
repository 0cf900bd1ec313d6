"""Which views count, which calibrations are accepted, and what is stored of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hand_eye_scene import SD, change, scene

from common.config import parse
from common.errors import ConfigError
from common.poses import pose
from common.rotations import rotation_about
from vision.calibration.acceptance import (
    BoardDetection,
    CalibrationConfig,
    ViewRejected,
    judge,
    mean_pose,
    table,
    view_from,
)
from vision.calibration.hand_eye import CalibrationView, DegenerateViews
from vision.calibration.record import by_views, mapping_from_record, record_from_mapping
from vision.marker_board.board import MarkerBoardConfig

CONFIG = Path(__file__).parents[1] / "config"
HEAD = {
    "date": "2026-01-31T12:00:00", "robot": "LBR7R800", "flange": "MF_elektrisch", "panel": "tag_frame",
    "camera": "1234", "camera_frame": "camera_rgb_optical_frame", "simulated": False,
}  # fmt: skip


@pytest.fixture
def config():
    return parse(CalibrationConfig, yaml.safe_load((CONFIG / "camera_calibration.yaml").read_text()))


@pytest.mark.parametrize(("file", "beyond"), [("panel_single.yaml", 0.0435), ("panel.yaml", 0.1035)])
def test_the_board_sits_where_its_drawing_says(file, beyond):
    """71.1 mm beside the flange's axis, facing away from it, so far beyond the flange's face, upright along its z."""
    board = parse(MarkerBoardConfig, yaml.safe_load((CONFIG / file).read_text()))
    T = board.T_flange_tag
    np.testing.assert_allclose(T[:3, 3], [0.0, 0.0711, beyond], atol=1e-12)
    np.testing.assert_allclose(T[:3, :3], [[-1, 0, 0], [0, 0, 1], [0, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(board.T_tag_flange @ T, np.eye(4), atol=1e-12)


def detections(T, count, sd, seed=0):
    rng = np.random.default_rng(seed)
    return [BoardDetection(change(T, rng.normal(0.0, sd * np.ones(6))), np.diag(SD**2)) for _ in range(count)]


def test_a_view_is_the_mean_of_what_was_seen(config):
    T = pose(rotation_about(0, 2.8), (0.1, 0.0, 0.9))
    seen = detections(T, 400, 5e-4)
    view = view_from(seen, np.eye(4), [], config)
    np.testing.assert_allclose(view.T_camera_board, T, atol=2e-4)
    arm = np.array([1e-3 * config.arm_mm] * 3 + [np.radians(config.arm_deg)] * 3)
    np.testing.assert_allclose(view.covariance, np.diag(SD**2 + arm**2), rtol=1e-9)


@pytest.mark.parametrize(
    ("count", "sd", "T_flange", "cause"),
    [
        (3, 1e-4, pose(p=(1, 0, 0)), "detections"),
        (10, 1e-2, pose(p=(1, 0, 0)), "moved"),
        (10, 1e-4, pose(rotation_about(0, 0.05), (0, 0, 0.015)), "repeated"),
    ],
)
def test_views_that_are_rejected(config, count, sd, T_flange, cause):
    earlier = [CalibrationView(np.eye(4), np.eye(4), np.eye(6))]
    with pytest.raises(ViewRejected) as error:
        view_from(detections(pose(p=(0, 0, 1)), count, sd), T_flange, earlier, config)
    assert error.value.cause == cause


def test_mean_of_poses_is_in_the_middle():
    a, b = pose(rotation_about(1, 0.2), (0, 0, 1)), pose(rotation_about(1, 0.4), (0, 0, 2))
    np.testing.assert_allclose(mean_pose([a, b]), pose(rotation_about(1, 0.3), (0, 0, 1.5)), atol=1e-12)


def test_a_good_calibration_is_accepted(config):
    X, Z, views = scene(3, 14, SD / 4)
    verdict = judge(views, X, config)
    assert verdict.accepted and not verdict.failed
    assert (verdict.size, verdict.depth) == pytest.approx((1.0, 1.0), abs=0.005)
    assert "good" in verdict.sentence
    np.testing.assert_allclose(verdict.result.T_base_camera[:3, 3], Z[:3, 3], atol=2e-3)
    assert len(table(verdict)) == 15


@pytest.mark.parametrize(
    "limit", ["max_rms_mm", "max_rms_deg", "max_point_sd_mm", "max_turn_sd_deg", "max_panel_mm", "max_panel_deg"]
)
def test_a_bad_calibration_is_rejected_with_the_reason(config, limit):
    """Reported in https://github.com/moveit/moveit_calibration/issues/134: a far too wrong camera is accepted after
    five samples. Tried: bad views.
    """
    X, _, views = scene(3, 14, SD / 4)
    verdict = judge(views, X, replace(config, **{limit: 1e-4}))
    assert not verdict.accepted
    (key,) = verdict.failed
    assert limit.startswith(key)
    assert verdict.failed[key] in verdict.sentence


def test_wrong_views_are_counted(config):
    X, _, views = scene(3, 14, SD / 4)
    spoilt = [replace(v, T_camera_board=v.T_camera_board @ pose(rotation_about(0, 0.8))) for v in views[:5]]
    verdict = judge(spoilt + views[5:], X, config)
    assert set(verdict.failed) == {"min_share"} and "64%" in verdict.sentence
    assert sum("left out" in line for line in table(verdict)) == 5
    with pytest.raises(DegenerateViews, match="7 views"):
        judge(views[:7], X, config)


@pytest.mark.parametrize(
    ("factors", "key", "percent"),
    [((1.01, 1.01, 1.01), "max_scale", "+1.0%"), ((1.0, 1.0, 0.985), "max_scale_depth", "-1.5%")],
)
def test_a_wrong_size_or_focal_length_is_found(config, factors, key, percent):
    """Tags smaller than configured make everything appear larger; a focal length too great makes the board appear
    farther away.

    Reported in https://github.com/AprilRobotics/apriltag_ros/issues/84: distances off by a factor. Tried: wrong
    size, wrong focal length.
    """
    X, _, views = scene(3, 30, SD / 8)
    wrong = [
        replace(v, T_camera_board=pose(v.T_camera_board[:3, :3], factors * v.T_camera_board[:3, 3])) for v in views
    ]
    verdict = judge(wrong, X, config)
    assert key in verdict.failed and percent in verdict.failed[key]


def test_a_record_survives_its_file(config):
    X, _, views = scene(3, 14, SD / 4)
    record = by_views(judge(views, X, config), views, **HEAD)
    mapping = {**mapping_from_record(record), "camera_frame": f"/{record.camera_frame}"}  # as of an old driver
    again = record_from_mapping(yaml.safe_load(yaml.safe_dump(mapping)))
    for key in ("date", "kind", "robot", "camera", "camera_frame", "rms_mm", "point_sd_mm"):
        assert getattr(again, key) == getattr(record, key)
    np.testing.assert_allclose(again.T_base_camera, record.T_base_camera, atol=1e-12)
    np.testing.assert_allclose(again.errors, record.errors)
    recomputed = judge(list(again.views), X, config).result.T_base_camera
    np.testing.assert_allclose(recomputed, record.T_base_camera, atol=1e-9)


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda v: v.pop("camera"), "camera is missing"),
        (lambda v: v.update(extra=1), "extra is not a known key"),
        (lambda v: v["T_base_camera"].update(quaternion=[0, 0, 0, 0]), "T_base_camera/quaternion: the quaternion"),
        (lambda v: v["T_base_camera"].update(position=[0, float("nan"), 0]), "T_base_camera/position is"),
        (lambda v: v["T_base_camera"].update(position=[1200.0, 0, 0]), "T_base_camera/position is"),
        (lambda v: v["T_base_camera"].update(position=[110.0, -10.0, 75.0]), "T_base_camera/position is"),
        (lambda v: v["T_flange_panel"].update(position=[0.0, 7.11, 10.35]), "T_flange_panel/position is"),
        (lambda v: v["T_flange_panel"].update(position=[0.0, 0.0, 5.0]), "each in [-1, 1] m"),
        (lambda v: v["views"][2]["T_base_flange"].update(position=[500.0, 3.0, 400.0]), "views[2]/T_base_flange/"),
        (lambda v: v["views"][2]["T_camera_panel"].update(position=[1.0, 3.0, 900.0]), "views[2]/T_camera_panel/"),
        (lambda v: v.update(views=None), "views is None, but must be a list"),
        (lambda v: v["views"].append(3), "views[14]/ is 3"),
        (lambda v: v.pop("rms_deg"), "rms_mm and rms_deg are missing"),
        (lambda v: v["views"][2].pop("error"), "A view has no error"),
        (lambda v: v["views"][2].pop("T_base_flange"), "views[2]/T_base_flange/ is None"),
    ],
)
def test_a_file_with_faults_is_refused(config, spoil, sentence):
    X, _, views = scene(3, 14, SD / 4)
    values = mapping_from_record(by_views(judge(views, X, config), views, **HEAD))
    spoil(values)
    with pytest.raises(ConfigError) as error:
        record_from_mapping(values)
    assert sentence in str(error.value)


def test_no_mapping_is_no_record():
    with pytest.raises(ConfigError, match="mapping"):
        record_from_mapping(None)
