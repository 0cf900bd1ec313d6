"""Training of the second network: labels, what turns with the picture, losses, the constant offset."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from common.camera_model import pinhole
from common.poses import pose
from common.rotations import rotation_about
from grasping.dataset.episode import Frame
from grasping.dataset.labels import pose_from_label
from grasping.depth_image import NETWORK_SIDE, Crop, prepare
from grasping.evaluation.person_errors import Neighbours, miss
from grasping.maps import Peak, Smoothing, highest, smoothed
from grasping.projection import grasp
from grasping.refinement import INPUT_TURN, OUTPUT_TURN, Refinement, RefinementNetwork, refined_grasp
from grasping.training.refinement_batches import batch, moved_maps, place_target, random_batch
from grasping.training.refinement_examples import SIDE, Scene, constant_offset, example, offset_label
from grasping.training.refinement_losses import losses
from grasping.training.refinement_trainer import Settings, Trainer

CAMERA = pinhole("camera", 400, 400, [[570.0, 0.0, 199.5], [0.0, 570.0, 199.5], [0.0, 0.0, 1.0]])
CROP = Crop(0, 0, 400)
PEAK = Peak(150, 170, 0.9, 0.3, 60.0)
NO_OFFSET = np.zeros(4)


def maps_of(peak: Peak) -> np.ndarray:
    """Returns maps whose best pixel is the peak, shape (4, 300, 300)."""
    row, column = np.indices((NETWORK_SIDE, NETWORK_SIDE))
    bell = peak.quality * np.exp(-((row - peak.row) ** 2 + (column - peak.column) ** 2) / (2.0 * 8.0**2))
    flat = np.ones_like(bell)
    return np.stack(
        [bell, np.cos(2.0 * peak.angle) * flat, np.sin(2.0 * peak.angle) * flat, peak.width / 150.0 * flat]
    ).astype(np.float32)


def frame_of(T_camera_grasp: np.ndarray, peak: Peak = PEAK) -> Frame:
    """Returns a frame above a level table, 0.7 m away."""
    small = maps_of(peak).reshape(4, SIDE, 2, SIDE, 2).mean(axis=(2, 4))
    depth = np.full((400, 400), 700, np.uint16)
    return Frame(CAMERA, CROP, depth, small.astype(np.float16), peak, np.eye(4), T_camera_grasp)


def grasp_at(x, y, z=0.7, angle=0.0, tilt=(0.0, 0.0)) -> np.ndarray:
    return pose(pin.exp3(np.array([*tilt, 0.0])) @ rotation_about(2, -angle), (x, y, z))


def own_pose(peak: Peak = PEAK) -> np.ndarray:
    return grasp(peak, CROP, NETWORK_SIDE, np.full((400, 400), 0.7), CAMERA).T_camera_grasp


@settings(max_examples=30, deadline=None)
@given(
    st.floats(-0.1, 0.1),
    st.floats(-0.1, 0.1),
    st.floats(0.5, 0.9),
    st.floats(-1.5, 1.5),
    st.tuples(*[st.floats(-0.3, 0.3)] * 2),
)
def test_an_example_says_where_the_person_grasped(x, y, z, angle, tilt):
    one = example(frame_of(grasp_at(x, y, z, angle, tilt)), held=True)
    u, v = CAMERA.project(np.array([x, y, z]))
    assert (one.column, one.row) == pytest.approx(((u + 0.5) * 0.375 - 0.5, (v + 0.5) * 0.375 - 0.5))
    assert one.height == pytest.approx(0.7 - z, abs=1e-6)
    assert np.cos(2.0 * (one.angle - angle)) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(one.tilt, tilt, atol=1e-9)


def test_no_example_where_the_camera_cannot_see_the_grasp():
    assert example(frame_of(grasp_at(0.0, 0.0, -0.5)), held=True) is None
    blind = frame_of(grasp_at(0.0, 0.0))._replace(depth=np.zeros((400, 400), np.uint16))
    assert example(blind, held=True) is None


@settings(max_examples=25, deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(-8.0, 8.0), st.floats(-8.0, 8.0))
def test_a_turned_example_is_the_example_of_the_turned_scene(turn, right, down):
    """The camera's picture turned anticlockwise is what a camera turned clockwise sees of the same scene."""
    peak = Peak(150, 165, 0.9, 0.3, 60.0)
    one = example(frame_of(grasp_at(0.02, -0.015, 0.69, 0.4, (0.1, -0.05)), peak), held=True)
    maps, target = _one(one, turn, (right, down))
    R = rotation_about(2, -turn)
    T = np.eye(4)
    T[:3, :3] = R
    turned = example(frame_of(T @ grasp_at(0.02, -0.015, 0.69, 0.4, (0.1, -0.05)), peak), held=True)
    assert _middle(target.place[0].numpy()) == pytest.approx((turned.row + down, turned.column + right), abs=0.05)
    assert np.cos(2.0 * (float(target.angle[0]) - turned.angle)) == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(target.tilt[0], turned.tilt, atol=1e-6)
    assert float(target.height[0]) == pytest.approx(one.height)
    # GGCNN's peak turns as the grasp does.
    x, y, _ = R @ np.array([peak.column - 149.5, peak.row - 149.5, 0.0])
    best = np.unravel_index(int(maps[0, 0].argmax()), (SIDE, SIDE))
    assert best == pytest.approx(((y + 149.5 - 0.5) / 2 + down, (x + 149.5 - 0.5) / 2 + right), abs=1.1)
    angle = 0.5 * np.arctan2(maps[0, 2, 75, 75], maps[0, 1, 75, 75])
    assert np.cos(2.0 * (angle - peak.angle - turn)) == pytest.approx(1.0, abs=1e-3)


def _one(one, turn, shift):
    """Returns one example turned and shifted as a random batch would."""

    class Chance:
        """Hands out what the batch is to draw."""

        def __init__(self):
            self.values = iter([turn, np.array(shift)])

        def random(self):
            return 1.0

        def integers(self, _):
            return 0

        def uniform(self, *_):
            return next(self.values)

    return random_batch([one], [], NO_OFFSET, Chance(), 1)


def _middle(bell: np.ndarray) -> tuple[float, float]:
    row, column = np.indices(bell.shape)
    return float((row * bell).sum() / bell.sum()), float((column * bell).sum() / bell.sum())


def test_the_network_turns_maps_and_tilts_as_the_training_does():
    one = example(frame_of(grasp_at(0.02, -0.015, 0.69, 0.4, (0.1, -0.05))), held=True)
    maps, target = _one(one, 0.5 * np.pi, (0.0, 0.0))
    turned = INPUT_TURN @ torch.rot90(torch.from_numpy(one.maps.astype(np.float32)), 1, (1, 2)).flatten(1)
    torch.testing.assert_close(maps[0].flatten(1), turned, rtol=0.0, atol=1e-3)
    np.testing.assert_allclose(target.tilt[0], OUTPUT_TURN[5:, 5:].numpy() @ one.tilt, atol=1e-6)


def test_the_constant_offset_is_taken_off_the_label():
    one = example(frame_of(grasp_at(0.02, -0.015, 0.7, 0.4, (0.1, -0.05))), held=True)
    _, target = batch([one], np.array([4.0 * one.mean, -6.0 * one.mean, 0.03, 0.01]))
    assert _middle(target.place[0].numpy()) == pytest.approx((one.row + 3.0, one.column - 2.0), abs=0.01)
    np.testing.assert_allclose(target.tilt[0], one.tilt - (0.03, 0.01), atol=1e-6)


def test_unmoved_maps_come_back():
    maps = np.random.default_rng(0).standard_normal((5, SIDE, SIDE)).astype(np.float16)
    found, forward = moved_maps(maps, 0.0, (0.0, 0.0))
    np.testing.assert_array_equal(found, maps.astype(np.float32))
    np.testing.assert_allclose(forward, [[1, 0, 0], [0, 1, 0]], atol=1e-12)


def test_the_constant_offset_is_found_and_undone():
    """A person who always adds the same: GGCNN with the offset is exact, and so is the untrained network with it."""
    frames = []
    for row, column in ((140, 120), (150, 170), (170, 160), (120, 150)):
        peak = PEAK._replace(row=row, column=column)
        T = own_pose(peak)
        # Beside it by 8 and -6 mm.
        frames.append(frame_of(grasp_at(*(T[:2, 3] + (0.008, -0.006)), 0.7, peak.angle + 0.1, (0.03, 0.05)), peak))
    frames.append(frame_of(grasp_at(-0.1, 0.1)))  # another thing was meant
    offset = constant_offset(frames)
    focal = 570.0 * 0.75
    assert (offset.x, offset.y) == pytest.approx((0.008 * focal, -0.006 * focal), rel=1e-6)
    assert (offset.depth, offset.angle) == pytest.approx((0.0, 0.1), abs=1e-6)
    frame = frames[1]
    found = pose_from_label(frame, offset_label(frame, offset))
    np.testing.assert_allclose(found[:3, 3], frame.T_camera_grasp[:3, 3], atol=1e-6)
    np.testing.assert_allclose(found[:3, 2], frame.T_camera_grasp[:3, 2], atol=0.03)
    network = Trainer(Settings(), offset).network
    picture = prepare(frame.depth_m, CROP)
    refined = Refinement(network).apply(maps_of(frame.peak), picture)
    peak = highest(smoothed(refined.output, picture.valid, Smoothing(quality=2.0)))
    T = refined_grasp(grasp(peak, CROP, NETWORK_SIDE, frame.depth_m, CAMERA), refined, peak).T_camera_grasp
    np.testing.assert_allclose(T[:3, 3], frame.T_camera_grasp[:3, 3], atol=0.0012)  # half a pixel


def test_nobody_teaches_no_offset():
    assert constant_offset([]) == (0.0,) * 6


def test_a_miss_does_not_mind_which_finger_is_which():
    T = grasp_at(0.02, -0.01, 0.7, 0.4, (0.1, -0.05))
    found = T @ pose(rotation_about(2, np.pi) @ rotation_about(0, 0.2), (0.003, 0.0, 0.004))
    missed = miss(T, found)
    assert (missed.position, missed.rotation) == pytest.approx((0.005, 0.2), abs=1e-7)
    assert missed.is_near
    assert not miss(T, T @ pose(rotation_about(2, 0.3))).is_near
    assert not miss(T, T @ pose(p=(0.021, 0.0, 0.0))).is_near


def test_the_nearest_neighbour_of_a_known_frame_is_that_frame():
    """What the person did there comes back, whichever of the frames it is."""
    frames = []
    for k, (row, column) in enumerate(((140, 120), (150, 170), (170, 160))):
        frame = frame_of(grasp_at(0.01 * k, -0.01, 0.69, 0.1 * k), PEAK._replace(row=row, column=column))
        frame.depth[180 : 200 + 10 * k, 190:230] = 650
        frames.append(frame)
    known = Neighbours(frames)
    for frame in frames:
        found = miss(frame.T_camera_grasp, known.grasp(frame))
        assert (found.position, found.rotation) == pytest.approx((0.0, 0.0), abs=1e-6)


def right_change(maps, target):
    """Returns changes that say what the targets say."""
    change = torch.zeros(len(maps), 7, SIDE, SIDE)
    # The softmax of 20 times the quality is to be the bell.
    change[:, 0] = torch.log(target.place.clamp(min=1e-9)) / 20.0 - maps[:, 0]
    change[:, 1] = torch.cos(2.0 * target.angle)[:, None, None] - maps[:, 1]
    change[:, 2] = torch.sin(2.0 * target.angle)[:, None, None] - maps[:, 2]
    change[:, 4] = maps[:, 4] - target.height[:, None, None]
    change[:, 5:] = target.tilt[:, :, None, None]
    return change


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 6), st.floats(0.05, 0.5), st.booleans())
def test_losses_are_smallest_at_the_label(channel, size, negative):
    maps, target = batch([example(frame_of(grasp_at(0.02, 0.01, 0.69, 0.5, (0.1, 0.0))), held=True)], NO_OFFSET)
    change = right_change(maps, target)
    best = losses(maps, change, target)
    for part in (best.place, best.angle, best.depth, best.tilt):
        assert float(part) == pytest.approx(0.0, abs=2e-3)
    worse = change.clone()
    step = size * (-1.0 if negative else 1.0)
    if channel == 0:
        worse[:, 0] += step * torch.linspace(0.0, 1.0, SIDE)  # softmax does not mind a constant
    else:
        worse[:, channel] += step
    found = losses(maps, worse, target)
    if channel == 3:
        assert found[1:] == best[1:]  # episodes say nothing about the opening
    else:
        assert sum(map(float, found[1:])) > sum(map(float, best[1:])) + 1e-5


def test_a_failed_grasp_teaches_only_not_to_grasp_there():
    one = example(frame_of(own_pose()), held=False)
    maps, target = batch([one], NO_OFFSET)
    change = torch.zeros(1, 7, SIDE, SIDE, requires_grad=True)
    found = losses(maps, change, target)
    assert not any(v.item() for v in found[1:])
    found.total.backward()
    row, column = round(one.row), round(one.column)
    assert float(change.grad[0, 0, row, column]) > 0.0
    assert not change.grad[0, 4:].any()


def test_a_synthetic_scene_teaches_where_things_can_be_grasped_and_how_wide():
    quality, angle, width = np.zeros((3, SIDE, SIDE), np.float32)
    quality[60:70, 80:90], angle[:], width[:] = 0.8, 0.7, 0.4
    one = Scene(frame_maps(), quality, angle, width)
    maps, target = _one_scene(one)
    right = torch.zeros(1, 7, SIDE, SIDE)
    right[:, 0] = torch.from_numpy(quality) - maps[:, 0]
    right[:, 1], right[:, 2] = np.cos(1.4) - maps[:, 1], np.sin(1.4) - maps[:, 2]
    right[:, 3] = 0.4 - maps[:, 3]
    best = float(losses(maps, right, target).scene)
    assert best < 0.02
    for channel, change in ((0, -0.8 * torch.from_numpy(quality)), (1, -0.5), (3, 0.1)):
        worse = right.clone()
        worse[:, channel] += change
        assert float(losses(maps, worse, target).scene) > best + 0.01


def frame_maps():
    return example(frame_of(own_pose()), held=True).maps


def _one_scene(one):
    class Chance:
        """Chooses the scene, unmoved."""

        def random(self):
            return 0.0

        def integers(self, _):
            return 0

        def uniform(self, *_):
            return np.zeros(2) if _ == (-10.0, 10.0, 2) else 0.0

    return random_batch([], [one], NO_OFFSET, Chance(), 1)


@given(st.floats(5.0, 144.0), st.floats(5.0, 144.0))
def test_the_place_target_is_a_bell_of_sum_one(row, column):
    bell = place_target(row, column)
    assert bell.sum() <= 1.0 + 1e-5
    if 10.0 < row < 139.0 and 10.0 < column < 139.0:
        assert bell.sum() == pytest.approx(1.0, abs=1e-3)
        assert _middle(bell) == pytest.approx((row, column), abs=0.01)


def test_a_place_outside_the_picture_has_no_target():
    assert place_target(-60.0, 75.0).sum() < 1e-6


def test_training_learns_what_the_person_prefers():
    """Two equal peaks; the person takes the nearer surface, always 5 mm below it."""
    rng = np.random.default_rng(0)
    examples = []
    for _ in range(12):
        rows, columns = rng.integers(60, 240, 2), np.array([90, 210])
        maps = sum(maps_of(Peak(int(r), int(c), 0.6, 0.0, 60.0)) for r, c in zip(rows, columns))
        maps[1:] *= 0.5
        depth = np.full((NETWORK_SIDE, NETWORK_SIDE), 0.7, np.float32)
        near = int(rng.integers(2))
        depth[rows[near] - 15 : rows[near] + 15, columns[near] - 15 : columns[near] + 15] = 0.66
        depth[rows[1 - near] - 15 : rows[1 - near] + 15, columns[1 - near] - 15 : columns[1 - near] + 15] = 0.68
        big = np.kron(depth, np.ones((4, 4)))[1::3, 1::3]
        ray = CAMERA.rays(((columns[near] + 0.5) * 4 / 3 - 0.5, (rows[near] + 0.5) * 4 / 3 - 0.5))
        small = maps.reshape(4, SIDE, 2, SIDE, 2).mean(axis=(2, 4)).astype(np.float16)
        frame = frame_of(pose(np.eye(3), 0.665 * ray))._replace(
            depth=np.round(1000.0 * big).astype(np.uint16), maps=small
        )
        examples.append(example(frame, held=True))
    trainer = Trainer(Settings(steps=30, count=2, rate=2e-2, features=3), constant_offset([]))
    before = trainer.validate(examples)
    for _ in range(30):
        trainer.train(examples, [])
    after = trainer.validate(examples)
    assert after["place"] < 0.7 * before["place"]
    assert after["depth"] < 0.7 * before["depth"]


def test_training_goes_on_where_it_was_left():
    examples = [example(frame_of(own_pose()), held=True)]
    whole, first = (Trainer(Settings(steps=4, count=1, features=2), constant_offset([])) for _ in range(2))
    for _ in range(4):
        whole.train(examples, [])
    for _ in range(2):
        first.train(examples, [])
    second = Trainer(Settings(steps=4, count=1, features=2), constant_offset([]))
    second.resume(first.state())
    for _ in range(2):
        second.train(examples, [])
    for a, b in zip(whole.mean.parameters(), second.mean.parameters()):
        torch.testing.assert_close(a, b, rtol=0.0, atol=0.0)


def test_untrained_changes_are_no_change():
    network = RefinementNetwork()
    with torch.no_grad():
        assert not network(torch.randn(1, 5, SIDE, SIDE)).any()
