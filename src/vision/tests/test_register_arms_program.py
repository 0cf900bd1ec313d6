"""The program register_arms: two stored calibrations in, a sentence and the yaml file of the arms out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml
from hand_eye_scene import SD, scene
from numpy.testing import assert_allclose

from common.arms import arms_from
from common.poses import inverse, pose, translation
from common.rotations import rotation_from_zyx
from vision.calibration.hand_eye import CalibrationView, solve
from vision.calibration.record import LIVE, VIEWS, CalibrationRecord, mapping_from_record

pytest.importorskip("rig_msgs.srv")
from vision.ros.calibration.register_arms_program import main

pytestmark = pytest.mark.ros
T_LEFT_RIGHT = pose(rotation_from_zyx(0.02, 0.001, -0.002), (0.004, -0.902, 0.003))


def moved(views, T):
    """The same views of an arm whose base stands at inverse(T), shape (4, 4)."""
    return [CalibrationView(T @ view.T_base_flange, view.T_camera_board, view.covariance) for view in views]


def record_of(views, date):
    hardware = ("LBR7R800", "MF_elektrisch", "tag_frame", "1234", "camera_rgb_optical_frame")
    head = (date, VIEWS, *hardware, 0.5, 0.1, 0.2, False)
    return CalibrationRecord(*head, solve(views).T_base_camera, np.eye(4), np.ones((len(views), 2)), tuple(views))


@pytest.fixture
def records():
    """Of the left and the right arm, with noise; the camera stands in the world of both."""
    _, T_left_camera, views = scene(3, 15, SD)
    _, T_other_camera, others = scene(4, 15, SD)
    T = inverse(T_LEFT_RIGHT) @ T_left_camera @ inverse(T_other_camera)  # so that both see the same camera
    return record_of(views, "2026-01-31T12:00:00"), record_of(moved(others, T), "2026-01-31T12:30:00")


@pytest.fixture
def run(tmp_path, capsys):
    """Runs the program; returns its exit code, what it printed, and the file."""

    def start(left, right, *more):
        for name, record in (("left", left), ("right", right)):
            (tmp_path / name).mkdir(exist_ok=True)
            if record is not None:
                file = tmp_path / name / f"camera_place_{record.date.replace(':', '')}.yaml"
                file.write_text(yaml.safe_dump(mapping_from_record(record)))
        output = tmp_path / "arms.yaml"
        given = [f"{name}={tmp_path / name}" for name in ("left", "right")]
        code = main([*given, "--output", str(output), *more])
        printed = capsys.readouterr()
        return code, printed.out + printed.err, output

    return start


def test_the_second_arm_is_written_where_it_stands(run, records):
    code, printed, file = run(*records)
    assert code == 0, printed
    arms = arms_from(yaml.safe_load(file.read_text()), "arms/")
    left, right = (arms.placements[name].T_world_base for name in ("left", "right"))
    assert_allclose(left, translation(0.0, 0.45, 0.0), atol=1e-9)
    found = inverse(left) @ right
    assert np.linalg.norm(found[:3, 3] - T_LEFT_RIGHT[:3, 3]) < 0.005, printed
    assert_allclose(found[:3, :3], T_LEFT_RIGHT[:3, :3], atol=0.01)
    assert "The base of right stands at x 0.0" in printed and "standard deviations" in printed
    assert "not moved between 2026-01-31T12:00:00 and 2026-01-31T12:30:00" in printed
    assert f"arms:={file}" in printed and "standard deviations" in file.read_text()
    assert arms.margin == 0.3 and arms.simulated is False and "Measured with real devices" in printed
    for said, origin in ((True, True), (None, None)):
        _, _, file = run(records[0], replace(records[1], simulated=said))
        assert arms_from(yaml.safe_load(file.read_text())).simulated is origin


def test_the_newest_calibration_of_a_folder_counts_and_an_only_view_does_not(run, records):
    left, right = records
    code, printed, _ = run(replace(left, date="2026-01-01T00:00:00"), right)
    assert code == 0 and "between 2026-01-01T00:00:00" in printed
    code, printed, _ = run(left, right)
    assert code == 0 and "between 2026-01-31T12:00:00" in printed
    code, printed, _ = run(left, replace(right, kind=LIVE, date="2026-02-01T00:00:00"))
    assert code == 1 and "depends on a single view" in printed


def test_what_does_not_fit_is_one_sentence(run, records, tmp_path):
    left, right = records
    code, printed, file = run(left, replace(right, camera="another"))
    assert code == 1 and "are of different cameras (camera 1234 and another)" in printed and not file.exists()
    (tmp_path / "right" / "camera_place_2026-01-31T123000.yaml").unlink()
    code, printed, _ = run(left, None)
    assert code == 1 and "has no calibration" in printed
    (tmp_path / "three.yaml").write_text(
        "margin: 0.3\n" + "".join(f"{name}: {{position: [0, 0, 0]}}\n" for name in ("left", "right", "third"))
    )
    code, printed, _ = run(left, right, "--arms", str(tmp_path / "three.yaml"))
    assert code == 1 and "also places third" in printed
    (tmp_path / "others.yaml").write_text("margin: 0.3\none: {position: [0, 0, 0]}\ntwo: {position: [0, 1, 0]}\n")
    code, printed, _ = run(left, right, "--arms", str(tmp_path / "others.yaml"))
    assert code == 1 and "places one and two" in printed
    assert "Traceback" not in printed
