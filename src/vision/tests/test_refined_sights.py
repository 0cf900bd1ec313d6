"""Refined detections of a view: all of them, or none."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from depth_scene import RGB, board_pose
from tag_renderer import render

from apriltag_ros.photometric import PhotometricRefiner
from apriltag_ros.settings import TagTarget, TargetTag
from common.poses import pose
from vision.calibration.acceptance import BoardDetection, refined
from vision.marker_board.pose_evaluation import BoardObservation, calibrate

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


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_calibration_is_as_far_off_as_its_views(noise):
    from pathlib import Path

    import yaml

    from common.config import parse
    from vision.calibration.acceptance import CalibrationConfig

    rng = np.random.default_rng(2)
    values = yaml.safe_load((Path(__file__).parents[1] / "config" / "camera_calibration.yaml").read_text())
    limits = parse(CalibrationConfig, {**values, "pictures": 1, "new_mm": 0.0, "new_deg": 0.0})
    shown = []
    for i in range(10):
        T = board_pose(0.6 + 0.04 * i, 30.0, 36.0 * i, 50.0 * i, 0.15 * np.cos(i), 0.15 * np.sin(2.0 * i))
        found = pose(T[:3, :3], T[:3, 3] + rng.normal(0.0, noise, 3))
        shown.append(BoardObservation(T, BoardDetection(found, np.diag([1e-6] * 3 + [1e-5] * 3))))
    error = calibrate(shown, np.eye(4), limits, (0.0, 0.0), rng)
    if noise:
        assert 0.05 < error.point < 3.0 and error.stated > 0.1
    else:
        assert error.position < 1e-6 and error.rotation < 1e-6 and error.point < 1e-6 and error.accepted


@pytest.mark.ros
def test_the_program_prints_both_tables(tmp_path, capsys, monkeypatch):
    program = pytest.importorskip("vision.ros.calibration.evaluate_program")
    from depth_scene import T_RGB_DEPTH, load

    from vision.ros.marker_board import image_folder

    def take(folder, board, *options):
        entries = []
        for i in range(4):
            T = board_pose(0.6 + 0.1 * i, 30.0, 90.0 * i, 50.0 * i)
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
    assert "| 0.7 m, 30 deg |" in text and "| refined, exact arm |" in text


def _relaxed(limits, **changes):
    from dataclasses import replace

    return replace(limits, min_views=4, **changes)
