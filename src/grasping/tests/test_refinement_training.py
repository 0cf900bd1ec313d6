"""Training of the refinement network: labels, what turns with the image, losses, the constant offset."""

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
from grasping.lab.dataset.episode import EpisodeFrame
from grasping.lab.dataset.labels import pose_from_label
from grasping.lab.evaluation.operator_errors import (
    CONCENTRATIONS,
    Expected,
    Neighbours,
    errors,
    expected,
    log_likelihoods,
    miss,
    operators,
    with_constant_scale,
)
from grasping.lab.training.refinement_examples import (
    OperatorOffset,
    batch,
    constant_offset,
    example,
    offset_label,
    place_target,
)
from grasping.lab.training.refinement_trainer import RefinementLosses, RefinementTraining, losses, refinement_trainer
from grasping.network.depth_image import NETWORK_SIDE, Crop, prepare
from grasping.network.maps import Peak, Smoothing, highest, smoothed
from grasping.network.refinement import (
    CHANGES,
    CONCENTRATION,
    COS,
    HEIGHT,
    OPENING,
    SIDE,
    SIN,
    MapRefiner,
    RefinementNetwork,
)
from grasping.pipeline.projection import project_grasp
from grasping.pipeline.refined_grasp import angle_deviation, refined_grasp

CAMERA = pinhole("camera", 400, 400, [[570.0, 0.0, 199.5], [0.0, 570.0, 199.5], [0.0, 0.0, 1.0]])
CROP = Crop(0, 0, 400)
PEAK = Peak(150, 170, 0.9, 0.3, 60.0)
NO_OFFSET = OperatorOffset()
MAP_SIDE = 150
LOGS = np.linspace(-3.0, 4.0, 141)


def maps_of(peak: Peak) -> np.ndarray:
    """Returns maps whose best pixel is the peak, shape (4, 300, 300)."""
    row, column = np.indices((NETWORK_SIDE, NETWORK_SIDE))
    bell = peak.quality * np.exp(-((row - peak.row) ** 2 + (column - peak.column) ** 2) / (2.0 * 8.0**2))
    flat = np.ones_like(bell)
    return np.stack(
        [bell, np.cos(2.0 * peak.angle) * flat, np.sin(2.0 * peak.angle) * flat, peak.width / 150.0 * flat]
    ).astype(np.float32)


def frame_of(T_camera_grasp: np.ndarray, peak: Peak = PEAK) -> EpisodeFrame:
    """Returns a frame above a level table, 0.7 m away."""
    small = maps_of(peak).reshape(4, MAP_SIDE, 2, MAP_SIDE, 2).mean(axis=(2, 4))
    depth = np.full((400, 400), 700, np.uint16)
    return EpisodeFrame(CAMERA, CROP, depth, small.astype(np.float16), peak, np.eye(4), T_camera_grasp)


def grasp_at(x, y, z=0.7, angle=0.0, tilt=(0.0, 0.0)) -> np.ndarray:
    return pose(pin.exp3(np.array([*tilt, 0.0])) @ rotation_about(2, -angle), (x, y, z))


def own_pose(peak: Peak = PEAK) -> np.ndarray:
    return project_grasp(peak, CROP, NETWORK_SIDE, np.full((400, 400), 0.7), CAMERA).T_camera_grasp


@settings(max_examples=30)
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
    assert (one.column, one.row) == pytest.approx(((u + 0.5) * 0.1875 - 0.5, (v + 0.5) * 0.1875 - 0.5))
    assert one.height == pytest.approx(0.7 - z, abs=1e-6)
    np.testing.assert_allclose((one.tilt_x, one.tilt_y), tilt, atol=1e-6)
    assert np.exp(2j * one.angle) == pytest.approx(np.exp(2j * angle), abs=1e-6)
    assert np.isnan(one.opening)


def test_an_example_says_how_wide_the_hand_was_open():
    """A hand as wide as the network says of the pixel, at the distance of the table."""
    width_m = PEAK.width * 400 / 300 * 0.7 / 570.0
    one = example(frame_of(own_pose())._replace(opening=width_m), held=True)
    row, column = round(one.row), round(one.column)
    assert one.opening == pytest.approx(float(one.features[OPENING, row, column]), rel=2e-3)


def test_no_example_where_the_camera_cannot_see_the_grasp():
    assert example(frame_of(grasp_at(0.0, 0.0, -0.5)), held=True) is None
    blind = frame_of(grasp_at(0.0, 0.0))._replace(depth=np.zeros((400, 400), np.uint16))
    assert example(blind, held=True) is None


def _middle(bell: np.ndarray) -> tuple[float, float]:
    row, column = np.indices(bell.shape)
    return float((row * bell).sum() / bell.sum()), float((column * bell).sum() / bell.sum())


def test_the_constant_offset_is_taken_off_the_label():
    one = example(frame_of(grasp_at(0.02, -0.015, 0.7, 0.4, (0.1, -0.05))), held=True)
    _, target = batch([one], OperatorOffset(x=8.0 * one.mean, y=-12.0 * one.mean))
    assert _middle(target.place[0].numpy()) == pytest.approx((one.row + 3.0, one.column - 2.0), abs=0.01)
    offset = OperatorOffset(depth=0.01, angle=0.4, tilt_x=0.02, tilt_y=-0.01, opening=0.05)
    _, target = batch([one._replace(opening=0.3)], offset)
    assert float(target.height) == pytest.approx(one.height + 0.01)
    assert (float(target.cos), float(target.sin)) == pytest.approx((1.0, 0.0), abs=1e-6)
    assert (float(target.tilt_x), float(target.tilt_y)) == pytest.approx((0.08, -0.04), abs=1e-6)
    assert float(target.opening) == pytest.approx(0.25)


def test_the_constant_offset_is_found_and_undone():
    """An operator who always adds the same: GGCNN with the offset is exact, and so is the untrained network with it."""
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
    network = refinement_trainer(RefinementTraining(), offset).network
    image = prepare(frame.depth_m, CROP)
    refined = MapRefiner(network).apply(maps_of(frame.peak), image)
    peak = highest(smoothed(refined.output, image.valid, Smoothing(quality=2.0)))
    T = refined_grasp(project_grasp(peak, CROP, NETWORK_SIDE, frame.depth_m, CAMERA), refined, peak).T_camera_grasp
    np.testing.assert_allclose(T[:3, 3], frame.T_camera_grasp[:3, 3], atol=0.0012)  # half a pixel


def test_nobody_teaches_no_offset():
    assert constant_offset([]) == (0.0,) * 7


def test_a_miss_does_not_mind_which_finger_is_which():
    T = grasp_at(0.02, -0.01, 0.7, 0.4, (0.1, -0.05))
    found = T @ pose(rotation_about(2, np.pi) @ rotation_about(0, 0.2), (0.003, 0.0, 0.004))
    missed = miss(T, found)
    assert (missed.position, missed.rotation) == pytest.approx((0.005, 0.2), abs=1e-7)
    assert missed.is_near
    assert not miss(T, T @ pose(rotation_about(2, 0.3))).is_near
    assert not miss(T, T @ pose(p=(0.021, 0.0, 0.0))).is_near


def test_the_nearest_neighbour_of_a_known_frame_is_that_frame():
    """What the operator did there comes back, whichever of the frames it is."""
    frames = []
    for k, (row, column) in enumerate(((140, 120), (150, 170), (170, 160))):
        frame = frame_of(grasp_at(0.01 * k, -0.01, 0.69, 0.1 * k), PEAK._replace(row=row, column=column))
        frame.depth[180 : 200 + 10 * k, 190:230] = 650
        frames.append(frame)
    known = Neighbours(frames)
    for frame in frames:
        found = miss(frame.T_camera_grasp, known.grasp(frame))
        assert (found.position, found.rotation) == pytest.approx((0.0, 0.0), abs=1e-6)


OF = {name: i for i, name in enumerate(CHANGES)}
LOSS_OF = {
    "quality": "place",
    "depth": "depth",
    "depth_scale": "depth",
    "turn_cos": "turn",
    "turn_sin": "turn",
    "opening": "opening",
    "opening_scale": "opening",
    "tilt_x": "tilt",
    "tilt_y": "tilt",
    "follow": "tilt",
    "tilt_scale": "tilt",
}
"""Which loss each output of the network changes."""


def leaning_frame() -> EpisodeFrame:
    """A grasp with all that is to be learned, in front of a slope."""
    frame = frame_of(grasp_at(0.02, -0.015, 0.67, 0.5, (0.1, -0.05)))._replace(opening=0.08)
    slope = np.round(660.0 + 0.2 * np.arange(400)).astype(np.uint16)
    return frame._replace(depth=np.tile(slope, (400, 1)))


def right_change(seen, target):
    """Returns what makes quality and pose those of the label, but for the spreads."""
    said = torch.zeros(1, len(CHANGES), SIDE, SIDE)
    said[:, OF["quality"]] = target.place / target.place.max() - seen[:, 0]
    said[:, OF["depth"]] = seen[:, HEIGHT] - target.height
    said[:, OF["opening"]] = target.opening - seen[:, OPENING]
    said[:, OF["tilt_x"]], said[:, OF["tilt_y"]] = target.tilt_x, target.tilt_y
    c, s = seen[:, COS], seen[:, SIN]
    said[:, OF["turn_cos"]] = CONCENTRATION * (c * target.cos + s * target.sin - 1.0)
    said[:, OF["turn_sin"]] = CONCENTRATION * (c * target.sin - s * target.cos)
    return said


def turned(said, error, concentration=CONCENTRATION):
    """Returns what the network says with another line, twice the angle off by an error, and another concentration."""
    x, y = said[:, OF["turn_cos"]] + CONCENTRATION, said[:, OF["turn_sin"]]
    c, s = np.cos(error), np.sin(error)
    found = said.clone()
    found[:, OF["turn_cos"]] = concentration / CONCENTRATION * (c * x - s * y) - CONCENTRATION
    found[:, OF["turn_sin"]] = concentration / CONCENTRATION * (s * x + c * y)
    return found


@pytest.mark.parametrize("name", [n for n in CHANGES if not n.endswith("_scale") and n not in ("turn_cos", "follow")])
@settings(max_examples=5)
@given(st.floats(0.05, 0.5), st.booleans())
def test_losses_are_smallest_at_the_label(name, size, negative):
    seen, target = batch([example(leaning_frame(), held=True)], NO_OFFSET)
    right = right_change(seen, target)
    best, worse = losses(seen, right, target), right.clone()
    if name == "quality":
        worse[:, 0, 20:30, 20:30] += 0.7 + size  # a rival
    elif name == "turn_sin":
        worse = turned(right, -size if negative else size)
    else:
        worse[:, OF[name]] += (-size if negative else size) * CHANGES[name]
    found = losses(seen, worse, target)
    for part in RefinementLosses._fields[1:]:
        if part == LOSS_OF[name]:
            assert getattr(found, part) > getattr(best, part) + 1e-4
        else:
            assert getattr(found, part) == getattr(best, part)


@pytest.mark.parametrize("name", CHANGES)
def test_each_output_of_the_network_learns(name):
    """From its initial state on: the gradient reaches the weights of the last layer that make it."""
    seen, target = batch([example(leaning_frame(), held=True)], NO_OFFSET)
    network = RefinementNetwork()
    losses(seen, network(seen), target).total.backward()
    assert network.last.weight.grad[OF[name]].abs().max() > 1e-6
    assert network.last.bias.grad[OF[name]].abs() > 1e-6


@pytest.mark.parametrize(
    ("output", "wrong"), [("depth", "depth"), ("opening", "opening"), ("tilt", "tilt_x"), ("turn", "turn_sin")]
)
def test_who_errs_is_to_be_unsure(output, wrong):
    """The best spread is the larger the larger the errors are."""
    seen, target = batch([example(leaning_frame(), held=True)], NO_OFFSET)

    def best_spread(error):
        said = right_change(seen, target)
        if output == "turn":  # the vector's length is how sure it is
            found = [float(losses(seen, turned(said, error, k), target).turn) for k in CONCENTRATIONS]
            return 1.0 / CONCENTRATIONS[int(np.argmin(found))]
        said[:, OF[wrong]] += error * CHANGES[wrong]
        found = []
        for log in LOGS:
            said[:, OF[f"{output}_scale"]] = float(log)
            found.append(float(getattr(losses(seen, said, target), output)))
        return LOGS[int(np.argmin(found))]

    assert best_spread(0.1) < best_spread(0.4) < best_spread(1.0)


def test_an_opening_that_is_not_known_teaches_nothing():
    seen, target = batch([example(leaning_frame()._replace(opening=np.nan), held=True)], NO_OFFSET)
    said = torch.zeros(1, len(CHANGES), SIDE, SIDE, requires_grad=True)
    found = losses(seen, said, target)
    assert found.opening.item() == 0.0
    found.total.backward()
    assert torch.isfinite(said.grad).all()
    assert not said.grad[:, OF["opening"]].any()


def test_a_failed_grasp_teaches_only_not_to_grasp_there():
    one = example(frame_of(own_pose()), held=False)
    seen, target = batch([one], NO_OFFSET)
    said = torch.zeros(1, len(CHANGES), SIDE, SIDE, requires_grad=True)
    found = losses(seen, said, target)
    assert not any(v.item() for v in found[1:])
    found.total.backward()
    row, column = round(one.row), round(one.column)
    assert float(said.grad[0, 0, row, column]) > 0.0
    assert not said.grad[0, 1:].any()


@given(st.floats(5.0, SIDE - 6.0), st.floats(5.0, SIDE - 6.0))
def test_the_place_target_is_a_bell_of_sum_one(row, column):
    bell = place_target(row, column)
    assert bell.sum() <= 1.0 + 1e-5
    assert bell.sum() == pytest.approx(1.0, abs=1e-3)
    assert _middle(bell) == pytest.approx((row, column), abs=0.01)


def test_a_place_outside_the_image_has_no_target():
    assert place_target(-30.0, 37.0).sum() < 1e-6


def test_training_learns_what_the_person_prefers():
    """Two equal peaks; the operator takes the nearer surface, always 5 mm below it."""
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
        small = maps.reshape(4, MAP_SIDE, 2, MAP_SIDE, 2).mean(axis=(2, 4)).astype(np.float16)
        frame = frame_of(pose(np.eye(3), 0.665 * ray))._replace(
            depth=np.round(1000.0 * big).astype(np.uint16), maps=small
        )
        examples.append(example(frame, held=True))
    trainer = refinement_trainer(RefinementTraining(steps=40, count=4, rate=2e-2, hidden=8), constant_offset([]))
    before = trainer.validate(examples)
    for _ in range(40):
        trainer.train(examples)
    after = trainer.validate(examples)
    assert after["place"] < 0.7 * before["place"]
    assert after["depth"] < 0.7 * before["depth"]


def test_training_learns_an_orientation_that_depends_on_the_place():
    """On things 4 cm high the operator turns the line by 0.6 rad and leans by 0.3 rad; low things neither."""
    examples = []
    for high in (True, False):
        frame = frame_of(grasp_at(0.01, -0.02, 0.66 if high else 0.69, PEAK.angle + 0.6 * high, (0.3 * high, 0.0)))
        frame.depth[100:300, 100:300] = 660 if high else 690
        examples.append(example(frame, held=True))
    trainer = refinement_trainer(RefinementTraining(steps=600, count=2, rate=2e-2, hidden=8), NO_OFFSET)
    for _ in range(600):
        trainer.train(examples)
    for one, (turn, tilt) in zip(examples, ((0.6, 0.3), (0.0, 0.0))):
        seen, target = batch([one], NO_OFFSET)
        found = expected(seen, target, trainer.mean, NO_OFFSET)
        did = operators(target, NO_OFFSET)
        assert found.angle[0] - PEAK.angle == pytest.approx(turn, abs=0.1)
        assert found.tilt_x[0] == pytest.approx(tilt, abs=0.05)
        assert np.degrees(errors(found, did)[0]) < 6.0
        assert angle_deviation(found.concentration[0]) < angle_deviation(CONCENTRATION)


def test_training_goes_on_where_it_was_left():
    examples = [example(frame_of(own_pose()), held=True)]
    whole, first = (
        refinement_trainer(RefinementTraining(steps=4, count=1, hidden=2), constant_offset([])) for _ in range(2)
    )
    for _ in range(4):
        whole.train(examples)
    for _ in range(2):
        first.train(examples)
    second = refinement_trainer(RefinementTraining(steps=4, count=1, hidden=2), constant_offset([]))
    second.resume(first.state())
    for _ in range(2):
        second.train(examples)
    for a, b in zip(whole.mean.parameters(), second.mean.parameters()):
        torch.testing.assert_close(a, b, rtol=0.0, atol=0.0)


def drawn(n: int, concentration: float, scale: float, seed: int = 0) -> tuple[Expected, Expected]:
    """Returns n expected orientations, and as many operators' about them."""
    rng = np.random.default_rng(seed)
    nothing, flat = np.zeros(n), np.ones(n)
    found = Expected(rng.uniform(-3.0, 3.0, n), nothing, nothing, nothing, concentration * flat, scale * flat)
    angle = found.angle + 0.5 * rng.vonmises(0.0, concentration, n) + np.pi * rng.integers(0, 2, n)
    far, where = rng.gamma(2.0, scale, n), rng.uniform(0.0, 2.0 * np.pi, n)
    return found, Expected(angle, far * np.cos(where), far * np.sin(where), nothing, nothing, nothing)


def test_the_constant_spread_that_suits_best_is_the_true_one():
    found, did = drawn(20_000, 10.0, 0.1)
    fitted = with_constant_scale(found, found, did)
    assert fitted.concentration[0] == pytest.approx(10.0, rel=0.1)
    assert fitted.tilt_scale[0] == pytest.approx(0.1, rel=0.03)
    best = log_likelihoods(found, did).mean()
    for wrong in ({"concentration": 5.0}, {"concentration": 20.0}, {"tilt_scale": 0.07}, {"tilt_scale": 0.15}):
        other = found._replace(**{name: np.full(20_000, value) for name, value in wrong.items()})
        assert log_likelihoods(other, did).mean() < best - 0.03


def test_the_density_of_an_orientation_has_the_integral_one():
    angle, x, y = np.meshgrid(np.arange(60) * np.pi / 60, *[np.linspace(-1.5, 1.5, 121)] * 2, indexing="ij")
    nothing = np.zeros(angle.size)
    did = Expected(angle.ravel(), x.ravel(), y.ravel(), nothing, nothing, nothing)
    found = Expected(nothing + 0.7, nothing, nothing, nothing, nothing + 3.0, nothing + 0.1)
    assert np.exp(log_likelihoods(found, did)).sum() * np.pi / 60 * 0.025**2 == pytest.approx(1.0, abs=0.02)


def test_an_orientation_does_not_mind_which_finger_is_which():
    found, did = drawn(50, 10.0, 0.1)
    turned = did._replace(angle=did.angle + np.pi)
    np.testing.assert_allclose(errors(found, did), errors(found, turned), atol=1e-6)
    np.testing.assert_allclose(log_likelihoods(found, did), log_likelihoods(found, turned), atol=1e-6)
