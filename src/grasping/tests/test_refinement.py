"""The second network: untrained it changes nothing, it turns and moves with the picture, and its file is safe."""

from __future__ import annotations

import io

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from common.camera_model import pinhole
from grasping.depth_image import NETWORK_SIDE, Crop, centre_crop, prepare
from grasping.maps import Peak
from grasping.projection import grasp
from grasping.refinement import (
    HEIGHT,
    SHRINK,
    SIDE,
    Refinement,
    RefinementNetwork,
    content,
    features,
    load,
    refined_grasp,
)
from grasping.view import VIEWS
from grasping.weights import WeightsError

CAMERA = pinhole("camera", 640, 480, [[570.0, 0.0, 319.5], [0.0, 570.0, 239.5], [0.0, 0.0, 1.0]])
SHAPE = (480, 640)


def scene(seed: int = 0):
    """Returns GGCNN's maps, the picture and the depth of a made-up scene."""
    rng = np.random.default_rng(seed)
    depth = (0.7 + 0.05 * rng.random(SHAPE)).astype(np.float32)
    output = rng.standard_normal((4, NETWORK_SIDE, NETWORK_SIDE)).astype(np.float32)
    return output, prepare(depth, centre_crop(SHAPE)), depth


def trained(seed: int = 1) -> RefinementNetwork:
    """Returns a network with random weights in every layer."""
    torch.manual_seed(seed)
    network = RefinementNetwork()
    for parameter in network.parameters():
        parameter.data.normal_(0.0, 0.2)
    return network


def test_untrained_it_is_ggcnn_bit_by_bit():
    output, picture, depth = scene()
    refined = Refinement(RefinementNetwork()).apply(output, picture)
    np.testing.assert_array_equal(refined.output, output)
    assert refined.output.dtype == np.float32
    for values in (refined.dz, refined.tilt_x, refined.tilt_y):
        np.testing.assert_array_equal(values, np.zeros((NETWORK_SIDE, NETWORK_SIDE)))
    peak = Peak(120, 170, 0.8, 0.4, 60.0)
    own = grasp(peak, picture.crop, NETWORK_SIDE, depth, CAMERA)
    same = refined_grasp(own, refined, peak)
    np.testing.assert_array_equal(same.T_camera_grasp, own.T_camera_grasp)
    assert same.width == own.width


def looks(turn_or_shift) -> np.ndarray:
    """Returns the changes of a trained network in the middle of the picture of a bump whose maps and depth were turned
    or shifted alike."""
    row, column = np.indices((NETWORK_SIDE, NETWORK_SIDE))
    bump = np.exp(-((row - 140.0) ** 2 / 400.0 + (column - 170.0) ** 2 / 900.0))
    maps = [turn_or_shift(m).astype(np.float32) for m in (bump, 0.3 * bump, 0.2 * bump, 0.1 + 0.3 * bump, -0.05 * bump)]
    depth = 0.7 + maps.pop()
    picture = prepare(depth, Crop(0, 0, NETWORK_SIDE))._replace(mean=0.7)
    with torch.no_grad():
        return trained()(torch.from_numpy(features(np.stack(maps), picture))[None])[0].numpy()


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_turned_picture_gives_turned_changes(quarters):
    found, plain = looks(lambda m: np.rot90(m, quarters)), looks(lambda m: m)
    np.testing.assert_allclose(found, np.rot90(plain, quarters, (1, 2)), atol=0.02 * np.abs(plain).max())


@settings(max_examples=8)
@given(st.integers(-3, 3), st.integers(-3, 3))
def test_a_shifted_picture_gives_shifted_changes(rows, columns):
    found = looks(lambda m: np.roll(m, (SHRINK * rows, SHRINK * columns), (0, 1)))
    plain = looks(lambda m: m)
    inner = (slice(None), slice(15, 60), slice(15, 60))
    wanted = np.roll(plain, (rows, columns), (1, 2))
    np.testing.assert_allclose(found[inner], wanted[inner], atol=0.02 * np.abs(plain).max())


def test_the_network_looks_at_means_of_blocks():
    output, picture, _ = scene()
    seen = features(output, picture)
    np.testing.assert_allclose(seen[0], output[0].reshape(SIDE, SHRINK, SIDE, SHRINK).mean((1, 3)), atol=1e-5)
    # Recorded maps are half the size.
    half = output.reshape(4, 2 * SIDE, 2, 2 * SIDE, 2).mean((2, 4))
    np.testing.assert_allclose(features(half, picture), seen, atol=1e-5)


def test_a_leaning_camera_sees_the_same_heights():
    """Two things equally high on a table that leans away look alike to the network."""
    row, column = np.indices(SHAPE)
    table = 1.0 / (1.4 + 0.001 * (row - 240.0))
    depth = table.copy()
    for part in ((slice(200, 240), slice(160, 220)), (slice(300, 340), slice(400, 460))):
        depth[part] -= 0.05
    picture = prepare(depth.astype(np.float32), centre_crop(SHAPE))
    heights = features(np.zeros((4, NETWORK_SIDE, NETWORK_SIDE), np.float32), picture)[HEIGHT]
    np.testing.assert_allclose(heights[heights > 0.025], 0.05, atol=0.025)
    assert np.median(heights[heights > 0.025]) == pytest.approx(0.05, abs=0.001)
    assert np.median(np.abs(heights[heights < 0.025])) < 0.001


def test_a_constant_offset_moves_the_maps_and_keeps_the_grasps_depth():
    network = RefinementNetwork()
    output, picture, _ = scene()
    network.offset[:] = torch.tensor([3.0 * picture.mean, -2.0 * picture.mean, 0.1, -0.05, 0.3])
    refined = Refinement(network).apply(output, picture)
    found, before = refined.output[:, 10:-10, 13:-7], output[:, 12:-8, 10:-10]
    np.testing.assert_allclose(found[[0, 3]], before[[0, 3]], atol=1e-4)
    angle = np.exp(2j * 0.3) * (before[1] + 1j * before[2])
    np.testing.assert_allclose(found[1] + 1j * found[2], angle, atol=1e-4)
    found = (picture.depth + refined.dz)[10:-10, 13:-7]
    np.testing.assert_allclose(found, picture.depth[12:-8, 10:-10], atol=1e-4)
    np.testing.assert_allclose(refined.tilt_x, 0.1, atol=1e-6)
    np.testing.assert_allclose(refined.tilt_y, -0.05, atol=1e-6)


def test_a_refined_grasp_stays_on_its_pixels_ray_and_leans():
    _, picture, depth = scene()
    peak = Peak(120, 170, 0.8, 0.4, 60.0)
    own = grasp(peak, picture.crop, NETWORK_SIDE, depth, CAMERA)
    refined = Refinement(RefinementNetwork()).apply(*scene()[:2])
    refined.dz[120, 170], refined.tilt_x[120, 170] = 0.02, 0.3
    found = refined_grasp(own, refined, peak)
    p, before = found.T_camera_grasp[:3, 3], own.T_camera_grasp[:3, 3]
    assert p[2] == pytest.approx(before[2] + 0.02)
    np.testing.assert_allclose(p / p[2], before / before[2], atol=1e-9)
    np.testing.assert_allclose(found.T_camera_grasp[:3, 2], [0.0, -np.sin(0.3), np.cos(0.3)], atol=1e-7)
    assert found.width == pytest.approx(own.width * p[2] / before[2])


def file(state) -> bytes:
    buffer = io.BytesIO()
    torch.save(state, buffer)
    return buffer.getvalue()


def test_a_saved_network_comes_back():
    network = trained()
    network.offset[:] = torch.tensor([1.0, 2.0, 0.1, 0.2, 0.3])
    output, picture, _ = scene()
    for a, b in zip(
        load(file(network.state_dict())).apply(output, picture), Refinement(network).apply(output, picture)
    ):
        np.testing.assert_array_equal(a, b)


def bad(key, value):
    state = RefinementNetwork().state_dict()
    state[key] = value
    return state


@pytest.mark.parametrize("view", VIEWS)
def test_a_file_names_the_view_in_which_it_learned(view):
    assert load(file(content(trained(), view))).view == view
    assert load(file(trained().state_dict())).view is None


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"nothing", "The torch file cannot be read"),
        (file({}), "neither a state dict nor a model"),
        (file({"a": torch.zeros(3)}), "lacks"),
        (file(bad("offset", torch.zeros(3))), "The array offset has the shape"),
        (file(bad("offset", torch.full((5,), np.nan))), "not finite"),
        (file(bad("view", torch.tensor(2.0))), "names no view"),
        (file(bad("view", torch.zeros(2))), "names no view"),
    ],
    ids=["no torch file", "empty", "foreign", "shape", "not finite", "view", "views"],
)
def test_bad_files_are_refused(data, sentence):
    with pytest.raises(WeightsError, match=sentence):
        load(data)


def test_another_hash_is_refused():
    with pytest.raises(WeightsError, match="but 00 was expected"):
        load(file(RefinementNetwork().state_dict()), "00")
