"""The refinement network: untrained it changes nothing, and what it learned turns and moves with the image."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from common.camera_model import pinhole
from grasping.network.depth_image import NETWORK_SIDE, Crop, centre_crop, prepare
from grasping.network.maps import Peak
from grasping.network.refinement import (
    CHANGES,
    COS,
    DEPTH_M,
    HEIGHT,
    LEAN_X,
    LEAN_Y,
    SHRINK,
    SIDE,
    SIN,
    TILT_RAD,
    MapRefiner,
    RefinementNetwork,
    RefinementOutput,
    features,
)
from grasping.pipeline.projection import project_grasp
from grasping.pipeline.refined_grasp import (
    UNIFORM,
    angle_deviation,
    grasp_uncertainty,
    opened,
    pixel_probabilities,
    refined_grasp,
)

CAMERA = pinhole("camera", 640, 480, [[570.0, 0.0, 319.5], [0.0, 570.0, 239.5], [0.0, 0.0, 1.0]])
SHAPE = (480, 640)


def scene(seed: int = 0):
    """Returns GGCNN's maps, the image and the depth of a made-up scene."""
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
    output, image, depth = scene()
    refined = MapRefiner(RefinementNetwork()).apply(output, image)
    np.testing.assert_array_equal(refined.output, output)
    assert refined.output.dtype == np.float32
    for values in (refined.dz, refined.tilt_x, refined.tilt_y, refined.wider):
        np.testing.assert_array_equal(values, np.zeros((NETWORK_SIDE, NETWORK_SIDE)))
    peak = Peak(120, 170, 0.8, 0.4, 60.0)
    assert opened(peak, refined) == peak
    own = project_grasp(peak, image.crop, NETWORK_SIDE, depth, CAMERA)
    same = refined_grasp(own, refined, peak)
    np.testing.assert_array_equal(same.T_camera_grasp, own.T_camera_grasp)
    assert same.width == own.width


def looks(turn_or_shift) -> np.ndarray:
    """Returns the changes of a trained network in the middle of the image of a bump whose maps and depth were turned
    or shifted alike."""
    row, column = np.indices((NETWORK_SIDE, NETWORK_SIDE))
    bump = np.exp(-((row - 140.0) ** 2 / 400.0 + (column - 170.0) ** 2 / 900.0))
    maps = [turn_or_shift(m).astype(np.float32) for m in (bump, 0.3 * bump, 0.2 * bump, 0.1 + 0.3 * bump, -0.05 * bump)]
    depth = 0.7 + maps.pop()
    image = prepare(depth, Crop(0, 0, NETWORK_SIDE))._replace(mean=0.7)
    with torch.no_grad():
        return trained()(torch.from_numpy(features(np.stack(maps), image))[None])[0].numpy()


def refined_bump(quarters: int):
    """Returns what a trained network, without what has the axes of a view, makes of a bump in an image turned so."""
    row, column = np.indices((NETWORK_SIDE, NETWORK_SIDE))
    bump = np.exp(-((row - 140.0) ** 2 / 400.0 + (column - 170.0) ** 2 / 900.0))
    turn = np.exp(2j * 0.5 * np.pi * quarters)  # anticlockwise, as the line's
    line = np.rot90(np.exp(2j * (0.3 + bump)), quarters) * turn
    maps = [np.rot90(bump, quarters), line.real, line.imag, np.rot90(0.1 + 0.3 * bump, quarters)]
    depth = np.rot90(0.7 - 0.05 * bump, quarters)
    image = prepare(depth.astype(np.float32), Crop(0, 0, NETWORK_SIDE))._replace(mean=0.7)
    network = trained()
    network.load_state_dict(network.without_axes())
    network.last.bias.data[RefinementOutput._fields.index("follow")] = 2.0
    return MapRefiner(network).apply(np.stack(maps).astype(np.float32), image)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_line_and_lean_turn_with_the_image(quarters):
    plain, found = refined_bump(0), refined_bump(quarters)
    turn = np.exp(1j * 0.5 * np.pi * quarters)
    line = np.rot90(plain.output[1] + 1j * plain.output[2], quarters) * turn**2
    np.testing.assert_allclose(found.output[1] + 1j * found.output[2], line, atol=0.03)
    # A tilt is an axis: x right, y down, and the image turns anticlockwise.
    tilt = np.rot90(plain.tilt_x - 1j * plain.tilt_y, quarters) * turn
    assert np.abs(tilt).max() > 0.1
    np.testing.assert_allclose(found.tilt_x - 1j * found.tilt_y, tilt, atol=0.05 * np.abs(tilt).max())
    for name in ("wider", "concentration", "dz"):
        a, b = getattr(found, name), np.rot90(getattr(plain, name), quarters)
        np.testing.assert_allclose(a, b, atol=0.15 * np.abs(b).max())  # the neighbourhood is no perfect disc


def test_a_line_turned_by_half_a_turn_is_the_same_line():
    """All that goes in and out is of twice the angle."""
    output, image, _ = scene()
    angle = 0.5 * np.arctan2(output[2], output[1])
    turned = np.stack([output[0], np.cos(2.0 * (angle + np.pi)), np.sin(2.0 * (angle + np.pi)), output[3]])
    plain = np.stack([output[0], np.cos(2.0 * angle), np.sin(2.0 * angle), output[3]])
    found, same = (MapRefiner(trained()).apply(m.astype(np.float32), image) for m in (turned, plain))
    for a, b in zip(found, same):
        np.testing.assert_allclose(a, b, atol=1e-3)


def test_the_lean_is_that_of_the_surface():
    """A plane that rises by 0.2 to the right and by 0.1 downwards, in an image with a focal length of 400 px."""
    row, column = np.indices((NETWORK_SIDE, NETWORK_SIDE))
    z, focal = 0.7, SHRINK * 100.0
    height = np.clip((0.2 * (column - 150.0) + 0.1 * (row - 150.0)) * z / focal + 0.05, 0.0, None)
    table = np.full((NETWORK_SIDE, NETWORK_SIDE), z)
    inside = (abs(row - 150) < 60) & (abs(column - 150) < 60)
    image = prepare((table - np.where(inside, height, 0.0)).astype(np.float32), Crop(0, 0, NETWORK_SIDE))
    seen = features(np.zeros((4, NETWORK_SIDE, NETWORK_SIDE), np.float32), image._replace(mean=z))
    shrunk = 1.0 + np.hypot(0.2, 0.1)
    middle = slice(SIDE // 2 - 2, SIDE // 2 + 2)
    np.testing.assert_allclose(seen[LEAN_X][middle, middle], -0.1 / shrunk, atol=0.02)
    np.testing.assert_allclose(seen[LEAN_Y][middle, middle], 0.2 / shrunk, atol=0.02)
    assert np.abs(seen[[LEAN_X, LEAN_Y]]).max() < 1.0


def test_behind_the_features_stands_the_line():
    output, image, _ = scene()
    seen = features(output, image)
    np.testing.assert_allclose(np.hypot(seen[COS], seen[SIN]), 1.0, atol=1e-5)


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_turned_image_gives_turned_changes(quarters):
    found, plain = looks(lambda m: np.rot90(m, quarters)), looks(lambda m: m)
    np.testing.assert_allclose(found, np.rot90(plain, quarters, (1, 2)), atol=0.02 * np.abs(plain).max())


@settings(max_examples=8)
@given(st.integers(-3, 3), st.integers(-3, 3))
def test_a_shifted_image_gives_shifted_changes(rows, columns):
    found = looks(lambda m: np.roll(m, (SHRINK * rows, SHRINK * columns), (0, 1)))
    plain = looks(lambda m: m)
    inner = (slice(None), slice(15, 60), slice(15, 60))
    wanted = np.roll(plain, (rows, columns), (1, 2))
    np.testing.assert_allclose(found[inner], wanted[inner], atol=0.02 * np.abs(plain).max())


def test_the_network_looks_at_means_of_blocks():
    output, image, _ = scene()
    seen = features(output, image)
    np.testing.assert_allclose(seen[0], output[0].reshape(SIDE, SHRINK, SIDE, SHRINK).mean((1, 3)), atol=1e-5)
    # Recorded maps are half the size.
    half = output.reshape(4, 2 * SIDE, 2, 2 * SIDE, 2).mean((2, 4))
    np.testing.assert_allclose(features(half, image), seen, atol=1e-5)


def test_a_leaning_camera_sees_the_same_heights():
    """Two things equally high on a table that leans away look alike to the network."""
    row, column = np.indices(SHAPE)
    table = 1.0 / (1.4 + 0.001 * (row - 240.0))
    depth = table.copy()
    for part in ((slice(200, 240), slice(160, 220)), (slice(300, 340), slice(400, 460))):
        depth[part] -= 0.05
    image = prepare(depth.astype(np.float32), centre_crop(SHAPE))
    heights = features(np.zeros((4, NETWORK_SIDE, NETWORK_SIDE), np.float32), image)[HEIGHT]
    np.testing.assert_allclose(heights[heights > 0.025], 0.05, atol=0.025)
    assert np.median(heights[heights > 0.025]) == pytest.approx(0.05, abs=0.001)
    assert np.median(np.abs(heights[heights < 0.025])) < 0.001


def test_a_constant_offset_moves_the_maps_and_keeps_the_grasps_depth():
    network = RefinementNetwork()
    output, image, _ = scene()
    network.offset[:] = torch.tensor([3.0 * image.mean, -2.0 * image.mean, 0.02, 0.3, 0.1, -0.05, 0.1])
    refined = MapRefiner(network).apply(output, image)
    found, before = refined.output[:, 10:-10, 13:-7], output[:, 12:-8, 10:-10]
    np.testing.assert_allclose(found[[0, 3]], before[[0, 3]], atol=1e-4)
    angle = np.exp(2j * 0.3) * (before[1] + 1j * before[2])
    np.testing.assert_allclose(found[1] + 1j * found[2], angle, atol=1e-4)
    found = (image.depth + refined.dz)[10:-10, 13:-7]
    np.testing.assert_allclose(found, image.depth[12:-8, 10:-10] + 0.02, atol=1e-4)
    np.testing.assert_allclose(refined.wider, 0.1 * 150.0 / image.mean, rtol=1e-5)
    np.testing.assert_allclose(refined.tilt_x, 0.1, atol=1e-6)
    np.testing.assert_allclose(refined.tilt_y, -0.05, atol=1e-6)


def test_a_refined_grasp_stays_on_its_pixels_ray_and_leans():
    _, image, depth = scene()
    peak = Peak(120, 170, 0.8, 0.4, 60.0)
    own = project_grasp(peak, image.crop, NETWORK_SIDE, depth, CAMERA)
    refined = MapRefiner(RefinementNetwork()).apply(*scene()[:2])
    refined.dz[120, 170], refined.tilt_x[120, 170] = 0.02, 0.3
    found = refined_grasp(own, refined, peak)
    p, before = found.T_camera_grasp[:3, 3], own.T_camera_grasp[:3, 3]
    assert p[2] == pytest.approx(before[2] + 0.02)
    np.testing.assert_allclose(p / p[2], before / before[2], atol=1e-9)
    np.testing.assert_allclose(found.T_camera_grasp[:3, 2], [0.0, -np.sin(0.3), np.cos(0.3)], atol=1e-7)
    assert found.width == pytest.approx(own.width * p[2] / before[2])


def test_what_an_untrained_network_says_of_its_spread():
    said = RefinementOutput.of(torch.zeros(1, len(CHANGES), 2, 2))
    for values, wanted in ((said.depth_scale, DEPTH_M), (said.tilt_scale, TILT_RAD), (said.turn_sin, 0.0)):
        np.testing.assert_allclose(values.numpy(), wanted)


def test_what_is_done_live_is_what_training_means():
    """A network that says the same everywhere, in front of a level table: the pose is what the losses compare."""
    network = RefinementNetwork()
    network.last.bias.data = torch.tensor([0.3, 0.4, -0.5, 0.6, 0.7, 0.5, -0.4, 0.8, 0.1, -0.2, 0.3])
    network.offset[:] = torch.tensor([0.0, 0.0, 0.01, 0.2, 0.1, -0.05, 0.02])
    said = RefinementOutput.of(network(torch.zeros(1, LEAN_Y + 1, 1, 1)))
    said = {name: value.item() for name, value in said._asdict().items()}
    output, image, _ = scene()
    level = image._replace(depth=np.full_like(image.depth, 0.7), mean=0.7)
    refined = MapRefiner(network).apply(output, level)
    turn = np.arctan2(said["turn_sin"], said["turn_cos"]) + 2.0 * 0.2
    line = np.exp(1j * turn) * (output[1] + 1j * output[2])
    np.testing.assert_allclose(refined.output[0], output[0] + said["quality"], atol=1e-5)
    np.testing.assert_allclose(refined.output[1] + 1j * refined.output[2], line, atol=1e-5)
    np.testing.assert_array_equal(refined.output[3], output[3])
    for found, wanted in (
        (refined.dz, said["depth"] + 0.01),
        (refined.tilt_x, said["tilt_x"] + 0.1),
        (refined.tilt_y, said["tilt_y"] - 0.05),
        (refined.wider, (said["opening"] + 0.02) * 150.0 / 0.7),
        (refined.concentration, np.hypot(said["turn_cos"], said["turn_sin"])),
        (refined.scales[0], said["depth_scale"]),
        (refined.scales[1], said["opening_scale"] * 150.0 / 0.7),
        (refined.scales[2], said["tilt_scale"]),
    ):
        np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-6)


def test_a_person_sees_a_wider_hand():
    output, image, _ = scene()
    refined = MapRefiner(RefinementNetwork()).apply(output, image)
    refined.wider[120, 170] = 12.0
    assert opened(Peak(120, 170, 0.8, 0.4, 60.0), refined).width == 72.0


@pytest.mark.parametrize("deviation", [0.05, 0.1, 0.3])
def test_the_deviation_of_an_angle_is_that_of_its_samples(deviation):
    rng = np.random.default_rng(0)
    concentration = 1.0 / (2.0 * deviation) ** 2
    drawn = 0.5 * rng.vonmises(0.0, concentration, 100_000)
    length = abs(np.exp(2j * drawn).mean())
    assert angle_deviation(concentration) == pytest.approx(0.5 * np.sqrt(-2.0 * np.log(length)), rel=0.02)
    assert angle_deviation(0.0) == UNIFORM


def test_the_spread_of_a_grasp():
    """Two places in one image, three to one, the first drawn out along its fingers."""
    row, column = np.indices((SIDE, SIDE))
    first = 3.0 * np.exp(-((column - 20.0) ** 2 / 8.0 + (row - 20.0) ** 2 / 2.0))
    second = 1.5 * np.exp(-((column - 20.0) ** 2 + (row - 32.0) ** 2) / 4.0)
    mass = first + second + 1e-9
    quality = np.kron(np.log(mass) / 20.0, np.ones((SHRINK, SHRINK))).astype(np.float32)
    output, image, depth = scene()
    refined = MapRefiner(RefinementNetwork()).apply(np.stack([quality, *output[1:]]), image)
    place = pixel_probabilities(refined)
    np.testing.assert_allclose(place, mass / mass.sum(), atol=1e-6)
    peak = Peak(SHRINK * 20 + 2, SHRINK * 20 + 2, 1.0, 0.0, 60.0)
    own = project_grasp(peak, image.crop, NETWORK_SIDE, depth, CAMERA)
    found = grasp_uncertainty(refined, place, peak, own, 0.002)
    assert found.probability == pytest.approx(first.sum() / mass.sum(), abs=0.02)
    assert found.pose_sd[:2] == pytest.approx((0.002 * 4 * 2.0, 0.002 * 4 * 1.04), rel=0.1)
    across = grasp_uncertainty(refined, place, peak, own._replace(angle=0.5 * np.pi), 0.002)
    assert across.pose_sd[:2] == pytest.approx(found.pose_sd[1::-1], rel=1e-6)
    assert found.pose_sd[2] == pytest.approx(np.sqrt(2.0) * DEPTH_M)
    assert found.pose_sd[3:5] == pytest.approx(np.sqrt(3.0) * TILT_RAD)
