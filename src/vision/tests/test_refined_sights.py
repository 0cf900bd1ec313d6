"""Refined detections of a view: all of them, or none."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from depth_scene import RGB, board_pose
from tag_renderer import render

from apriltag_ros.photometric import PhotometricRefiner
from apriltag_ros.settings import TagTarget, TargetTag
from common.config import parse
from common.poses import pose
from common.rotations import rotation_angle
from rig_description.urdf import urdf
from vision.calibration.acceptance import BoardDetection, CalibrationConfig, refined
from vision.calibration.arm_model import ArmModel
from vision.marker_board.pose_evaluation import BoardObservation, bent_arm, calibrate, inexact_arm, wrong_lens

REFINER = PhotometricRefiner("tag36h11", TagTarget("tag_frame", (TargetTag(0, 0.097),)))


def seen(tilt):
    """An image of the marker board, and its pose as corners might give it."""
    truth = board_pose(0.7, tilt, 30.0, 20.0)
    off = pose(truth[:3, :3], truth[:3, 3] + (0.0004, -0.0003, 0.002))
    return truth, (BoardDetection(off, np.diag([1e-6] * 6)), render(RGB, truth, [(0, 0.097, 0.0, 0.0)], 0.125))


def test_all_sights_of_a_view_are_refined():
    truths, pairs = zip(*(seen(tilt) for tilt in (20.0, 35.0)))
    detections, reason = refined(list(pairs), RGB, REFINER)
    assert reason == ""
    for truth, detection in zip(truths, detections):
        assert np.linalg.norm(detection.T_camera_board[:3, 3] - truth[:3, 3]) < 3e-4
        assert np.all(np.linalg.eigvalsh(detection.covariance) > 0.0)


def test_one_image_that_is_of_no_use_keeps_all_of_them_as_they_were():
    pairs = [seen(20.0)[1], (seen(35.0)[1][0], np.full((480, 640), 90, np.uint8))]
    detections, reason = refined(pairs, RGB, REFINER)
    assert "contrast" in reason
    assert detections == [detection for detection, _ in pairs]


def test_nothing_seen_is_nothing_refined():
    assert refined([], RGB, REFINER) == ([], "")


Q_START = np.radians([-45.0, 0.0, 0.0, -90.0, 0.0, 50.0, 0.0])
T_BASE_CAMERA = pose([[-0.5, 0.0, -np.sqrt(0.75)], [np.sqrt(0.75), 0.0, -0.5], [0.0, -1.0, 0.0]], (1.1, 0.2, 0.7))


@pytest.fixture(scope="module")
def drawn():
    """The arm as drawn."""
    return ArmModel(urdf("LBR7R800", "MF_elektrisch"))


def calibration(noise, arm, T_base_camera=T_BASE_CAMERA, lens=None):
    """The errors of a calibration from ten views, whose poses of the board are off by `noise` [m]."""
    rng = np.random.default_rng(2)
    values = yaml.safe_load((Path(__file__).parents[1] / "config" / "camera_calibration.yaml").read_text())
    limits = parse(CalibrationConfig, {**values, "pictures": 1, "new_mm": 0.0, "new_deg": 0.0})
    shown = []
    for i in range(10):
        T = board_pose(0.6 + 0.04 * i, 30.0, 36.0 * i, 50.0 * i, 0.15 * np.cos(i), 0.15 * np.sin(2.0 * i))
        found = pose(T[:3, :3], T[:3, 3] + rng.normal(0.0, noise, 3))
        shown.append(BoardObservation(T, BoardDetection(found, np.diag([1e-6] * 3 + [1e-5] * 3))))
    return calibrate(shown, T_base_camera, np.eye(4), limits, arm, lens)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_calibration_is_as_far_off_as_its_views(noise):
    error = calibration(noise, lambda T: T)
    if noise:
        assert 0.05 < error.point < 3.0 and error.stated > 0.1
    else:
        assert error.position < 1e-6 and error.rotation < 1e-6 and error.point < 1e-6 and error.accepted


def test_a_wrong_lens_shifts_what_an_exact_calibration_measures():
    """The middle of the views is near the optical axis, 0.78 m away: 3 px are 4.4 mm there, a focal length nothing."""
    focal, centre = 0.01, 3.0
    error = calibration(0.0, lambda T: T, lens=(RGB, wrong_lens(RGB, 0.0, centre)))
    assert error.position < 1e-6
    np.testing.assert_allclose(error.point, 1e3 * 0.78 * centre / RGB.K[0, 0], rtol=0.02)
    assert calibration(0.0, lambda T: T, lens=(RGB, wrong_lens(RGB, focal))).point < 0.5


def test_a_bent_arm_errs_the_same_way_in_the_same_pose(drawn):
    rng = np.random.default_rng(5)
    straight, bent = (bent_arm(drawn, Q_START, mm, mm, rng) for mm in (0.0, 1e-3))
    T = drawn.flange(Q_START + 0.2)
    np.testing.assert_allclose(straight(T), T, atol=1e-12)
    np.testing.assert_array_equal(bent(T), bent(T))
    off = np.linalg.norm((bent(T) - T)[:3, 3])
    # Seven joints, each displaced by 1 mm along each axis, and turned by 1 mrad at up to 1.2 m.
    assert 1e-4 < off < 1e-2
    np.testing.assert_array_equal(drawn.flange(Q_START), ArmModel(urdf("LBR7R800", "MF_elektrisch")).flange(Q_START))
    far = pose(np.eye(3), (5.0, 0.0, 0.0))
    assert bent(far) is None
    with pytest.raises(ValueError, match="reach"):
        calibration(0.0, lambda _: None)


def test_an_arm_that_errs_anew_each_time_errs_by_what_was_set():
    arm = inexact_arm(1e-3, 2e-3, np.random.default_rng(1))
    reports = [arm(T_BASE_CAMERA) for _ in range(400)]
    shifts = np.array([T[:3, 3] - T_BASE_CAMERA[:3, 3] for T in reports])
    turns = np.array([rotation_angle(T[:3, :3] @ T_BASE_CAMERA[:3, :3].T) for T in reports])
    np.testing.assert_allclose(shifts.std(axis=0), 1e-3, rtol=0.15)
    np.testing.assert_allclose(np.sqrt(np.mean(turns**2) / 3.0), 2e-3, rtol=0.15)


@pytest.mark.ros
def test_the_program_prints_both_tables(tmp_path, capsys, monkeypatch):
    program = pytest.importorskip("vision.ros.calibration.evaluate_program")
    from depth_scene import T_RGB_DEPTH, load

    from vision.ros.marker_board import image_folder

    def take(folder, board, *options):
        entries = []
        for i in range(8):
            T = board_pose(0.6 + 0.05 * i, 30.0, 45.0 * i, 25.0 * i)
            cv2.imwrite(str(folder / f"{i}.png"), render(RGB, T, [(0, 0.097, 0.0, 0.0)], 0.125))
            cv2.imwrite(str(folder / f"{i}_d.png"), np.zeros((480, 640), np.uint16))
            shown = {"distance": 0.7, "tilt": 30.0, "unit": 0, "T_rgb_panel": T.tolist()}
            entries.append({"colour": f"{i}.png", "depth": f"{i}_d.png", **shown})
        calibrations = {n: load(f"xtion_{n}.yaml") for n in ("rgb", "depth")}
        index = {"panel": {"size": [0.125, 0.125]}, **calibrations, "T_rgb_depth": T_RGB_DEPTH.tolist()}
        (folder / "pictures.json").write_text(json.dumps({**index, "pictures": entries}))

    monkeypatch.setattr(image_folder, "render_images", take)
    monkeypatch.setattr(program, "VIEW_COUNT", 4)
    monkeypatch.setattr(program, "replace", lambda limits, **k: _relaxed(limits, **k))
    assert program.main(["--panel", "single", "--draws", "2"]) == 0
    text = capsys.readouterr().out
    assert "| 0.7 m, 30 deg |" in text
    lines = [line.split(" | ") for line in text.splitlines() if line.startswith(("| corners,", "| refined,"))]
    rows = {columns[0][2:]: columns for columns in lines}
    assert len(rows) == 10 and "refined, joints off by 0.3 mm, 0.05 deg, lens off by 1.0%, 3 px" in rows
    point = {name: float(row[3].split("/")[0]) for name, row in rows.items()}
    assert point["refined, exact arm"] < 0.5 < point["refined, exact arm, lens off by 1.0%, 3 px"]


def _relaxed(limits, **changes):
    from dataclasses import replace

    return replace(limits, min_views=4, **changes)
