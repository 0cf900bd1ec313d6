"""Hypotheses in six degrees of freedom, what the depth shows around each, and the network that judges them."""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from common.camera_model import CameraModel, pinhole
from common.errors import RigError
from common.lift_trial import LIFTED, NO_GRASP
from common.poses import pose
from common.rotations import rotation_about
from grasping.lab.evaluation import antipodal, lift_file, trials
from grasping.lab.evaluation.antipodal import antipodal_grasp
from grasping.lab.programs import evaluate_poses, make_attempts, train_lifts
from grasping.lab.programs.train_lifts import LiftData, calibrate, train
from grasping.lab.synthetic import attempts, scene
from grasping.lab.synthetic.full_poses import PoseSampler
from grasping.lab.synthetic.pose_labels import REASONS
from grasping.lab.synthetic.shapes import Geom
from grasping.network.depth_image import CROP_SIDE, Crop, NetworkImage
from grasping.network.maps import PARALLEL, REFLEX, Maps
from grasping.poses import chooser, hand_view, hypotheses
from grasping.poses.candidates import image_rays, level_frame
from grasping.poses.chooser import JUDGED, SAFE, TILT_COST, ImageMaps, choose, tilts
from grasping.poses.gripper import GRIPPER, GRIPPERS, Gripper
from grasping.poses.hypotheses import ABOVE_RAD, MAX_TILT_RAD, PLACES, TURNS, Hypotheses, Turn
from grasping.poses.lift_network import LiftNetwork, lift_logits, loaded, saved

SIDE, TABLE_M, FOCAL = 300, 0.7, 570.0
OPEN_M = 0.1
WEIGHTS = Path(__file__).parents[1] / "weights" / "ggcnn2_wide.pt"
DOWN = np.array([0.0, 0.0, 1.0])
LYING = np.array([0.0, 0.0, 0.02, 1.0, 0.0, 0.0, 0.0])


def camera() -> CameraModel:
    centre = 0.5 * (CROP_SIDE - 1)
    K = np.array([[FOCAL, 0.0, centre], [0.0, FOCAL, centre], [0.0, 0.0, 1.0]])
    return pinhole("test", CROP_SIDE, CROP_SIDE, K)


def bar_image(height: float = 0.04, turned: float = 0.0, tilt: float = 0.0, beside: bool = False) -> ImageMaps:
    """A bar, 30 mm wide and 100 mm long, on a table straight below; GGCNN sees it so. `turned`: anticlockwise from the
    image's columns; `tilt`: of the camera about its x axis; `beside`: a block stands on one side of one end."""
    rows, columns = np.indices((SIDE, SIDE)) - 0.5 * (SIDE - 1)
    rays = np.stack([columns, rows, np.full(rows.shape, FOCAL * SIDE / CROP_SIDE)], axis=-1) * CROP_SIDE / SIDE / FOCAL
    down = np.array([0.0, -np.sin(tilt), np.cos(tilt)])
    depth = TABLE_M / (rays @ down)
    top = (TABLE_M - height) / (rays @ down)
    scale = (TABLE_M - height) * CROP_SIDE / SIDE / FOCAL
    c, s = np.cos(turned), np.sin(turned)
    across, along = (c * columns - s * rows) * scale, (s * columns + c * rows) * scale
    bar = (np.abs(along) < 0.05) & (np.abs(across) < 0.015)
    block = (np.abs(along - 0.035) < 0.01) & (np.abs(across - 0.05) < 0.01) & beside
    depth = np.where(bar | block, top, depth)
    image = NetworkImage(
        Crop(0, 0, CROP_SIDE), depth - depth.mean(), depth, np.ones(depth.shape, bool), float(depth.mean())
    )
    quality = np.where(bar, 0.8 - np.abs(along) - np.abs(across), 0.0)
    width, angle = np.full(depth.shape, 0.04 / scale), np.full(depth.shape, turned)
    return ImageMaps(image, camera(), Maps(quality, angle, width), np.ones(depth.shape))


def of_turns(of: ImageMaps, *turns: Turn) -> Hypotheses:
    return hypotheses.hypotheses(of.maps, of.certainty, of.image, of.camera, of.frame, OPEN_M, turns)


def seen(of: ImageMaps, tried: Hypotheses, gripper: Gripper = GRIPPER) -> np.ndarray:
    return hand_view.features(tried, of.image, of.camera, of.frame, gripper)


def near_fingers(values: np.ndarray) -> np.ndarray:
    """Returns the part of features at the fingers: across, along, down."""
    cut = hand_view.FEATURES - hand_view.SCALARS - len(hand_view.AROUND_M) ** 2
    return values[:, :cut].reshape(len(values), -1, len(hand_view.ALONG), len(hand_view.DOWN_M))


@pytest.mark.parametrize("seed", range(5))
def test_orientations_are_rotations_with_the_tilt_that_was_asked(seed):
    azimuth, pitch, roll = np.random.default_rng(seed).uniform(-0.7, 0.7, (3, 20))
    R = hypotheses.level_rotation(azimuth, pitch, roll)
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (20, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    np.testing.assert_allclose(R[:, 2, 2], np.cos(pitch) * np.cos(roll), atol=1e-12)
    np.testing.assert_allclose(R[:, 2, 0], -np.sin(roll), atol=1e-12)


def test_without_a_turn_a_hypothesis_is_ggcnns_grasp_from_straight_above():
    of = bar_image()
    found = of_turns(of, Turn())
    assert 10 < len(found.T) <= PLACES
    np.testing.assert_allclose(found.T[:, :3, :3], np.tile(np.eye(3), (len(found.T), 1, 1)), atol=1e-3)
    np.testing.assert_allclose(found.opening, 0.04, atol=1e-3)
    assert (np.diff(found.seen[:, 0]) <= 1e-6).all(), "the best quality first"
    np.testing.assert_allclose(found.seen[:, 1:], [[1.0, 0.0]] * len(found.T), atol=1e-3)
    np.testing.assert_allclose(found.T[0, :3, 3], (0.0, 0.0, 0.66), atol=0.002)


def test_a_quarter_turn_goes_along_the_bar_and_ggcnn_disagrees():
    of = bar_image()
    found = of_turns(of, Turn(line=0.5 * np.pi))
    assert np.abs(found.T[:, 1, 0]).min() > 0.999
    np.testing.assert_allclose(found.seen[:, 1], -1.0, atol=1e-3)


def test_where_ggcnn_sees_nothing_objects_are_still_tried():
    of = bar_image()
    blind = dataclasses.replace(of, maps=of.maps._replace(quality=np.zeros((SIDE, SIDE))))
    found = of_turns(blind, Turn())
    assert len(found.T) > 10
    assert np.abs(found.T[:, 0, 3]).max() < 0.02, "on the bar"


def test_fingers_beside_a_bar_are_free_and_the_bar_is_between_them():
    of = bar_image()
    best = of_turns(of, Turn()).part(np.array([0]))
    around = near_fingers(seen(of, best))[0]
    beside, middle = len(hand_view.BESIDE), around.shape[0] // 2
    above_table = slice(0, 6)
    assert (around[:beside, :, above_table] < 0.0).all() and (around[-beside:, :, above_table] < 0.0).all()
    assert (around[middle, :, -4:] > 0.0).all(), "its inside is behind its top"
    narrow = best._replace(opening=np.array([0.02]))
    blocked = near_fingers(seen(of, narrow))[0]
    assert blocked[beside - 1, 2, -3] > 0.0 and blocked[-beside, 2, -3] > 0.0, "fingers would come down on the bar"


def test_thicker_broader_and_longer_fingers_look_further():
    of = bar_image(beside=True)
    best = of_turns(of, Turn()).part(np.array([0]))
    beside = slice(len(hand_view.BESIDE), -len(hand_view.BESIDE))
    usual = near_fingers(seen(of, best))[0]
    thick, broad, deep = (
        near_fingers(seen(of, best, dataclasses.replace(GRIPPER, **more)))[0]
        for more in ({"thickness": 0.05, "breadth": 0.08}, {"breadth": 0.08}, {"reach": 0.03})
    )
    np.testing.assert_array_equal(thick[beside], broad[beside])
    assert (thick > broad + 0.1).any(), "the block"
    middle = len(hand_view.ALONG) // 2
    np.testing.assert_array_equal(broad[:, middle], usual[:, middle])
    assert (np.abs(broad - usual) > 0.1).any(), "the bar's ends or the block"
    assert (deep >= usual - 1e-6).all() and (deep > usual + 0.1).any()


def test_a_hand_that_never_opens_less_sees_so():
    of = bar_image()
    best = of_turns(of, Turn()).part(np.array([0]))
    narrow, wide = (best._replace(opening=np.array([opening])) for opening in (0.02, 0.06))
    half_closed = dataclasses.replace(GRIPPER, least=0.06)
    same, differing = (
        [near_fingers(seen(of, one, gripper)) for one in (narrow, wide)] for gripper in (half_closed, GRIPPER)
    )
    np.testing.assert_array_equal(*same)
    assert not np.array_equal(*differing)


def test_a_hand_turned_by_half_a_turn_sees_both_sides_exchanged():
    of = bar_image()
    tried = of_turns(of, *TURNS)
    half = np.eye(4)
    half[:3, :3] = rotation_about(2, np.pi)
    turned = tried._replace(T=tried.T @ half)
    # Pixels are not symmetric about the image's middle: a few points fall on the other side of an edge.
    expected, found = hand_view.mirrored(seen(of, tried), True, True), seen(of, turned)
    assert (np.abs(expected - found) < 1e-4).mean() > 0.999
    np.testing.assert_allclose(expected[:, -10:], found[:, -10:], atol=1e-5)


@pytest.mark.parametrize("across", (False, True))
def test_in_the_mirror_a_hand_sees_what_its_mirror_image_sees(across):
    """The image is mirrored left and right or up and down, and so are the places, tilts and lines of the hands."""
    of = bar_image(turned=0.4, beside=True)
    flip = np.diag([-1.0, 1.0, 1.0, 1.0] if across else [1.0, -1.0, 1.0, 1.0])
    own = np.diag([-1.0, 1.0, 1.0, 1.0]) if across else np.diag([1.0, -1.0, 1.0, 1.0])
    tried = of_turns(of, *(turn._replace(line=-0.4 + turn.line) for turn in TURNS[:1] + TURNS[4:]))
    depth = of.image.depth[:, ::-1] if across else of.image.depth[::-1]
    mirror = dataclasses.replace(of, image=of.image._replace(depth=np.ascontiguousarray(depth)))
    seen_there = seen(mirror, tried._replace(T=flip @ tried.T @ own))
    expected = hand_view.mirrored(seen(of, tried), across, not across)
    assert (np.abs(expected - seen_there) < 1e-4).mean() > 0.99
    np.testing.assert_allclose(expected[:, -10:], seen_there[:, -10:], atol=1e-5)
    other = hand_view.mirrored(seen(of, tried), not across, across)
    assert (np.abs(other - seen_there) < 1e-4).mean() < 0.95, "the scene is not alike on both sides"


def test_before_a_tilted_camera_a_bar_that_lies_askew_is_grasped_across_it():
    of = bar_image(turned=0.4, tilt=0.1)
    frame = of.frame
    np.testing.assert_allclose(frame.R[:, 2], (0.0, -np.sin(0.1), np.cos(0.1)), atol=2e-3)
    found = of_turns(of, Turn(), Turn(roll=0.3))
    straight = found.T[::2]
    np.testing.assert_allclose(straight[:, :3, 2], np.tile(frame.R[:, 2], (len(straight), 1)), atol=1e-6)
    line = np.arctan2(-straight[:, 1, 0], straight[:, 0, 0])
    np.testing.assert_allclose(line, 0.4, atol=0.02)
    np.testing.assert_allclose(found.seen[::2, 1], 1.0, atol=0.01), "GGCNN's line is the same"
    np.testing.assert_allclose(found.T[1::2, :3, 0] @ frame.R[:, 2], -np.sin(0.3), atol=1e-6)
    scalars = seen(of, found)[:, -10:]
    np.testing.assert_allclose(scalars[::2, 3:6], [[0.0, 0.0, 1.0]] * len(straight), atol=1e-5)
    np.testing.assert_allclose(scalars[1::2, 3:6], [[-np.sin(0.3), 0.0, np.cos(0.3)]] * len(straight), atol=1e-5)


def test_at_the_fingers_each_point_is_compared_with_the_pixel_that_it_falls_on():
    of = bar_image(tilt=0.2, turned=0.3, beside=True)
    tried = of_turns(of, *TURNS)
    T, step = tried.T, 0.5 * np.array(hand_view.BETWEEN)
    along, down = GRIPPER.breadth * np.array(hand_view.ALONG), GRIPPER.reach + np.array(hand_view.DOWN_M)
    local = np.stack(
        np.broadcast_arrays(
            (tried.opening[:, None] * step)[:, :, None, None], along[None, None, :, None], down[None, None, None, :]
        ),
        axis=-1,
    )
    points = np.einsum("nij,nabcj->nabci", T[:, :3, :3], local) + T[:, None, None, None, :3, 3]
    rows, columns, _ = hypotheses.pixels_of(points, of.image, of.camera)
    behind = np.clip((points[..., 2] - of.image.depth[rows, columns]) / hand_view.NEAR_M, -1.0, 1.0)
    beside = len(hand_view.BESIDE)
    found = near_fingers(seen(of, tried))[:, beside:-beside].reshape(behind.shape)
    above = of.frame.distance - (points @ of.frame.R[:, 2]).max(axis=(1, 2, 3)) > GRIPPER.ground
    assert above.sum() > 100
    # At the edge of a pixel rounding decides.
    assert (np.abs(found - behind)[above] > 1e-3).mean() < 1e-3


def test_features_are_finite_and_bounded_even_outside_the_image():
    of = bar_image()
    tried = of_turns(of, *TURNS)
    far = tried._replace(T=tried.T + np.array([[0, 0, 0, 0.5], [0, 0, 0, -0.5], [0, 0, 0, -0.6], [0, 0, 0, 0]]))
    values = seen(of, far)
    assert values.shape == (len(far.T), hand_view.FEATURES) and values.dtype == np.float32
    assert np.isfinite(values).all() and np.abs(values).max() <= hand_view.LARGEST


def test_poses_near_others_stay_near_and_are_rotations():
    of = bar_image()
    best = of_turns(of, Turn()).part(np.arange(4))
    T, opening = hypotheses.varied(best, 5, np.random.default_rng(0), OPEN_M, of.frame, 0.1)
    assert tilts(Hypotheses(T, opening, best.seen), of.frame).max() <= 0.1 + 1e-6
    assert T.shape == (20, 4, 4)
    np.testing.assert_allclose(
        T[:, :3, :3] @ T[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (20, 1, 1)), atol=1e-9
    )
    assert np.linalg.norm(T[:, :3, 3] - np.repeat(best.T[:, :3, 3], 5, axis=0), axis=1).max() < 0.03
    assert (opening <= OPEN_M).all() and (opening >= hypotheses.MIN_OPENING_M).all()


def test_the_chosen_are_in_order_and_tilt_no_further_than_allowed():
    of = bar_image()
    torch.manual_seed(1)
    network = LiftNetwork().eval()
    for most in (0.02, 0.3, MAX_TILT_RAD):
        found = choose(network, of, OPEN_M, most)
        assert (np.diff(found.rank) <= 0.0).all() and (found.rank <= found.probability).all()
        tilt = tilts(found.of, of.frame)
        assert tilt.max() <= most + 1e-5
        cost = TILT_COST * np.maximum(tilt[:16] - ABOVE_RAD, 0.0)
        np.testing.assert_allclose((found.probability - found.rank)[:16], cost, atol=1e-6)
        assert (found.rank[JUDGED:] <= found.rank[:JUDGED].min()).all()
        assert ((found.probability > 0.0) & (found.probability < 1.0)).all()
    again = choose(network, of, OPEN_M, MAX_TILT_RAD)
    np.testing.assert_array_equal(again.probability, found.probability)


@pytest.mark.parametrize(
    ("lifts", "gain", "tilted"),
    [(0.3, 0.0, False), (0.3, 0.05, False), (0.3, 0.5, True), (SAFE - 0.02, 0.5, True), (SAFE, 0.5, False)],
)
def test_a_tilted_grasp_is_chosen_where_none_is_sure_and_it_lifts_more_than_tilting_costs(
    monkeypatch, lifts, gain, tilted
):
    """`lifts`: probability from above; `gain`: of it, by the radian."""
    of = bar_image()
    believed = lambda _network, of, tried: np.minimum(lifts + gain * tilts(tried, of.frame), 1.0)  # noqa: E731
    monkeypatch.setattr(chooser, "lift_probabilities", believed)
    tilt = tilts(choose(LiftNetwork().eval(), of, OPEN_M).of, of.frame)
    assert (tilt[0] > ABOVE_RAD + 0.01) == tilted
    assert (tilt.max() > 0.4) == (lifts < SAFE)


@pytest.mark.parametrize(("trusts", "taken"), [(0.45, [0, 1, 2]), (0.55, [1, 2]), (0.6, [2]), (0.9, []), (1.0, [])])
def test_of_ggcnns_grasps_those_are_taken_that_lift_with_more_than_the_network_trusts(monkeypatch, trusts, taken):
    of, openings = bar_image(), np.array([0.05, 0.06, 0.07])
    own = of_turns(of, Turn()).part(np.arange(3))._replace(opening=openings)
    believed = lambda _network, _of, tried: np.where(np.isin(tried.opening, openings), 10.0 * tried.opening, 0.99)  # noqa: E731
    monkeypatch.setattr(chooser, "lift_probabilities", believed)
    found = choose(LiftNetwork(trusts=trusts).eval(), of, OPEN_M, own=own)
    expected = own.part(np.array(taken, int)) if taken else choose(LiftNetwork().eval(), of, OPEN_M).of
    np.testing.assert_array_equal(found.of.T, expected.T)
    np.testing.assert_array_equal(found.of.opening, expected.opening)
    assert not taken or len(set(found.rank)) == 1
    monkeypatch.setattr(chooser, "lift_probabilities", lambda _network, _of, tried: np.full(len(tried.T), np.nan))
    assert len(choose(LiftNetwork(trusts=trusts).eval(), of, OPEN_M, own=own).of.T) > 3, "nonsense is not trusted"


@pytest.mark.parametrize("alone", [False, True])
def test_the_best_grasp_is_one_near_which_others_lift_as_well(monkeypatch, alone):
    """On one half of the bar grasps lift better than on the other, `alone`: only those just so, all near them worse."""
    of = bar_image()
    just_so = of_turns(of, *TURNS).T[:, :3, 3]

    def believed(_network, _of, tried):
        places = tried.T[:, :3, 3]
        exact = np.abs(places[:, None] - just_so).max(axis=-1).min(axis=1) < 1e-9
        return np.where(places[:, 1] < 0.0, 0.8, np.where(exact | (not alone), 0.9, 0.5))

    monkeypatch.setattr(chooser, "lift_probabilities", believed)
    monkeypatch.setattr(chooser, "JUDGED", 1000)
    found = choose(LiftNetwork().eval(), of, OPEN_M, ABOVE_RAD)
    assert (found.of.T[0, 1, 3] < 0.0) == alone
    assert found.probability[0] == pytest.approx(0.8 if alone else 0.9)


def test_a_bare_table_offers_nothing():
    found = choose(LiftNetwork().eval(), bar_image(height=0.0), OPEN_M)
    assert len(found.probability) == 0


def test_weights_come_back_and_other_files_are_refused():
    network = LiftNetwork(REFLEX, "cd" * 32, GRIPPERS[REFLEX], 0.4).eval()
    network.temperature.fill_(1.7)
    file = io.BytesIO()
    torch.save(saved(network), file)
    values = np.random.default_rng(0).standard_normal((5, hand_view.FEATURES)).astype(np.float32)
    again = loaded(file.getvalue())
    np.testing.assert_array_equal(lift_logits(again, values), lift_logits(network, values))
    assert (again.hand, again.ggcnn, again.gripper, again.trusts) == (REFLEX, "cd" * 32, GRIPPERS[REFLEX], 0.4)
    of_before = io.BytesIO()
    torch.save({name: value for name, value in saved(network).items() if name != "trusts"}, of_before)
    assert loaded(of_before.getvalue()).trusts == 1.0
    with pytest.raises(RigError, match="holds no weights of the network of lifts"):
        loaded(b"nothing")
    other = io.BytesIO()
    torch.save({**saved(network), "features": 3}, other)
    with pytest.raises(RigError, match="its features is 3, not"):
        loaded(other.getvalue())
    wrongs = {
        "of the hand 'claw'": {"hand": "claw"},
        "GG-CNN's file None": {"ggcnn": None},
        "gripper/opening is -1.0, but must be a finite number": {"gripper": {"opening": -1.0}},
        "its numbers are not all finite": {"state": {**network.state_dict(), "layers.4.bias": torch.tensor([np.nan])}},
        "trusts GG-CNN above 1.2, which must be between 0 and 1": {"trusts": 1.2},
        "trusts GG-CNN above -0.1,": {"trusts": -0.1},
        "trusts GG-CNN above nan,": {"trusts": np.nan},
        "trusts GG-CNN above 'often',": {"trusts": "often"},
        "divides the logits by -1,": {"state": {**network.state_dict(), "temperature": torch.tensor(-1.0)}},
        "divides the logits by 0,": {"state": {**network.state_dict(), "temperature": torch.tensor(0.0)}},
        "its numbers are those of another network.$": {"state": {}},
    }
    for sentence, wrong in wrongs.items():
        nobodys = io.BytesIO()
        torch.save({**saved(network), **wrong}, nobodys)
        with pytest.raises(RigError, match=sentence):
            loaded(nobodys.getvalue())


def test_training_learns_and_its_probability_is_one():
    """Lifts that depend on one feature: likely where it is high. The network says how likely."""
    rng = np.random.default_rng(3)

    def made(n: int) -> LiftData:
        values = 0.1 * rng.standard_normal((n, hand_view.FEATURES)).astype(np.float32)
        values[:, -4] = rng.choice((-1.0, 1.0), n)
        chance = np.where(values[:, -4] > 0.0, 0.9, 0.2)  # the opening, which no mirror changes
        return LiftData(values, (rng.random(n) < chance).astype(np.float32), REFLEX, "ab" * 32, GRIPPERS[REFLEX])

    network, rows = train(made(3000), made(1000), 10, 2e-3, 0)
    assert rows[-1]["training"] < rows[0]["training"]
    assert (network.hand, network.ggcnn) == (REFLEX, "ab" * 32)
    fresh = made(2000)
    said = 1.0 / (1.0 + np.exp(-lift_logits(network, fresh.features)))
    high = fresh.features[:, -4] > 0.0
    assert said[high].mean() == pytest.approx(0.9, abs=0.08)
    assert said[~high].mean() == pytest.approx(0.2, abs=0.08)


@pytest.mark.parametrize(("hand", "exchanged"), [(PARALLEL, {False, True}), (REFLEX, {False})])
def test_only_like_fingers_are_exchanged_in_training(monkeypatch, hand, exchanged):
    found = set()

    def mirrored(values, across, along):
        found.add(across)
        return values

    monkeypatch.setattr(hand_view, "mirrored", mirrored)
    values = np.zeros((20 * 256, hand_view.FEATURES), np.float32)
    data = LiftData(values, np.ones(len(values), np.float32), hand, "ab" * 32, GRIPPERS[hand])
    train(data, data, 1, 2e-3, 0)
    assert found == exchanged


def test_overconfident_logits_are_calibrated():
    torch.manual_seed(0)
    network = LiftNetwork().eval()
    features = torch.randn(4000, hand_view.FEATURES)
    with torch.no_grad():
        network.layers[-1].weight.mul_(40.0)
        honest = torch.sigmoid(network(features) / 2.0)
    calibrate(network, LiftData(features.numpy(), torch.bernoulli(honest).numpy(), REFLEX, "ab" * 32, GRIPPERS[REFLEX]))
    assert float(network.temperature) == pytest.approx(2.0, abs=0.2)


def test_grasps_are_turned_upright_no_further_than_needed():
    of = bar_image(tilt=0.1)
    tried, frame = of_turns(of, *TURNS), of.frame
    before, most = tilts(tried, frame), 0.3
    turned = hypotheses.upright(tried.T[:, :3, :3], frame, most)
    after = np.arccos(np.clip(turned[:, :, 2] @ frame.R[:, 2], -1.0, 1.0))
    assert before.max() > most > before.min()
    np.testing.assert_allclose(after, np.minimum(before, most), atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(turned), 1.0)


def test_tips_that_would_be_in_the_table_are_looked_for_above_it():
    """The physics stops them there, too."""
    of = bar_image(height=0.012)
    best = of_turns(of, Turn()).part(np.array([0]))
    lower = best._replace(T=best.T + np.array([[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0.01], [0, 0, 0, 0]]))
    np.testing.assert_allclose(near_fingers(seen(of, best)), near_fingers(seen(of, lower)), atol=1e-4)
    assert (near_fingers(seen(of, best))[0, :3, :, :-1] < 0.0).all(), "beside the bar, above the table"


@pytest.fixture(scope="module")
def shard(tmp_path_factory):
    """One scene's attempts, as the program writes them."""
    path = tmp_path_factory.mktemp("attempts") / "train_8_000000.npz"
    make_attempts.make_shard(make_attempts.AttemptTask(path, "train", range(1, 2), WEIGHTS, 8, None))
    return path


def test_attempts_come_back_with_their_images(shard):
    with np.load(shard) as arrays:
        assert arrays["depth"].shape == (1, SIDE, SIDE) and arrays["valid"].shape == (1, SIDE, SIDE)
        assert arrays["T"].shape == (8, 4, 4) and set(arrays["reason"]) <= set(range(len(REASONS)))
        lifted = arrays["reason"] == 0
    data = train_lifts.read([shard])
    assert data.features.shape == (8, hand_view.FEATURES)
    np.testing.assert_array_equal(data.lifted, lifted)
    assert (data.hand, data.ggcnn) == (PARALLEL, hashlib.sha256(WEIGHTS.read_bytes()).hexdigest())
    assert data.gripper == GRIPPER


NARROW = dataclasses.replace(GRIPPER, opening=0.03, thickness=0.02)


def test_attempts_of_a_described_gripper_are_its_own(shard, tmp_path, monkeypatch):
    """It opens no wider than it can, is lifted with as it is, and its network sees with its fingers."""
    path = tmp_path / "train_8_000000.npz"
    task = make_attempts.AttemptTask(path, "train", range(1, 2), WEIGHTS, 8, None, gripper=NARROW)
    tried_with = []

    def noted(of, gripper):
        tried_with.append(gripper)
        return [LIFTED] * len(of.tried.T)

    monkeypatch.setattr(make_attempts, "lifted", noted)
    make_attempts.make_shard(task)
    assert tried_with == [NARROW]
    with np.load(path) as arrays, np.load(shard) as usual:
        assert 0.0 < arrays["opening"].max() <= NARROW.opening < usual["opening"].max()
        tried = Hypotheses(arrays["T"], arrays["opening"], arrays["seen"])
        depth = 1e-4 * arrays["depth"][0].astype(np.float32)
        image = NetworkImage(Crop(0, 0, CROP_SIDE), depth, depth, arrays["valid"][0], float(depth.mean()))
    data = train_lifts.read([path])
    assert data.gripper == NARROW
    frame = level_frame(image, image_rays(image, trials.camera()))
    np.testing.assert_array_equal(data.features, hand_view.features(tried, image, trials.camera(), frame, NARROW))
    assert train(data, data, 1, 2e-3, 0)[0].gripper == NARROW
    with pytest.raises(ValueError, match="of several hands"):
        train_lifts.read([shard, path])


def test_a_described_gripper_is_lifted_with_as_it_is():
    """One whose pads reach 5 mm above the table closes over a bar of 4 mm."""
    bar = ((Geom("box", (0.06, 0.008, 0.02)),),)
    one = scene.HeapScene(scene.world_xml(bar), LYING, bar, ("box",))
    T = pose(np.diag([1.0, -1.0, -1.0]) @ rotation_about(2, np.pi / 2), (0.0, 0.0, 0.04))
    tried = Hypotheses(T[None], np.array([0.03]), np.zeros((1, 3)))
    of = make_attempts.Attempts(one, None, tried, T[None], np.array([0.6]), np.array([0]))
    assert attempts.lifted(of, GRIPPER) == [LIFTED]
    assert attempts.lifted(of, dataclasses.replace(GRIPPER, ground=0.05)) != [LIFTED]


REFLEX_WEIGHTS = WEIGHTS.with_name("ggcnn2_reflex.pt")


@pytest.fixture(scope="module")
def to_be_lifted(tmp_path_factory):
    """The task of a shard of the rig's hand, and its scene as the other program gets it."""
    folder = tmp_path_factory.mktemp("reflex")
    shard, results = folder / "train_8_000000.npz", folder / "results.json"
    task = make_attempts.AttemptTask(
        shard, "train", range(1, 2), REFLEX_WEIGHTS, 8, None, REFLEX, GRIPPERS[REFLEX], results
    )
    return task, make_attempts.exported((task, 1))


def rows_of(scene: dict, reasons: list[str]) -> list[dict]:
    grasps = zip(scene["grasps"], reasons)
    return [{**scene, "method": g["method"], "width": g["width"], "reason": reason} for g, reason in grasps]


def test_attempts_of_the_rigs_hand_go_to_its_world_and_come_back_as_a_shard(to_be_lifted):
    task, scene = to_be_lifted
    grasps = scene["grasps"]
    assert len(grasps) == 8 and all(grasp["own_approach"] and grasp["width"] <= 0.116 for grasp in grasps)
    tilt = np.degrees(np.arccos([-np.array(grasp["T_world_grasp"])[2, 2] for grasp in grasps]))
    assert tilt.max() < 50.0 and np.ptp(tilt) > 10.0
    reasons = [REASONS[i % 3] for i in range(8)]
    task.results.write_text(json.dumps(rows_of(scene, reasons)))
    lift_file.results_by_scene.cache_clear()
    make_attempts.make_shard(task)
    with np.load(task.path) as arrays:
        assert arrays["reason"].tolist() == [0, 1, 2, 0, 1, 2, 0, 1] and arrays["T"].shape == (8, 4, 4)
    data = train_lifts.read([task.path])
    assert (data.hand, data.ggcnn) == (REFLEX, hashlib.sha256(REFLEX_WEIGHTS.read_bytes()).hexdigest())


@pytest.mark.parametrize(("dropped", "added"), [(1, 0.0), (0, 1e-9)])
def test_results_of_other_attempts_are_refused(to_be_lifted, tmp_path, dropped, added):
    task, scene = to_be_lifted
    task = task._replace(path=tmp_path / "shard.npz", results=tmp_path / "results.json")
    rows = rows_of(scene, [REASONS[0]] * (8 - dropped))
    rows[0]["width"] += added
    task.results.write_text(json.dumps(rows))
    with pytest.raises(RigError, match="is not of these attempts in scene 1 of train"):
        make_attempts.make_shard(task)
    assert not task.path.exists()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (None, "cannot be read: No such file"),
        ("[", "holds no results"),
        ("[3]", "holds no results"),
        ('[{"split": "train", "scene": 1, "method": "a", "reason": "luck"}]', "unknown reason 'luck'"),
    ],
)
def test_a_file_without_results_is_refused(tmp_path, text, sentence):
    file = tmp_path / "results.json"
    if text is not None:
        file.write_text(text)
    with pytest.raises(RigError, match=sentence):
        lift_file.read_results(file)


@pytest.mark.parametrize("options", ["--export F", f"--hand {REFLEX}", f"--hand {REFLEX} --export F --results F"])
def test_only_the_rigs_hand_is_lifted_elsewhere_and_always(tmp_path, capsys, monkeypatch, options):
    monkeypatch.setattr("sys.argv", ["make_attempts.py", str(tmp_path), str(WEIGHTS), *options.split()])
    with pytest.raises(SystemExit):
        make_attempts.main()
    assert "either --export or --results is needed" in capsys.readouterr().err


def test_the_rigs_hand_is_sampled_half_closed():
    """A free line through a bar needs room for its fingers where they come down, not where the parallel ones do."""
    beside = Geom("box", (0.06, 0.008, 0.03), (0.0, 0.015 + 0.035, 0.03))
    bar = ((Geom("box", (0.06, 0.015, 0.02)),),)
    found = {}
    for hand, gripper in GRIPPERS.items():
        one = scene.HeapScene(scene.world_xml(bar, fixed=(beside,)), LYING, bar, ("box",), (beside,))
        found[hand] = list(PoseSampler(one, gripper).free(np.random.default_rng(5), 0, 300, 0.1))
    assert found[PARALLEL] and not found[REFLEX]


def test_shards_of_several_hands_are_not_mixed(shard, tmp_path):
    other = tmp_path / "train_8_000050.npz"
    with np.load(shard) as arrays:
        np.savez(other, **{**arrays, "hand": REFLEX})
    with pytest.raises(ValueError, match="of several hands or of several GG-CNN"):
        train_lifts.read([shard, other])


def test_a_network_of_lifts_says_what_is_tried_and_training_takes_it_as_well(shard, tmp_path):
    """A network that believes in narrow openings alone."""
    network = LiftNetwork(PARALLEL, "ab" * 32).eval()
    with torch.no_grad():
        for value in network.parameters():
            value.zero_()
        for layer, column in ((0, hand_view.FEATURES - 4), (2, 0), (4, 0)):
            network.layers[layer].weight[0, column] = -1.0 if layer == 4 else 1.0
        network.layers[0].bias[0] = 2.0
    file = tmp_path / "lifts.pt"
    torch.save(saved(network), file)
    path = tmp_path / f"train_8_{make_attempts.BELIEVED}_000000.npz"
    make_attempts.make_shard(make_attempts.AttemptTask(path, "train", range(1, 2), WEIGHTS, 8, file))
    with np.load(path) as believed, np.load(shard) as drawn:
        np.testing.assert_array_equal(believed["depth"], drawn["depth"])
        assert 1 < len(believed["T"]) <= 8
        assert believed["opening"].max() < drawn["opening"].max()
        assert believed["opening"].max() <= np.median(drawn["opening"])
    assert len(train_lifts.read([shard, path]).lifted) > 8


@pytest.mark.parametrize(("options", "trusts"), [((), 1.0), (("--trusts", "0.4"), 0.4)])
def test_a_trained_network_keeps_what_it_shall_trust(shard, tmp_path, monkeypatch, options, trusts):
    for name in ("train_8_000000.npz", "validation_8_000000.npz"):
        (tmp_path / name).write_bytes(shard.read_bytes())
    monkeypatch.setattr("sys.argv", ["train_lifts.py", str(tmp_path), str(tmp_path / "run"), "--epochs", "1", *options])
    train_lifts.main()
    found = loaded((tmp_path / "run" / "lifts.pt").read_bytes())
    assert found.trusts == trusts and found.hand == PARALLEL
    assert len(json.loads((tmp_path / "run" / "curves.json").read_text())) == 1


@pytest.mark.parametrize("turned, tilt", [(0.0, 0.0), (0.6, 0.1)])
def test_opposed_surfaces_of_a_bar_are_its_long_sides(turned, tilt):
    of = bar_image(turned=turned, tilt=tilt)
    found = antipodal_grasp(of, GRIPPER, MAX_TILT_RAD, np.random.default_rng(1))
    assert found is not None
    T, opening, score = found
    across = np.array([np.cos(turned), -np.sin(turned), 0.0])
    assert abs(T[:3, 0] @ across) > np.cos(0.5 * np.pi / antipodal.TURNS + 0.1)
    assert 0.03 + 2.0 * GRIPPER.clearance - 0.004 < opening < 0.03 / np.cos(0.3) + 2.0 * GRIPPER.clearance + 0.004
    assert score >= 5
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
    tips = T[:3, 3] + GRIPPER.reach * T[:3, 2]
    high = of.frame.distance - tips @ of.frame.R[:, 2]
    assert -0.01 < high < 0.04, "between the table and the top"


def test_a_bar_wider_than_the_hand_and_a_bare_table_have_no_opposed_surfaces_within_reach():
    for opening in (0.025, 0.036):  # narrower than the bar, and without room for the clearances
        narrow = dataclasses.replace(GRIPPER, opening=opening)
        assert antipodal_grasp(bar_image(), narrow, MAX_TILT_RAD, np.random.default_rng(1)) is None
    assert antipodal_grasp(bar_image(height=0.0), GRIPPER, MAX_TILT_RAD, np.random.default_rng(1)) is None


def test_a_grasp_network_and_one_of_lifts_are_compared_on_the_same_scene(tmp_path):
    file = tmp_path / "lifts.pt"
    torch.manual_seed(0)
    torch.save(saved(LiftNetwork()), file)
    rows = evaluate_poses.try_scene(
        evaluate_poses.PoseTrialTask("validation", 2, WEIGHTS, {"other": WEIGHTS}, {"mine": file}, GRIPPER)
    )
    methods = [*evaluate_poses.ALL, "other", "mine, from above", "mine, tilted"]
    assert [row["method"] for row in rows] == methods
    assert all(set(row) == set(evaluate_poses.COLUMNS) for row in rows)
    assert rows[1]["tilt"] < 0.05 and rows[4]["tilt"] < 0.05, "of the table's plane, which is found in noise"
    ggcnn, above = rows[0], rows[1]
    assert np.hypot(ggcnn["row"] - above["row"], ggcnn["column"] - above["column"]) < 2.0, "one place, two approaches"
    assert 20 < ggcnn["row"] < 280 and 20 < ggcnn["column"] < 280 and 10.0 < ggcnn["width"] < 150.0
    text = evaluate_poses.report(tmp_path, rows, methods)
    assert all(f"| {method} |" in text for method in methods)
    assert (tmp_path / "reliability.png").stat().st_size > 1000


def test_where_ggcnns_grasp_is_trusted_a_network_of_lifts_takes_it(tmp_path):
    """Both networks know nothing, and believe in about half of all lifts."""
    files = {name: tmp_path / f"{name}.pt" for name in ("trusts", "doubts")}
    for name, trusts in zip(files, (0.2, 0.8)):
        torch.manual_seed(0)
        torch.save(saved(LiftNetwork(trusts=trusts)), files[name])
    task = evaluate_poses.PoseTrialTask("validation", 2, WEIGHTS, {}, files, GRIPPER)
    found = evaluate_poses.of_scene(task).executed
    for way in evaluate_poses.WAYS:
        own, ggcnn = found[f"trusts, {way}"], found[evaluate_poses.ABOVE]
        np.testing.assert_array_equal(own.T_world_grasp, ggcnn.T_world_grasp)
        assert own.opening == ggcnn.opening and own.peak == ggcnn.peak._replace(quality=own.peak.quality)
        assert own.peak.quality != ggcnn.peak.quality, "the probability of a lift"
        assert abs(found[f"doubts, {way}"].T_world_grasp - ggcnn.T_world_grasp).max() > 1e-4


@pytest.fixture
def reflex_lifts(tmp_path):
    """A network of lifts for the rig's hand."""
    file = tmp_path / "lifts.pt"
    torch.manual_seed(0)
    torch.save(saved(LiftNetwork(REFLEX, "", GRIPPERS[REFLEX])), file)
    return file


def test_grasps_of_the_rigs_hand_go_to_its_world_and_come_back_as_rows(reflex_lifts, tmp_path):
    task = evaluate_poses.PoseTrialTask("validation", 2, REFLEX_WEIGHTS, {}, {"mine": reflex_lifts}, GRIPPERS[REFLEX])
    scene = evaluate_poses.exported(task)
    methods = [*evaluate_poses.ALL, "mine, from above", "mine, tilted"]
    assert [grasp["method"] for grasp in scene["grasps"]] == methods
    assert all(grasp["own_approach"] for grasp in scene["grasps"] if grasp["peak"])
    results = tmp_path / "results.json"
    rows = [{**scene, **g, "lifted": g["method"] == methods[-1], "reason": LIFTED} for g in scene["grasps"]]
    rows[0].update(reason=NO_GRASP, peak=None, width=None)
    results.write_text(json.dumps(rows))
    (found,) = evaluate_poses.of_results(results, [task])
    assert [row["method"] for row in found] == methods
    assert all(set(row) == set(evaluate_poses.COLUMNS) for row in found)
    assert [row["found"] for row in found] == [False] + [True] * 4
    assert [row["lifted"] for row in found] == [False] * 4 + [True]
    assert found[-1]["opening"] == scene["grasps"][-1]["width"]
    with pytest.raises(RigError, match="holds nothing of scene 3 of validation"):
        list(evaluate_poses.of_results(results, [task._replace(number=3)]))


@pytest.mark.parametrize("options", ["", "--export X --results X"])
def test_the_rigs_hand_is_compared_by_its_own_physics_alone(reflex_lifts, tmp_path, monkeypatch, capsys, options):
    monkeypatch.chdir(tmp_path)
    words = f"evaluate_poses.py out {REFLEX_WEIGHTS} --lifts mine {reflex_lifts} {options}"
    monkeypatch.setattr("sys.argv", words.split())
    with pytest.raises(SystemExit):
        evaluate_poses.main()
    assert "--export" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [reflex_lifts.name]


def test_a_folder_without_validation_is_refused(shard, capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["train_lifts.py", str(shard.parent), str(shard.parent / "run")])
    with pytest.raises(SystemExit):
        train_lifts.main()
    assert "needs shards train_*.npz and validation_*.npz" in capsys.readouterr().err
