"""The simulated depth sensor: each effect against its figure, and off when it is switched off."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from common.camera_model import pinhole
from common.config import parse
from common.errors import ConfigError
from rig_simulation.devices.camera.sensors import (
    SHADOW_TOLERANCE_PX,
    CameraLens,
    DepthSensor,
    hidden,
    steep_sigma,
)
from rig_simulation.node_parameters import DepthConfig

F, BASELINE = 570.0, 0.075
WIDTH, HEIGHT = 320, 240
FILE = yaml.safe_load((Path(__file__).parents[1] / "config" / "camera.yaml").read_text())
IDEAL = {
    **FILE["depth"],
    "noise": False,
    "edge_jitter": 0.0,
    "quantisation": 0.0,
    "shadows": False,
    "max_angle": 90.0,
    "min_signal": 0.0,
    "scale_error_sd": 0.0,
    "warp_sd": 0.0,
    "projector_baseline": BASELINE,
}


@pytest.fixture(scope="module")
def lens() -> CameraLens:
    return CameraLens(pinhole("depth", WIDTH, HEIGHT, [[F, 0, 159.5], [0, F, 119.5], [0, 0, 1]]))


def sensor(lens: CameraLens, seed: int = 1, infrared_offset: float = 0.0, **changes) -> DepthSensor:
    config = parse(DepthConfig, {**IDEAL, **changes})
    return DepthSensor(lens, config, np.random.default_rng(seed), infrared_offset)


def axial_sigma(z):
    """The published standard deviation of depth at z [m]: 1.2 mm at 0.5 m, 6.1 mm at 2 m."""
    return 0.0012 + 0.0019 * (z - 0.4) ** 2


def window_of(lens: CameraLens, inverse_depth) -> np.ndarray:
    """Returns the window's picture of a function of x (right) and y (down) in the plane at 1 m, 30 m at most."""
    window = lens.window
    x = window.left + (np.arange(window.width) + 0.5) / window.width * (window.right - window.left)
    y = window.bottom + (np.arange(window.height) + 0.5) / window.height * (window.top - window.bottom)
    x, y = np.meshgrid(x, -y)
    return np.maximum(np.broadcast_to(inverse_depth(x, y), x.shape), 1 / 30).astype(np.float32)


def wall(lens: CameraLens, z: float) -> np.ndarray:
    return window_of(lens, lambda x, y: 1.0 / z)


def white(lens: CameraLens, grey: int = 255) -> np.ndarray:
    return np.full((lens.window.height, lens.window.width, 3), grey, np.uint8)


def take(lens: CameraLens, z: float, count: int = 1, **changes) -> np.ndarray:
    camera = sensor(lens, **changes)
    return np.stack([camera.take(wall(lens, z), white(lens)) for _ in range(count)]).astype(float)


@settings(max_examples=15)
@given(z=st.floats(0.46, 3.49))
def test_an_ideal_sensor_tells_the_truth_to_the_millimetre(lens, z):
    np.testing.assert_allclose(take(lens, z), 1000.0 * z, atol=0.51)


@settings(max_examples=15)
@given(nx=st.floats(-0.7, 0.7), ny=st.floats(-0.7, 0.7))
def test_an_ideal_sensor_sees_slanted_planes_as_they_are(lens, nx, ny):
    """A plane n . p = 1 has the inverse depth n . ray."""
    w = window_of(lens, lambda x, y: 1.0 + nx * x + ny * y)
    u, v = np.meshgrid(np.arange(WIDTH) - 159.5, np.arange(HEIGHT) - 119.5)
    truth = 1000.0 / (1.0 + (nx * u + ny * v) / F)
    np.testing.assert_allclose(sensor(lens).take(w, white(lens)), truth, atol=0.8)


@pytest.mark.parametrize("z", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("quantisation", [0.0, 0.125])
def test_the_noise_has_the_published_standard_deviation(lens, z, quantisation):
    depth = take(lens, z, count=30, noise=True, quantisation=quantisation)
    assert np.all(depth > 0.0)
    assert depth.std() == pytest.approx(1000.0 * axial_sigma(z), rel=0.06)
    assert depth.mean() == pytest.approx(1000.0 * z, abs=0.15 * 1000.0 * axial_sigma(z))


def test_noise_of_neighbours_is_alike_and_of_successive_pictures_is_not(lens):
    depth = take(lens, 1.0, count=40, noise=True)
    depth -= depth.mean()

    def alike(a, b):
        return float((a * b).mean() / depth.var())

    # Blurring with a standard deviation s leaves a correlation exp(-d^2 / 4 s^2) at the distance d.
    assert alike(depth[..., :-2], depth[..., 2:]) == pytest.approx(np.exp(-4 / 16), abs=0.1)
    assert abs(alike(depth[..., :-12], depth[..., 12:])) < 0.05
    assert abs(alike(depth[:-1], depth[1:])) < 0.05
    rough = take(lens, 1.0, count=20, noise=True, correlation=0.0)
    rough -= rough.mean()
    assert abs((rough[..., :-1] * rough[..., 1:]).mean() / rough.var()) < 0.05


def box_before_wall(lens: CameraLens) -> np.ndarray:
    """Columns 100 to 199 at 0.8 m, the rest at 1.6 m."""
    return window_of(lens, lambda x, y: np.where(np.abs(F * x + 159.5 - 149.5) < 50.0, 1 / 0.8, 1 / 1.6))


def test_the_projectors_shadow_lies_to_the_left_as_wide_as_the_disparities_differ(lens):
    depth = sensor(lens, shadows=True).take(box_before_wall(lens), white(lens))
    lost = np.flatnonzero(depth[120] == 0)
    width = F * BASELINE * (1 / 0.8 - 1 / 1.6)
    assert (lost.max(), len(lost)) == (99, pytest.approx(width, abs=1.0))
    assert sensor(lens).take(box_before_wall(lens), white(lens)).all()


def test_registered_depth_also_misses_what_the_infrared_camera_does_not_see(lens):
    depth = sensor(lens, shadows=True, infrared_offset=-0.027).take(box_before_wall(lens), white(lens))
    lost = np.flatnonzero(depth[120] == 0)
    left, right = lost[lost < 100], lost[lost >= 200]
    assert (left.max(), len(left)) == (99, pytest.approx(F * (BASELINE - 0.027) * 0.625, abs=1.0 + SHADOW_TOLERANCE_PX))
    assert (right.min(), len(right)) == (200, pytest.approx(F * 0.027 * 0.625, abs=1.0))


@settings(max_examples=40)
@given(slope=st.floats(-0.9, 0.9), fb=st.sampled_from([-14.0, 43.0]))
def test_a_plane_hides_no_part_of_itself(slope, fb):
    w = 1.0 + slope * (np.arange(WIDTH, dtype=np.float32) - 159.5) / F
    assert not hidden(w[None], fb).any()


def plain(lens: CameraLens, camera: DepthSensor, config: DepthConfig, inverse_depth, brightness, fbs) -> np.ndarray:
    """The image by the formulas alone, one whole array an operation; takes the sensor's own random fields."""
    height, width = lens.camera.height, lens.camera.width
    smooth = lens.distort(inverse_depth)
    beside = lens.distort_nearest(inverse_depth, camera._jitter.cut())
    w = np.where(np.abs(beside - smooth) > 0.01 * smooth, beside, smooth).astype(float)
    padded = np.pad(w, 1, mode="reflect")
    wu, wv = (padded[1:-1, 2:] - padded[1:-1, :-2]) / 2.0, (padded[2:, 1:-1] - padded[:-2, 1:-1]) / 2.0
    u, v = np.meshgrid(np.arange(width) - 159.5, np.arange(height) - 119.5)
    length = np.sqrt((w - u * wu - v * wv) ** 2 + (F * wu) ** 2 + (F * wv) ** 2)
    cosine = w / (length * np.sqrt((u / F) ** 2 + (v / F) ** 2 + 1.0))
    lost = cosine < np.cos(np.radians(config.max_angle))
    for fb in fbs:
        shifted = u - fb * w
        if fb > 0.0:
            lost |= shifted > np.minimum.accumulate(shifted[:, ::-1], axis=1)[:, ::-1] + SHADOW_TOLERANCE_PX
        else:
            lost |= shifted < np.maximum.accumulate(shifted, axis=1) - SHADOW_TOLERANCE_PX
    white = (lens.distort(brightness[..., 0]) / 255.0) ** 2.2
    returned = config.dark_return + (1.0 - config.dark_return) * white
    lost |= returned * cosine * w**2 * (1.0 + 0.2 * camera._noise.cut()) < config.min_signal
    level = np.rint(255.0 * cosine) / 255.0
    sigma = F * BASELINE * (axial_sigma(1.0 / w) * w**2 + steep_sigma(np.arccos(level)) * w**2.5)
    noise = np.sqrt(np.maximum(sigma**2 - config.quantisation**2 / 12.0, 0.0)) * camera._noise.cut()
    steps = np.rint((F * BASELINE * w / camera.scale + camera._warp + noise) / config.quantisation)
    z = F * BASELINE / np.maximum(steps * config.quantisation, 1e-6)
    return np.where((z < config.min_range) | (z > config.max_range) | lost, 0.0, np.rint(1000.0 * z)).astype(int)


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), offset=st.sampled_from([0.0, -0.027]))
def test_the_image_is_that_of_the_formulas(lens, seed, offset):
    """Boxes at random places before a slanted wall."""
    rng = np.random.default_rng(seed)
    slope = rng.uniform(-0.8, 0.8, 2)
    w = window_of(lens, lambda x, y: 0.6 + slope[0] * x + slope[1] * y)
    brightness = white(lens)
    for _ in range(6):
        row, column = rng.integers(0, HEIGHT), rng.integers(0, WIDTH)
        area = slice(row, row + rng.integers(5, 80)), slice(column, column + rng.integers(5, 80))
        w[area], brightness[area] = rng.uniform(0.1, 2.2), rng.integers(0, 255)
    everything = {**{key: FILE["depth"][key] for key in IDEAL}, "projector_baseline": BASELINE}
    config = parse(DepthConfig, everything)
    first, second = (sensor(lens, 7, offset, **everything) for _ in range(2))
    fbs = [F * x for x in (offset + BASELINE, offset) if x != 0.0]
    taken, expected = first.take(w, brightness).astype(int), plain(lens, second, config, w, brightness, fbs)
    assert np.mean((taken > 0) != (expected > 0)) < 5e-4
    both = (taken > 0) & (expected > 0)
    assert np.mean(taken[both] != expected[both]) < 5e-3


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), fb=st.floats(-60.0, 60.0).filter(lambda fb: abs(fb) > 0.1))
def test_hidden_is_what_a_neighbour_overtakes(seed, fb):
    rng = np.random.default_rng(seed)
    w = np.repeat(rng.uniform(0.03, 3.0, (4, 12)), rng.integers(1, 20, 12), axis=1).astype(np.float32)
    shifted = np.arange(w.shape[1]) - fb * w.astype(float)
    found = hidden(w, fb)
    for row, column in np.ndindex(w.shape):
        s = shifted[row]
        by = s[column] - s[column:].min() if fb > 0.0 else s[: column + 1].max() - s[column]
        assert found[row, column] == (by > SHADOW_TOLERANCE_PX) or by == pytest.approx(SHADOW_TOLERANCE_PX, abs=1e-3)


def tilted(lens: CameraLens, angle: float) -> np.ndarray:
    """A plane 1 m away, turned by the angle about the vertical [deg]."""
    return window_of(lens, lambda x, y: 1.0 + np.tan(np.radians(angle)) * x)


@pytest.mark.parametrize("angle, seen", [(60.0, True), (79.4, True), (80.6, False)])
def test_steep_surfaces_are_not_seen(lens, angle, seen):
    centre = sensor(lens, max_angle=80.0).take(tilted(lens, angle), white(lens))[100:140, 158:162]
    assert np.all((centre > 0) == seen)


def test_steep_surfaces_are_noisier(lens):
    camera = sensor(lens, noise=True)
    for angle, sigma in ((30.0, 0.0019), (75.0, 0.0019 + 0.0025)):
        depth = np.stack([camera.take(tilted(lens, angle), white(lens))[:, 159:161] for _ in range(60)]).astype(float)
        assert (depth - depth.mean(axis=0)).std() == pytest.approx(1000.0 * sigma, rel=0.12)


def test_edges_are_ragged_but_nothing_floats_between_the_surfaces(lens):
    depth = sensor(lens, edge_jitter=0.8).take(box_before_wall(lens), white(lens))
    assert set(np.unique(depth)) == {800, 1600}
    edge = (depth[:, 80:120] == 1600).sum(axis=1)
    assert 0.5 < edge.std() < 1.5
    assert (sensor(lens).take(box_before_wall(lens), white(lens)) == 800).sum(axis=1).std() == 0.0


def test_a_unit_has_its_own_error_of_scale_and_warp():
    lens = CameraLens(pinhole("depth", 64, 48, [[F, 0, 31.5], [0, F, 23.5], [0, 0, 1]]))
    scales, warps = [], []
    for seed in range(40):
        scales.append(sensor(lens, seed, scale_error_sd=0.005).scale)
        depth = sensor(lens, seed, warp_sd=0.0015).take(wall(lens, 1.0), white(lens)).astype(float)
        warps.append(depth - 1000.0)
    assert np.std(scales) == pytest.approx(0.005, rel=0.3)
    assert 0.7 < np.std(warps) < 1.8
    depth = sensor(lens, 3, scale_error_sd=0.005).take(wall(lens, 2.0), white(lens))
    assert depth.mean() == pytest.approx(2000.0 * scales[3], abs=0.6)


def test_the_same_seed_gives_the_same_pictures(lens):
    everything = {key: FILE["depth"][key] for key in IDEAL}
    pictures = [
        [camera.take(box_before_wall(lens), white(lens)) for _ in range(3)]
        for camera in (sensor(lens, seed, **everything) for seed in (5, 5, 6))
    ]
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert np.any(pictures[0][0] != pictures[2][0])
    assert np.any(pictures[0][0] != pictures[0][1])


def test_a_range_without_room_is_refused():
    with pytest.raises(ConfigError, match="min_range"):
        parse(DepthConfig, {**IDEAL, "min_range": 2.0, "max_range": 1.0})
