"""The package's own camera files: calibrations, frames, limits of the watchdog."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from common.camera_model import from_calibration
from common.config import parse
from vision.camera.frames import CameraFramesConfig, camera_frames

CONFIG = Path(__file__).parents[1] / "config"


def load(name: str):
    return yaml.safe_load((CONFIG / name).read_text())


@pytest.mark.parametrize(
    "name, K, D",
    [
        ("xtion_rgb", (545.8, 547.2, 326.2, 249.0), (0.0439, -0.1180, 0.0017, 0.0032, 0.0)),
        ("xtion_depth", (585.6, 583.9, 314.7, 244.8), (-0.0608, 0.1215, 0.0075, 0.0, 0.0)),
    ],
)
def test_the_calibrations_are_those_of_the_rigs_own_camera(name, K, D):
    camera = from_calibration(load(f"{name}.yaml"))
    assert (camera.name, camera.width, camera.height) == (name, 640, 480)
    np.testing.assert_array_equal(camera.K, [[K[0], 0.0, K[2]], [0.0, K[1], K[3]], [0.0, 0.0, 1.0]])
    np.testing.assert_array_equal(camera.D, D)
    np.testing.assert_array_equal(camera.P[:, :3], camera.K)


def test_optical_frames_look_ahead_with_y_down():
    frames = {
        child: (parent, T) for parent, child, T in camera_frames(parse(CameraFramesConfig, load("camera_frames.yaml")))
    }
    assert frames["camera_rgb_optical_frame"][0] == "camera_rgb_frame"
    optical = frames["camera_depth_optical_frame"][1][:3, :3]
    np.testing.assert_array_equal(optical @ [0, 0, 1], [1, 0, 0])
    np.testing.assert_array_equal(optical @ [0, 1, 0], [0, 0, -1])
    for name in ("rgb", "depth"):
        parent, T = frames[f"camera/{name}_frame"]
        assert parent == f"camera_{name}_optical_frame"
        np.testing.assert_array_equal(T, np.eye(4))
    assert frames["camera_rgb_frame"][0] == frames["camera_depth_frame"][0] == "camera_link"


def test_beside_a_driver_with_frames_of_its_own_only_our_names_are_added():
    config = parse(CameraFramesConfig, {**load("camera_frames.yaml"), "driver_frames": False})
    assert [(parent, child) for parent, child, _ in camera_frames(config)] == [
        ("camera_rgb_optical_frame", "camera/rgb_frame"),
        ("camera_depth_optical_frame", "camera/depth_frame"),
    ]


def test_the_frames_are_those_of_the_simulated_world():
    model = pytest.importorskip("rig_simulation.world.model")
    config = parse(CameraFramesConfig, load("camera_frames.yaml"))
    np.testing.assert_array_equal(config.rgb, model.RGB_IN_LINK)
    np.testing.assert_array_equal(config.depth, model.DEPTH_IN_LINK)
