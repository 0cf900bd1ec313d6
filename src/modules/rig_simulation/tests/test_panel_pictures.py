"""The program panel_pictures.py: the truth that it states against the pictures, and how it refuses."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.camera_model import from_calibration
from common.errors import DeviceError
from rig_simulation.devices.camera.board_images import INDEX, BoardScene, main, random_pose
from rig_simulation.devices.camera.rgbd_camera import Renderer
from rig_simulation.devices.camera.sensors import CameraLens
from rig_simulation.files import read_board

CALIBRATIONS = Path(__file__).parents[3] / "vision" / "config"
CAMERAS = ["--rgb", str(CALIBRATIONS / "xtion_rgb.yaml"), "--depth", str(CALIBRATIONS / "xtion_depth.yaml")]


@settings(max_examples=40)
@given(distance=st.floats(0.5, 3.0), tilt=st.floats(0.0, 1.2), seed=st.integers(0, 100))
def test_a_pose_has_the_distance_and_the_tilt_that_were_asked_for(distance, tilt, seed):
    T = random_pose(distance, tilt, 0.3, np.random.default_rng(seed))
    sight = T[:3, 3] / distance
    np.testing.assert_allclose(np.linalg.norm(sight), 1.0)
    np.testing.assert_allclose(np.arccos(np.clip(-sight @ T[:3, 2], -1.0, 1.0)), tilt, atol=1e-6)
    np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-12)


def test_the_camera_comes_where_the_panel_has_the_wanted_pose():
    scene = BoardScene(read_board("bundle"))
    np.testing.assert_allclose(scene.T_rgb_depth[:3, 3], (-0.027, 0.0, 0.0), atol=1e-9)
    T = random_pose(1.2, 0.5, 0.3, np.random.default_rng(0))
    scene.place_camera(T)
    panel = scene.data.body("panel")
    seen = np.linalg.inv(scene.optical("camera_rgb_optical_frame")) @ np.append(panel.xpos, 1.0)
    np.testing.assert_allclose(seen[:3], T[:3, 3], atol=1e-9)
    assert panel.xmat.reshape(3, 3)[2, 2] == pytest.approx(1.0, abs=1e-6), "the panel lies face up"


@pytest.fixture
def can_render():
    try:
        scene = BoardScene(read_board("single"))
        camera = from_calibration(_calibration())
        Renderer(scene.model, CameraLens(camera).window, 0).close()
    except DeviceError as error:
        pytest.skip(str(error))


def _calibration():
    import yaml

    return yaml.safe_load((CALIBRATIONS / "xtion_rgb.yaml").read_text())


def test_pictures_show_the_panel_where_the_index_says(can_render, tmp_path, capsys):
    arguments = ["--panel", "single", "--distances", "0.8", "--tilts", "0", "40", "--units", "1", "--pictures", "1"]
    assert main([str(tmp_path / "out"), *CAMERAS, *arguments]) == 0
    assert "2 pairs" in capsys.readouterr().out
    index = json.loads((tmp_path / "out" / INDEX).read_text())
    rgb, depth = from_calibration(index["rgb"]), from_calibration(index["depth"])
    assert [(e["distance"], e["tilt"], e["unit"]) for e in index["pictures"]] == [(0.8, 0.0, 0), (0.8, 40.0, 0)]
    for entry in index["pictures"]:
        T = np.array(entry["T_rgb_panel"])
        seen = cv2.imread(str(tmp_path / "out" / entry["depth"]), cv2.IMREAD_UNCHANGED)
        centre = (np.linalg.inv(index["T_rgb_depth"]) @ T)[:3, 3]
        u, v = np.rint(depth.project(centre)).astype(int)
        assert seen[v, u] == pytest.approx(1000.0 * centre[2], abs=25.0)
        grey = cv2.imread(str(tmp_path / "out" / entry["colour"]), cv2.IMREAD_GRAYSCALE)
        ring = [T[:3, :3] @ (x, y, 0.0) + T[:3, 3] for x, y in ((0.056, 0.0), (-0.056, 0.0), (0.0, 0.056))]
        border = [T[:3, :3] @ (x, y, 0.0) + T[:3, 3] for x, y in ((0.043, 0.0), (-0.043, 0.0), (0.0, 0.043))]
        white, black = (
            [int(grey[v, u]) for u, v in np.rint(rgb.project(np.array(points))).astype(int)]
            for points in (ring, border)
        )
        assert min(white) > max(black) + 40


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (["--panel", "door"], "'door'"),
        (["--rgb", "nothing.yaml"], "nothing.yaml cannot be read"),
    ],
)
def test_it_refuses_with_a_sentence(tmp_path, capsys, change, sentence):
    assert main([str(tmp_path / "out"), *CAMERAS, *change]) == 1
    error = capsys.readouterr().err
    assert sentence in error and error.count("\n") == 1
