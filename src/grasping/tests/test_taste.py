"""An operator's taste in full poses: what is learned of few grasps, and what it must never cost."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from test_poses import DOWN, OPEN_M, bar_image

from common.poses import pose
from grasping.lab.evaluation.grasp_distance import miss
from grasping.network.maps import half_turn
from grasping.poses import chooser, logit, taste
from grasping.poses import preferred as preferred_module
from grasping.poses.candidates import LENGTH_M
from grasping.poses.chooser import SAFE, ImageMaps, ScoredPoses, choose, tilts
from grasping.poses.hypotheses import MAX_TILT_RAD, level_rotation, rotations
from grasping.poses.lift_network import LiftNetwork
from grasping.poses.preferred import MOST_LOST, expected, offer, preferred, wanted_poses
from grasping.poses.taste import PoseTaste, Shown, learned, nobody, options

TURNS = np.linspace(-1.2, 1.2, 8)
"""Of the bars that teach."""


def network(sure: bool) -> LiftNetwork:
    """A network to which all lifts are sure, or any."""
    torch.manual_seed(2)
    made = LiftNetwork().eval()
    with torch.no_grad():
        made.layers[-1].weight.mul_(0.0 if sure else 25.0)
        made.layers[-1].bias.fill_(6.0 if sure else 0.0)
    return made


SURE = network(True)


def grasps(network: LiftNetwork, of: ImageMaps, known: PoseTaste) -> ScoredPoses:
    return preferred(network, of, offer(network, of, OPEN_M), known, OPEN_M)


def meant(turned: float, tilt=(0.3, -0.1), along: float = 0.03) -> tuple[np.ndarray, float]:
    """Returns the grasp of who takes a bar at the end below in the image, across it, and tilts; and its line."""
    end = np.array([np.sin(turned), np.cos(turned)])  # rows run down
    end = end if end[1] > 0.0 else -end
    zero = np.zeros(1)
    R = rotations(np.array([[*tilt, 0.0]])) @ level_rotation(np.array([-turned]), zero, zero)
    return pose(R[0], (*(along * end), 0.66)), turned


def shown(turned: float, rng=None, bias=(0.0, 0.0, 0.0), **how) -> Shown:
    T, line = meant(turned, **how)
    noise = rng.normal(0.0, 1.0, 6) if rng is not None else np.zeros(6)
    place = T[:3, 3] + bias + 0.004 * noise[:3]
    tilt = np.array(how.get("tilt", (0.3, -0.1))) + 0.06 * noise[3:5]
    return Shown(options(SURE, bar_image(turned=turned), OPEN_M), place, line + 0.06 * noise[5], tilt, 0.05)


@pytest.fixture(scope="module", name="lessons")
def lessons_fixture():
    rng = np.random.default_rng(1)
    return [shown(turned, rng, bias=(0.006, -0.004, 0.0)) for turned in TURNS]


def test_without_episodes_the_safest_grasps_are_the_chosen_ones():
    of = bar_image(turned=0.3)
    for one, other in zip(grasps(network(False), of, nobody()), choose(network(False), of, OPEN_M)):
        for a, b in zip(one, other) if isinstance(one, tuple) else ((one, other),):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("turned", [-0.7, 0.1, 0.9])
def test_place_line_and_tilt_are_learned_and_the_constant_miss_is_not(lessons, turned):
    known = learned(lessons)
    wanted, _ = meant(turned)
    best = grasps(SURE, bar_image(turned=turned), known)
    off = miss(wanted, best.of.T[0])
    assert off.position < 0.015 and off.rotation < np.radians(12.0)
    before = miss(wanted, choose(SURE, bar_image(turned=turned), OPEN_M).of.T[0])
    assert not before.is_near
    np.testing.assert_allclose(known.miss, (0.006, -0.004), atol=0.004)


def test_swapped_fingers_are_the_same_grasp(lessons):
    one, other = learned(lessons), learned([s._replace(angle=s.angle + np.pi) for s in lessons])
    np.testing.assert_allclose(one.weights, other.weights, atol=1e-6)
    np.testing.assert_allclose(np.concatenate(one.style), np.concatenate(other.style), atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_no_taste_costs_more_than_a_point_of_lifts(seed):
    """Whatever was learned, what may be taken lifts with `SAFE`, or as the safest but for `MOST_LOST`."""
    rng = np.random.default_rng(seed)
    of, judge = bar_image(turned=0.5), network(False)
    style = nobody().style._replace(tilt_x=rng.normal(0.0, 0.4, 3), deep=rng.normal(0.0, 0.02, 2))
    wild = nobody()._replace(weights=rng.normal(0.0, 20.0, len(nobody().weights)), style=style)
    found = grasps(judge, of, wild)
    assert found.probability[0] >= min(SAFE, choose(judge, of, OPEN_M).probability[0] - MOST_LOST)


def test_who_grasps_from_above_may_do_so_beside_tilted_grasps_that_are_believed_in_more(monkeypatch):
    of, known = bar_image(turned=0.5), nobody()._replace(weights=np.ones(len(nobody().weights)))
    believed = lambda _network, of, tried: 0.9 + 0.05 * tilts(tried, of.frame)  # noqa: E731
    for module in (chooser, preferred_module):
        monkeypatch.setattr(module, "lift_probabilities", believed)
    assert tilts(choose(SURE, of, OPEN_M).of, of.frame)[0] < 0.05
    found = grasps(SURE, of, known)
    assert found.rank[0] == 1.0 and tilts(found.of, of.frame)[0] < 0.2, "the favourite"


def test_one_grasp_all_alike_or_contradictory_ones_leave_a_taste_that_is_finite_and_mild(lessons):
    ends = [shown(turned, along=along) for turned in TURNS[::2] for along in (0.03, -0.03)]
    for of in (lessons[:1], lessons[:1] * 20, ends):
        known = learned(of)
        assert all(np.isfinite(value).all() for value in (*known.style, *known[:2], known.spreads))
        assert np.abs(known.weights).max() < 6.0 and (known.spreads > 0.0).all()
    both = learned(ends)
    given = options(SURE, bar_image(turned=0.2), OPEN_M)
    share = logit.softmax(taste.worths(both.weights, given))
    assert 0.3 < share[given.of.points[:, 1] > 0.0].sum() < 0.7, "neither end is preferred"


def test_a_grasp_that_is_none_of_the_options_teaches_nothing(lessons):
    far = [one._replace(place=one.place + 0.3) for one in lessons]
    np.testing.assert_allclose(learned(far).weights, 0.0, atol=0.05)


def test_where_ggcnn_sees_nothing_the_safest_grasp_is_taken_and_on_a_bare_table_none(lessons):
    of, known = bar_image(turned=0.5), learned(lessons)
    blind = dataclasses.replace(of, maps=of.maps._replace(quality=np.zeros_like(of.maps.quality)))
    assert len(options(SURE, blind, OPEN_M).base) == 0
    np.testing.assert_array_equal(grasps(SURE, blind, known).of.T, choose(SURE, blind, OPEN_M).of.T)
    assert len(grasps(SURE, bar_image(height=0.0), known).probability) == 0


def test_a_wanted_grasp_comes_down_at_its_option():
    """Straight down, the fingers' line as the option's, the tips where the surface is seen."""
    of = bar_image(turned=0.4)
    given = options(SURE, of, OPEN_M).of
    n = len(given.angles)
    found = taste.poses(given, np.zeros((n, 2)), np.zeros(n), np.full(n, 0.01), given.openings, of)
    np.testing.assert_allclose(found.T[:, :3, 2], np.tile(DOWN, (n, 1)), atol=2e-3)
    line = np.arctan2(-found.T[:, 1, 0], found.T[:, 0, 0])
    np.testing.assert_allclose(np.cos(2.0 * (line - given.angles)), 1.0, atol=1e-4)
    np.testing.assert_allclose(
        found.T[:, :3, 3], given.points @ given.frame.R.T + 0.01 * given.frame.R[:, 2], atol=1e-9
    )


def test_a_constant_turn_is_a_miss_and_one_with_the_height_a_habit():
    of = bar_image(turned=0.4)
    given, habit = options(SURE, of, OPEN_M), 0.3
    plain, missed, turning = (
        wanted_poses(nobody()._replace(style=nobody().style._replace(line=np.array(line))), given, of, OPEN_M, 0.8)
        for line in ((0.0, 0.0), (0.2, 0.0), (0.0, habit))
    )
    np.testing.assert_allclose(missed.T, plain.T, atol=1e-12)
    turned = np.arctan2(-turning.T[:, 1, 0], turning.T[:, 0, 0]) - np.arctan2(-plain.T[:, 1, 0], plain.T[:, 0, 0])
    np.testing.assert_allclose(half_turn(turned), habit * given.of.heights / LENGTH_M, atol=1e-6)


def test_of_equally_safe_grasps_the_operators_own_is_taken_and_the_safest_ones_come_behind(lessons):
    of, known = bar_image(turned=0.4), learned(lessons)
    offered = offer(SURE, of, OPEN_M)
    found = preferred(SURE, of, offered, known, OPEN_M)
    wanted = wanted_poses(known, offered.options, of, OPEN_M, MAX_TILT_RAD)
    best = int(np.argmax(expected(known, offered.options)))
    np.testing.assert_allclose(found.of.T[0], wanted.T[best], atol=1e-12)
    behind = len(offered.safest.probability)
    np.testing.assert_array_equal(found.of.T[-behind:], offered.safest.of.T)
    assert found.rank[0] == 1.0 > found.rank[1] and found.rank[:-behind].min() >= found.rank[-behind:].max()
    np.testing.assert_allclose(found.rank[-behind:], found.rank[:-behind].min() * offered.safest.rank)
    chosen = np.exp(expected(known, offered.options))
    other = int(np.argsort(-chosen)[5])
    (at,) = np.flatnonzero((found.of.T[:-behind] == wanted.T[other]).all(axis=(1, 2)))
    assert chosen[other] < chosen[best] - 0.05
    assert found.rank[at] == pytest.approx(np.exp(chosen[other] - chosen[best]), abs=1e-6)


def test_a_few_lines_that_have_nothing_to_do_with_the_option_do_not_teach_the_hand(lessons):
    steady = learned(lessons * 2)
    mixed = [one._replace(angle=one.angle + (1.3 if i % 8 == 0 else 0.0)) for i, one in enumerate(lessons * 2)]
    known = learned(mixed)
    assert known.spreads[1] < 1.3 * steady.spreads[1]
    assert abs(known.style.line[0] - steady.style.line[0]) < 0.05
