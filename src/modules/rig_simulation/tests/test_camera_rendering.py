"""Rendered pictures against the camera model: where things appear, how far they are, colour over depth."""

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from common.camera_model import CameraModel, pinhole
from common.config import parse
from common.errors import DeviceError
from rig_simulation.devices.camera.rgbd_camera import Renderer, RgbdCamera
from rig_simulation.devices.camera.sensors import CameraLens, ColourSensor
from rig_simulation.node_parameters import ColourConfig, DepthConfig

WIDTH, HEIGHT = 320, 240
K = [[272.9, 0.0, 163.1], [0.0, 273.6, 124.5], [0.0, 0.0, 1.0]]
PLAIN = pinhole("plain", WIDTH, HEIGHT, K)
CURVED = CameraModel(
    "curved", WIDTH, HEIGHT, PLAIN.K, np.array([0.0439, -0.118, 0.0017, 0.0032, 0.0]), PLAIN.R, PLAIN.P
)
BALLS = np.array([[0.0, 0.0, 1.0], [-0.4, 0.25, 0.9], [0.5, -0.3, 1.2], [-0.35, -0.3, 1.1], [0.3, 0.22, 0.8]])
"""Centres in the optical frame of the colour camera [m]."""
RADIUS = 0.02
OFFSET = 0.027
FILE = yaml.safe_load((Path(__file__).parents[1] / "config" / "camera.yaml").read_text())
QUIET = {"noise": False, "edge_jitter": 0.0, "quantisation": 0.0, "shadows": False, "max_angle": 90.0}
QUIET = {**FILE["depth"], **QUIET, "min_signal": 0.0, "scale_error_sd": 0.0, "warp_sd": 0.0}


def model_of(bodies: str) -> mujoco.MjModel:
    """The cameras in the origin and beside it; they look down along the world's -z, so optical y and z turn over."""
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><visual><headlight ambient="1 1 1" diffuse="0 0 0" specular="0 0 0"/></visual><worldbody>
        <camera name="camera_rgb_optical_frame"/><camera name="camera_depth_optical_frame" pos="{-OFFSET} 0 0"/>
        {bodies}</worldbody></mujoco>"""
    )


def balls() -> mujoco.MjModel:
    geoms = "".join(f'<geom type="sphere" size="{RADIUS}" pos="{x} {-y} {-z}" rgba="1 1 1 1"/>' for x, y, z in BALLS)
    return model_of(geoms)


def data_of(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


@pytest.fixture
def cameras():
    """Makes cameras that are closed at the end; skips where nothing can be rendered."""
    made = []

    def make(model: mujoco.MjModel, rgb=PLAIN, depth=PLAIN, samples=4, **changes) -> RgbdCamera:
        colour = parse(ColourConfig, {"exposure": 1.0, "blur": 0.0, "noise": 0.0})
        made.append(RgbdCamera(rgb, depth, colour, parse(DepthConfig, {**QUIET, **changes}), samples, seed=1))
        try:
            made[-1].attach(model)
        except DeviceError as error:
            pytest.skip(str(error))
        return made[-1]

    yield make
    for camera in made:
        camera.close()


def centroids(picture: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Returns the centroid of brightness around each expected pixel, shape (n, 2)."""
    grey = picture[..., 0].astype(float)
    found = []
    for u, v in expected:
        rows, columns = np.mgrid[int(v) - 14 : int(v) + 15, int(u) - 14 : int(u) + 15]
        weight = grey[rows, columns]
        found.append(((columns * weight).sum() / weight.sum(), (rows * weight).sum() / weight.sum()))
    return np.array(found)


@pytest.mark.parametrize("lens", [PLAIN, CURVED])
def test_things_appear_where_the_camera_model_projects_them(cameras, lens):
    model = balls()
    picture = cameras(model, rgb=lens).take(data_of(model), True, False, False).colour
    # The outline of a ball is an ellipse whose centre lies a little outwards of its centre's projection.
    outline = BALLS / (1.0 - RADIUS**2 / BALLS[:, 2:] ** 2) * [1.0, 1.0, 0.0] + BALLS * [0.0, 0.0, 1.0]
    expected = lens.project(outline)
    np.testing.assert_allclose(centroids(picture, expected), expected, atol=0.1)


@pytest.mark.parametrize("samples", [0, 4])
@pytest.mark.parametrize("lens", [PLAIN, CURVED])
def test_depth_is_that_of_a_slanted_plane(cameras, lens, samples):
    model = model_of('<geom type="plane" size="0 0 1" pos="0 0 -1.2" euler="30 20 0"/>')
    data = data_of(model)
    camera = cameras(model, rgb=lens, depth=lens, samples=samples)
    pictures = camera.take(data, colour=False, depth=True, registered=True)
    normal = data.geom_xmat[0].reshape(3, 3)[:, 2] * [1, -1, -1]
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = lens.rays(np.stack((u, v), axis=-1))
    for depth, x in ((pictures.registered, 0.0), (pictures.depth, -OFFSET)):
        truth = normal @ [-x, 0.0, 1.2] / (rays @ normal) * 1000.0
        seen = depth > 0
        np.testing.assert_array_equal(
            seen, (truth > 450.0) & (truth < 3500.0) | seen & (truth > 449.0) & (truth < 3503.0)
        )
        assert np.abs(depth[seen] - truth[seen]).max() < 1.0 + 0.0005 * truth[seen].max()


def test_a_new_model_is_looked_at_with_the_same_unit(cameras):
    wall = model_of('<geom type="plane" size="0 0 1" pos="0 0 -1"/>')
    camera = cameras(wall, scale_error_sd=0.01)
    before = camera.take(data_of(wall), False, True, False).depth
    other = balls()
    camera.attach(other)
    assert camera.take(data_of(other), True, False, False).colour.max() == 255
    camera.attach(wall)
    np.testing.assert_array_equal(camera.take(data_of(wall), False, True, False).depth, before)


def test_a_world_without_the_cameras_is_refused(cameras):
    camera = cameras(balls())
    with pytest.raises(DeviceError):
        camera.attach(mujoco.MjModel.from_xml_string("<mujoco/>"))


def test_both_depths_have_the_same_errors_of_the_unit(cameras):
    wall = model_of('<geom type="plane" size="0 0 1" pos="0 0 -1"/>')
    pictures = cameras(wall, scale_error_sd=0.01, warp_sd=0.003).take(data_of(wall), False, True, True)
    np.testing.assert_allclose(pictures.depth.astype(float), pictures.registered.astype(float), atol=1.01)


def test_exposure_and_noise_of_the_colour_picture():
    lens = CameraLens(PLAIN)
    grey = np.full((lens.window.height, lens.window.width, 3), 100, np.uint8)
    config = parse(ColourConfig, {"exposure": 1.2, "blur": 0.5, "noise": 2.5})
    sensor = ColourSensor(lens, config, np.random.default_rng(1))
    pictures = np.stack([sensor.take(grey) for _ in range(10)]).astype(float)
    assert pictures.mean() == pytest.approx(120.0, abs=0.1)
    assert pictures.std() == pytest.approx(2.5, rel=0.03)
    assert np.any(pictures[0] != pictures[1])


def test_what_is_not_drawn_would_not_be_seen(cameras, monkeypatch):
    rng = np.random.default_rng(2)
    kinds = ("sphere", "capsule", "cylinder", "box", "ellipsoid")
    geoms = "".join(
        f'<geom type="{rng.choice(kinds)}" size="{" ".join(map(str, rng.uniform(0.02, 0.2, 3)))}" '
        f'pos="{" ".join(map(str, rng.uniform((-1.5, -1.2, -2.0), (1.5, 1.2, 0.5))))}" '
        f'euler="{" ".join(map(str, rng.uniform(0, 180, 3)))}" rgba="{rng.random()} 0.7 0.5 1"/>'
        for _ in range(120)
    )
    model = model_of(geoms)
    data = data_of(model)
    groups = model.geom_group.copy()
    seen = cameras(model, rgb=CURVED).take(data, True, True, True)
    np.testing.assert_array_equal(model.geom_group, groups)
    hidden = []
    monkeypatch.setattr(
        Renderer,
        "_beyond",
        lambda r, d, c, beyond=Renderer._beyond: hidden.append(beyond(r, d, c)) or hidden[-1] & False,
    )
    whole = cameras(model, rgb=CURVED).take(data, True, True, True)
    assert 20 < hidden[0].sum() < 100
    for name in ("colour", "depth", "registered"):
        np.testing.assert_array_equal(getattr(seen, name), getattr(whole, name))


def test_a_machine_that_cannot_render_is_named_in_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    with pytest.raises(DeviceError, match="libegl1"):
        Renderer(balls(), CameraLens(PLAIN).window, 0)
