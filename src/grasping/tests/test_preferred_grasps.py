"""Laws of the grasps that an operator prefers among those that lift, in the whole chain from depth images."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from table_scene import CAMERA, Nearest, depth_picture, looking_at
from test_lift_grasps import BOXES, LOW, chain, look
from test_pipeline import ABOVE, ASIDE, DT, UP, YAML, finder

from common.errors import ConfigError
from common.poses import inverse
from common.rotations import rotation_about
from grasping.network.networks import infer
from grasping.pipeline.pipeline import GraspPipeline, PipelineResult
from grasping.pipeline.settings import overlaid, settings_from
from grasping.poses.candidates import TASTES
from grasping.poses.chooser import SAFE, ImageMaps, lift_probabilities
from grasping.poses.hand_view import SCALARS
from grasping.poses.hypotheses import turned
from grasping.poses.lift_network import LiftNetwork
from grasping.poses.preferred import MOST_LOST, expected, offer, preferred, uncertainty
from grasping.poses.taste import PoseTaste, nobody

MANY = {"peaks": {"threshold": 0.0, "count": 50}}
TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Of a hand by half a turn about its approach, which swaps the fingers."""


class Lifts(LiftNetwork):
    """Believes that all grasps lift, the more the better GG-CNN's quality, but less the more they tilt."""

    def __init__(self, by_tilt=0.0, sure=5.0):
        super().__init__()
        self._by_tilt, self._sure = by_tilt, sure

    def forward(self, features):
        quality, _, _, _, _, down = features[:, -SCALARS:].T[:6]
        return self._sure + 0.5 * quality - self._by_tilt * torch.arccos(torch.clamp(down, -1.0, 1.0))


class TwoTilts(LiftNetwork):
    """Believes so much in grasps that tilt by less than 0.1 rad, and so much in the others."""

    def __init__(self, above: float, tilted: float):
        super().__init__()
        self._logits = [float(np.log(p / (1.0 - p))) for p in (above, tilted)]

    def forward(self, features):
        above, tilted = self._logits
        return torch.where(features[:, 5 - SCALARS] > float(np.cos(0.1)), above, tilted)


def leaning(x=0.2, **liked) -> PoseTaste:
    """Returns an operator whose hand leans by so much [rad] about x, opens 8 mm wider, and likes these features."""
    style = nobody().style._replace(tilt_x=np.array([x, 0.0, 0.0]), wider=np.array([0.008, 0.0]))
    weights = np.array([*(liked.get(name.replace(" ", "_"), 0.0) for name in TASTES), 0.0])
    return nobody()._replace(weights=weights, style=style)


def preferring(taste: PoseTaste, changes=None, lifts=None) -> GraspPipeline:
    return chain({**LOW, **(changes or {})}, Lifts() if lifts is None else lifts, taste=taste)


def seen_from_above(found: PipelineResult, which=0) -> np.ndarray:
    """Returns a grasp in the table's view."""
    return inverse(found.view.T_camera_view) @ found.grasps[which].T_camera_grasp


PLACES = pytest.mark.parametrize("place", [ABOVE, ASIDE], ids=["above", "aside"])


@PLACES
@pytest.mark.parametrize("view", ["camera", "table"])
def test_without_episodes_the_grasps_are_those_of_the_network_of_lifts(view, place):
    safest = look(chain({"view": view, **LOW}), place, images=3)
    refined = look(chain({"view": view, **LOW}, taste=nobody()), place, images=3)
    assert len(safest.grasps) == len(refined.grasps) > 1
    for a, b in zip(safest.grasps, refined.grasps):
        np.testing.assert_array_equal(a.T_base_grasp, b.T_base_grasp)
        assert (a.quality, a.id, a.width, a.own_approach) == (b.quality, b.id, b.width, b.own_approach)
        assert a.uncertainty is None and 0.0 < b.uncertainty.probability <= 1.0


@PLACES
def test_the_operators_hand_leans_and_opens_wider(place):
    plain, refined = (look(preferring(leaning(x, height=0.01)), place) for x in (0.0, 0.2))
    a, b = (seen_from_above(found) for found in (plain, refined))
    np.testing.assert_allclose(a[:3, 2], [0.0, 0.0, 1.0], atol=0.02)
    np.testing.assert_allclose(b[:3, 2], [0.0, -np.sin(0.2), np.cos(0.2)], atol=0.02)
    T, grasp = refined.grasps[0].T_base_grasp, refined.grasps[0]
    needed = look(preferring(leaning(height=0.01)._replace(style=nobody().style)), place).grasps[0]
    assert np.linalg.norm(T[:3, 3] - needed.T_base_grasp[:3, 3]) < 0.01
    assert grasp.width == pytest.approx(min(needed.width + 0.008, YAML["tool"]["max_opening"]), abs=0.002)
    place_m, line, tilt, opening = nobody().spreads
    np.testing.assert_allclose(grasp.uncertainty.pose_sd, [place_m, place_m, place_m, tilt, tilt, line])
    assert grasp.uncertainty.opening_sd == opening


@PLACES
def test_an_operator_who_likes_what_is_to_the_right_gets_it_and_the_rest_comes_behind(place):
    at = []
    for side in (-30.0, 30.0):
        found = look(preferring(leaning(0.0, right=side)), place, images=2)
        at.append(seen_from_above(found)[0, 3])
        ranks = [c.rank for c in found.candidates]
        assert ranks[0] == pytest.approx(1.0) and ranks == sorted(ranks, reverse=True)
        probability = [g.uncertainty.probability for g in found.grasps]
        assert probability[0] == max(probability)
        assert all(g.quality == c.peak.quality > SAFE for g, c in zip(found.grasps, found.candidates))
    assert at[1] > at[0] + 0.05
    boxes = sorted(x for x, *_ in BOXES)
    found = look(preferring(leaning(0.0, right=30.0), {"limits": {"x": [-1.0, np.mean(boxes)]}, **MANY}), ABOVE)
    assert found.grasps and found.grasps[0].T_base_grasp[0, 3] < np.mean(boxes), "where the favourite is out of limits"


@pytest.mark.parametrize("by_tilt", [0.0, 3.0, 20.0])
def test_a_tilt_that_costs_lifts_is_taken_as_far_as_it_costs_no_more_than_a_point(by_tilt):
    tilts = []
    for taste in (nobody(), leaning(0.4, height=0.01)):
        of = preferring(taste, lifts=Lifts(by_tilt))
        for found in (look(of), look(of, images=3)):
            best = found.grasps[0]
            tilts.append(float(np.arccos(seen_from_above(found)[2, 2])))
            if taste.weights.any():
                assert best.quality >= min(SAFE, max(c.peak.quality for c in found.candidates) - MOST_LOST)
    wanted = {0.0: (0.35, 0.45), 3.0: (0.3, 0.45), 20.0: (0.0, 0.15)}[by_tilt]
    assert max(tilts[:2]) < 0.1 and all(wanted[0] <= tilt <= wanted[1] for tilt in tilts[2:])


def tilt_of_the_choice(lifts: LiftNetwork, taste: PoseTaste) -> float:
    return float(np.arccos(seen_from_above(look(preferring(taste, lifts=lifts)))[2, 2]))


@pytest.mark.parametrize(
    ("above", "tilted", "taken"),
    [
        (0.9, 0.895, True),
        (0.9, 0.885, False),
        (0.975, 0.967, True),
        (0.975, 0.962, False),
        (0.999, 0.972, True),
        (0.999, 0.968, False),
    ],
)
def test_the_favourite_is_taken_where_it_loses_at_most_one_point_or_lifts_in_97_percent(above, tilted, taken):
    """The operator's choice is nearly sure."""
    tilt = tilt_of_the_choice(TwoTilts(above, tilted), leaning(0.4, right=30.0))
    assert (tilt > 0.1) == taken, tilt


@pytest.mark.parametrize(("fraction", "taken"), [(0.0, True), (0.75, True), (1.08, False)])
def test_what_the_operator_takes_with_a_probability_is_worth_a_tenth_of_it_in_lifts(of, fraction, taken):
    """The grasps that tilt lose a fraction of that; all lift in 97 %."""
    safe, taste = 0.999, leaning(0.4, right=1.0)
    given = offer(TwoTilts(safe, safe), of, YAML["tool"]["max_opening"]).options
    lost = fraction * 0.1 * float(np.exp(expected(taste, given)).max())
    assert safe - lost > SAFE
    assert (tilt_of_the_choice(TwoTilts(safe, safe - lost), taste) > 0.1) == taken


def test_few_episodes_leave_the_choice_to_the_safest_where_the_wanted_tilt_costs_two_points():
    tilts = []
    for liked in (0.01, 30.0):
        found = look(preferring(leaning(0.4, right=liked), lifts=Lifts(by_tilt=4.6)))
        tilts.append(float(np.arccos(seen_from_above(found)[2, 2])))
    assert tilts[0] < 0.32 and tilts[1] == pytest.approx(0.4, abs=0.05)


def test_another_kind_of_object_is_preferred_otherwise_from_the_next_image_on():
    of = preferring(leaning(0.2, height=0.01))
    look(of, images=3)
    of.prefer(leaning(-0.2, height=0.01))
    found, anew = look(of).grasps, look(preferring(leaning(-0.2, height=0.01))).grasps
    np.testing.assert_array_equal(found[0].T_base_grasp, anew[0].T_base_grasp)
    with pytest.raises(ValueError, match="a chain without a taste cannot take one"):
        chain().prefer(leaning())


def test_a_taste_needs_a_network_of_lifts():
    s = settings_from(YAML)
    with pytest.raises(ValueError, match="a taste needs a network of lifts"):
        GraspPipeline(s.views(), Nearest(), s.steps(UP), taste=leaning())
    with pytest.raises(ConfigError, match="lifts is never, but refine: true chooses among the grasps of that network"):
        settings_from(overlaid(YAML, {"refine": True, "lifts": "never"}))
    for lifts in ("auto", "must"):
        assert settings_from(overlaid(YAML, {"refine": True, "lifts": lifts})).main.refine
    assert look(finder(), ABOVE).grasps[0].uncertainty is None


def approach_in_base(azimuth: float, elevation: float) -> np.ndarray:
    """Returns where a leaning operator grasps along in the table's view of a camera that stands there."""
    x, y, z = np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)
    place = looking_at((0.8 * x, 0.8 * y, 0.8 * z), (0.0, 0.0, 0.0))
    return look(preferring(leaning(0.2, height=0.01)), place).grasps[0].T_base_grasp[:3, 2]


def test_a_lean_turns_with_the_cameras_heading_and_does_not_lean_with_it():
    first = approach_in_base(0.4, 0.8)
    np.testing.assert_allclose(approach_in_base(0.4, 1.1), first, atol=0.02)
    np.testing.assert_allclose(approach_in_base(1.1, 0.8), rotation_about(2, 0.7) @ first, atol=0.02)
    assert np.hypot(*first[:2]) == pytest.approx(np.sin(0.2), abs=0.02)


def test_in_a_noisy_image_the_favourite_stays_where_it_is_and_a_removed_thing_is_left():
    of, rng, depth = preferring(leaning(0.2, height=0.01)), np.random.default_rng(3), depth_picture(ABOVE, BOXES)
    seen = []
    for i in range(8):
        found = of.step(depth + rng.normal(0.0, 1e-3, depth.shape).astype(np.float32), CAMERA, ABOVE, DT * i)
        seen.append(found.grasps[0])
    T = np.array([one.T_base_grasp for one in seen])
    assert len({one.id for one in seen}) == 1
    assert np.linalg.norm(T[:, :3, 3] - T[0, :3, 3], axis=1).max() < 2e-3
    assert turned(T[:, :3, :3], T[0, :3, :3]).max() < 0.02
    left = of.step(depth_picture(ABOVE, BOXES[1:]), CAMERA, ABOVE, 1.0)
    assert np.hypot(*(left.candidates[0].grasp.T_camera_grasp[:2, 3] - seen_from_above(found)[:2, 3])) > 0.05


@pytest.fixture(scope="module", name="of")
def of_fixture() -> ImageMaps:
    view = look(preferring(nobody())).view
    return ImageMaps.of_output(view.image, view.camera, infer(Nearest(), view.image.input))


def test_a_grasp_of_the_image_before_does_not_stay_where_another_lifts_much_better(of):
    """It stays without a taste, as the safest but for 5 points; what the operator wants is not safe at all."""
    taste, lifts, opening = leaning(0.4, height=0.01), Lifts(4.3, sure=2.8), YAML["tool"]["max_opening"]
    leant = offer(lifts, of, opening).safest.of.T[:1].copy()
    leant[:, :3, :3] = leant[:, :3, :3] @ rotation_about(1, 0.1)
    before = of.hypotheses(leant, np.array([opening]))
    given = offer(lifts, of, opening, before=before)
    np.testing.assert_array_equal(given.safest.of.T[0], leant[0])
    found = preferred(lifts, of, given, taste, opening, before=before)
    safest = max(lift_probabilities(lifts, of, given.safest.of))
    first = np.array([0])
    stayed, chosen = (lift_probabilities(lifts, of, each)[0] for each in (before, found.of.part(first)))
    assert stayed < min(SAFE, safest - MOST_LOST) <= chosen


def test_a_grasp_of_the_image_before_stays_whichever_finger_is_which(of):
    taste, lifts, opening = leaning(0.2, height=0.01), Lifts(), YAML["tool"]["max_opening"]
    given = offer(lifts, of, opening)
    favourite = preferred(lifts, of, given, taste, opening).of.T[0]
    shifted = favourite.copy()
    shifted[:3, 3] += 5e-4 * favourite[:3, 0]
    for T in (shifted, shifted @ TURN):
        before = of.hypotheses(T[None], np.array([opening]))
        np.testing.assert_array_equal(preferred(lifts, of, given, taste, opening, before=before).of.T[0], T)
        assert uncertainty(taste, given.options, T)[0] == pytest.approx(uncertainty(taste, given.options, shifted)[0])
    far = favourite.copy()
    far[:3, 3] += 0.3 * favourite[:3, 0]
    before = of.hypotheses(far[None], np.array([opening]))
    np.testing.assert_array_equal(preferred(lifts, of, given, taste, opening, before=before).of.T[0], favourite)
    blind = ImageMaps(of.image, of.camera, of.maps._replace(quality=0.0 * of.maps.quality), of.certainty)
    assert np.isnan(uncertainty(taste, offer(lifts, blind, opening).options, favourite).probability)
