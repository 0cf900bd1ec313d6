"""The evaluation of the marker board's poses: errors, tables, and the program on images with known truth."""

import json

import cv2
import numpy as np
import pinocchio as pin
import pytest
from depth_scene import RGB, T_RGB_DEPTH, board_pose, depth_image, load
from tag_renderer import render

from common.poses import pose
from vision.marker_board import pose_evaluation
from vision.marker_board.plane_fit import PlaneFit
from vision.marker_board.plane_pose import PoseEstimate, RgbdPose

FIT = PlaneFit(None, None, 0, 0.0, 0.0, 0.0, "none")


def poses(T, shift=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0)):
    moved = pose(pin.exp3(np.array(turn)) @ T[:3, :3], T[:3, 3] + shift)
    return RgbdPose(PoseEstimate(moved, np.diag([1e-6] * 3 + [1e-4] * 3)), None, None, FIT, np.nan, "none")


def test_errors_are_in_millimetres_degrees_and_standard_deviations():
    T = board_pose(1.0, 20.0)
    found = pose_evaluation.trial(1.0, 20.0, T, poses(T, (0.003, 0.0, 0.004), (0.0, 0.02, 0.0))).errors["colour"]
    assert (found.position, found.rotation) == (pytest.approx(5.0), pytest.approx(np.degrees(0.02)))
    assert found.reach == pytest.approx(np.sqrt(25.0 + 2.0 / 3.0 * 10.0**2))
    assert found.square == pytest.approx((9.0 + 16.0 + 4.0) / 6.0)


def test_tables_name_what_was_not_found():
    T = board_pose(1.0, 20.0)
    trials = [pose_evaluation.trial(1.0, 20.0, T, poses(T)), pose_evaluation.trial(1.0, 20.0, T, None)]
    lines = pose_evaluation.csv("v", trials)
    columns = pose_evaluation.CSV_HEAD.split(",")
    rows = [dict(zip(columns, line.split(","))) for line in lines]
    assert all(line.count(",") == len(columns) - 1 for line in lines)
    assert [(r["method"], r["pictures"], r["found"]) for r in rows] == [
        ("colour", "2", "1"),
        ("plane", "2", "0"),
        ("fused", "2", "0"),
    ]
    table = pose_evaluation.markdown(trials)
    assert len({line.count("|") for line in table}) == 1
    assert table[2].startswith("| 1 m, 20 deg | 0.0 / 0.0 |") and table[2].endswith("- | - | - |")


@pytest.fixture
def folder(tmp_path):
    """Two pairs of images, as the simulation writes them."""
    entries = []
    for i, T in enumerate((board_pose(0.7, 0.0, 0.0, 25.0), board_pose(0.9, 30.0, 40.0, 10.0))):
        cv2.imwrite(str(tmp_path / f"{i}_c.png"), render(RGB, T, [(0, 0.097, 0.0, 0.0)], 0.125))
        cv2.imwrite(str(tmp_path / f"{i}_d.png"), np.rint(1000.0 * depth_image(T, 0.125)).astype(np.uint16))
        shown = {"distance": T[2, 3], "tilt": 30.0 * i, "unit": 0, "T_rgb_panel": T.tolist()}
        entries.append({"colour": f"{i}_c.png", "depth": f"{i}_d.png", **shown})
    calibrations = {n: load(f"xtion_{n}.yaml") for n in ("rgb", "depth")}
    index = {"panel": {"size": [0.125, 0.125]}, **calibrations, "T_rgb_depth": T_RGB_DEPTH.tolist()}
    (tmp_path / "pictures.json").write_text(json.dumps({**index, "pictures": entries}))
    return tmp_path


@pytest.mark.ros
def test_the_program_writes_tables_and_plots(folder, tmp_path, capsys):
    program = pytest.importorskip("vision.ros.marker_board.evaluate_program")
    out = tmp_path / "out"
    assert program.main(["--pictures", str(folder), "--panel", "single", "--output", str(out)]) == 0
    assert "as calibrated, fused" in capsys.readouterr().out
    rows = [line.split(",") for line in (out / "tag_pose.csv").read_text().splitlines()]
    fused = [row for row in rows if row[0] == "as calibrated" and row[3] == "fused"]
    assert len(fused) == 2 and all(float(row[6]) < 3.0 for row in fused)
    wrong = [row for row in rows if row[0] == "focal length +1.0%" and row[3] == "colour"]
    assert all(float(row[6]) > 5.0 for row in wrong)
    assert "## depth +10 mm" in (out / "tag_pose.md").read_text()
    for number in range(1, 5):
        assert cv2.imread(str(out / f"tag_pose_{number}.png")).std() > 10.0


@pytest.mark.ros
@pytest.mark.parametrize(
    ("break_it", "sentence"),
    [
        (lambda f: (f / "pictures.json").unlink(), "does not describe images"),
        (lambda f: (f / "pictures.json").write_text("{}"), "does not describe images"),
        (lambda f: (f / "1_d.png").unlink(), "are not a colour and a depth image"),
        (lambda f: (f / "1_d.png").write_bytes((f / "1_c.png").read_bytes()), "are not a colour and a depth image"),
    ],
)
def test_the_program_refuses_with_a_sentence(folder, tmp_path, capsys, break_it, sentence):
    program = pytest.importorskip("vision.ros.marker_board.evaluate_program")
    break_it(folder)
    assert program.main(["--pictures", str(folder), "--panel", "single", "--output", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err
    assert sentence in error and error.count("\n") == 1
