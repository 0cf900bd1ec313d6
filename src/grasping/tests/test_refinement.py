"""Which candidates an operator prefers: what a conditional logit recovers, and what taste must never cost."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.camera_model import pinhole
from grasping.network.depth_image import Crop, prepare
from grasping.network.maps import Maps, Peak, gaussian
from grasping.refinement import lifts, taste
from grasping.refinement.candidates import LIFTS, TASTES, Candidates, LevelFrame, candidates
from grasping.refinement.preference import MOST_LOST, SAFE, Preference, constrained, preferences
from grasping.refinement.taste import Choice

CAMERA = pinhole("camera", 400, 400, [[570.0, 0.0, 199.5], [0.0, 570.0, 199.5], [0.0, 0.0, 1.0]])
SEEDS = st.integers(0, 2**32 - 1)
OTHER = LIFTS.index("other line")


def image_of(rng, n=30):
    """Returns n candidates that lie and look anyhow, the best quality first."""
    tastes, outcomes = rng.normal(0.0, 0.7, (n, len(TASTES))), rng.normal(0.0, 0.7, (n, len(LIFTS)))
    quality = np.sort(rng.uniform(0.3, 1.0, n))[::-1]
    outcomes[:, OTHER] = rng.random(n) < 0.3
    outcomes[:1, OTHER] = 0.0
    tastes[:, TASTES.index("quality")] = outcomes[:, LIFTS.index("quality")] = quality
    points = np.column_stack([rng.uniform(-0.1, 0.1, (n, 2)), rng.uniform(0.6, 0.68, n)])
    angles = rng.uniform(-0.5, 0.5, n) * np.pi
    peaks = tuple(Peak(100, 100, float(q), float(a), 30.0) for q, a in zip(quality, angles))
    frame = LevelFrame(np.eye(3), 0.7)
    return Candidates(peaks, frame, points, angles, np.full(n, 0.04), rng.normal(0.0, 0.3, (n, 2)), tastes, outcomes)


def liking(**weights):
    """Returns the weights of an operator who likes features of these names."""
    found = np.zeros(len(TASTES))
    for name, value in weights.items():
        found[TASTES.index(name.replace("_", " "))] = value
    return found


def taken(rng, of, weights, miss=(0.0, 0.0, 0.0), turned=0.0, tremor=0.005):
    """Returns the grasp of an operator with these weights: a choice as the softmax has it, a miss and a tremor."""
    i = rng.choice(len(of.peaks), p=taste.softmax(taste.worths(weights, of)))
    place = of.points[i] + miss + rng.normal(0.0, tremor, 3)
    return Choice(of, place, float(of.angles[i] + turned + rng.normal(0.0, 0.08)), rng.normal(0.0, 0.05, 2), 0.05)


def operator(rng, weights, count, **how):
    return taste.learned([taken(rng, image_of(rng), weights, **how) for _ in range(count)])


def outcomes(rng, n=2000):
    """Returns a model of lifts that were decided by quality and tilt."""
    of = image_of(rng, n)
    tilts, turns = rng.normal(0.0, 0.15, (n, 2)), rng.normal(0.0, 0.1, n)
    worth = 6.0 * (of.quality - 0.45) - 40.0 * (tilts**2).sum(axis=1)
    lifted = rng.random(n) < 1.0 / (1.0 + np.exp(-worth))
    return lifts.learned(lifts.terms(of.lifts, of.angles, tilts, turns), lifted)


LIFTED = outcomes(np.random.default_rng(5))


def test_without_episodes_the_favourite_is_the_best_quality():
    of = image_of(np.random.default_rng(1))
    for known in (None, LIFTED):
        found = preferences(of, Preference(taste.learned([]), known))
        assert found[0].candidate == 0
        assert found[0].quality == of.quality[0]
        assert found[0].turn == found[0].wider == 0.0
        assert not found[0].tilt.any()
        np.testing.assert_allclose([p.quality for p in found], [of.quality[p.candidate] for p in found], atol=1e-9)


def test_without_candidates_nothing_is_preferred():
    of = image_of(np.random.default_rng(1), 0)
    assert preferences(of, Preference(taste.nobody(), LIFTED)) == []
    assert not taste.learned([Choice(of, np.zeros(3), 0.0, np.zeros(2), 0.05)]).weights.any()


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_taste_never_costs_more_than_the_constraint(seed):
    """However strong it is, nothing is chosen, nor tilted, that is less likely lifted than GG-CNN's best."""
    rng = np.random.default_rng(seed)
    of = image_of(rng)
    hand = taste.HandStyle(*(rng.normal(0.0, 0.3, n) for n in (2, 3, 3, 2)), 0.1, 0.01)
    known = Preference(taste.nobody()._replace(weights=rng.normal(0.0, 20.0, len(TASTES)), hand=hand), LIFTED)
    found = preferences(of, known)
    allowed, _ = constrained(of, known)
    assert {p.candidate for p in found} == set(np.flatnonzero(allowed))
    assert allowed[0]
    nothing = np.zeros((len(of.peaks), 2))
    as_safe = lifts.probabilities(LIFTED, of, nothing, nothing[:, 0])[0] - MOST_LOST
    for one in found:
        tilts, turns = np.tile(one.tilt, (len(of.peaks), 1)), np.full(len(of.peaks), one.turn)
        least = as_safe if of.lifts[one.candidate, OTHER] else min(as_safe, SAFE)
        assert lifts.probabilities(LIFTED, of, tilts, turns)[one.candidate] >= least - 1e-12


def test_weights_are_recovered():
    rng = np.random.default_rng(7)
    weights = liking(height=2.0, from_middle=-2.0, line_cos=1.5)
    np.testing.assert_allclose(operator(rng, weights, 500).weights, weights, atol=0.4)


def test_twenty_episodes_help():
    rng = np.random.default_rng(8)
    weights = liking(height=4.0, towards_operator=3.0)
    learned = operator(rng, weights, 20)
    hits = {name: 0 for name in ("nobody", "learned")}
    for _ in range(200):
        of = image_of(rng)
        wanted = int(np.argmax(taste.worths(weights, of)))
        for name, known in (("nobody", taste.nobody()), ("learned", learned)):
            hits[name] += preferences(of, Preference(known, None))[0].candidate == wanted
    assert hits["learned"] > 1.5 * hits["nobody"]


def test_the_constant_miss_is_recovered_and_not_copied():
    rng = np.random.default_rng(9)
    miss = np.array([0.012, -0.007, 0.004])
    found = operator(rng, liking(height=3.0), 60, miss=miss, turned=0.1)
    np.testing.assert_allclose(found.miss, miss, atol=0.003)
    assert found.hand.line[0] + 0.8 * found.hand.line[1] == pytest.approx(0.1, abs=0.03)
    assert found.spread == pytest.approx(0.005, abs=0.002)
    of = image_of(rng)
    best = preferences(of, Preference(found, None))[0]
    assert abs(best.turn) < 0.08


def test_a_grasp_is_explained_by_what_it_missed():
    """Not by the candidate that the constant miss happened to lead to."""
    of = image_of(np.random.default_rng(12), 4)
    miss = np.array([0.02, 0.0, 0.0])
    of.points[1], of.angles[1] = of.points[0] + miss, of.angles[0]
    known = taste.nobody()._replace(miss=miss)
    grasp = Choice(of, of.points[0] + miss, float(of.angles[0]), np.zeros(2), 0.05)
    meant = taste.explained(known, grasp, np.full(4, 0.25))
    assert meant[0] > 10.0 * meant[1]


def test_a_grasp_far_from_all_candidates_teaches_nothing():
    rng = np.random.default_rng(10)
    of = image_of(rng)
    far = Choice(of, np.array([0.5, 0.5, 0.7]), 0.0, np.zeros(2), 0.05)
    found = taste.learned([far])
    np.testing.assert_allclose(found.weights, 0.0, atol=1e-6)
    np.testing.assert_allclose(found.miss, 0.0, atol=1e-6)


@given(SEEDS)
@settings(max_examples=10, deadline=None)
def test_the_gradient_is_that_of_the_posterior(seed):
    rng = np.random.default_rng(seed)
    seen = [rng.normal(0.0, 1.0, (6, 4)) for _ in range(3)]
    offsets, meant = [rng.normal(0.0, 1.0, 6) for _ in seen], [rng.dirichlet(np.ones(6)) * 0.9 for _ in seen]
    weights, step = rng.normal(0.0, 1.0, 4), 1e-5
    _, gradient, hessian = taste.log_posterior(weights, seen, offsets, meant)
    for k, axis in enumerate(np.eye(4)):
        plus, minus = (taste.log_posterior(weights + s * step * axis, seen, offsets, meant) for s in (1.0, -1.0))
        assert (plus[0] - minus[0]) / (2.0 * step) == pytest.approx(gradient[k], abs=1e-6)
        np.testing.assert_allclose((plus[1] - minus[1]) / (2.0 * step), -hessian[k], atol=1e-6)


def test_outcomes_teach_what_is_lifted():
    rng = np.random.default_rng(11)
    of, nothing = image_of(rng, 300), np.zeros((300, 2))
    upright = lifts.probabilities(LIFTED, of, nothing, nothing[:, 0])
    tilted = lifts.probabilities(LIFTED, of, nothing + 0.2, nothing[:, 0])
    true = 1.0 / (1.0 + np.exp(-6.0 * (of.quality - 0.45)))
    assert np.abs(upright - true).mean() < 0.07
    assert (tilted < upright).mean() > 0.95


def test_symmetric_things_have_no_lighter_end():
    """What is alike at both ends differs in nothing but its side: the sign of an axis does not decide."""
    ends = scene(bar_depth())
    inner = np.flatnonzero(np.abs(ends.points[:, 1]) < 0.005)
    left, right = (ends.tastes[inner[pick(ends.points[inner, 0])]] for pick in (np.argmin, np.argmax))
    for name in ("along", "towards lighter end", "aside", "from middle", "across"):
        assert left[TASTES.index(name)] == pytest.approx(right[TASTES.index(name)], abs=0.2), name
    assert abs(left[TASTES.index("towards lighter end")]) < 0.1
    assert left[TASTES.index("right")] == pytest.approx(-right[TASTES.index("right")], abs=0.1)


def test_a_hammers_handle_is_its_lighter_end():
    depth = bar_depth()
    depth[150:251, 236:262] = 0.66
    found = scene(depth)
    x, lighter = found.points[:, 0], found.tastes[:, TASTES.index("towards lighter end")]
    assert lighter[np.argmin(x)] > 0.5
    assert lighter[np.argmax(x)] < -0.2


def bar_depth():
    """Returns the depth of a level bar of 100 by 24 mm, 40 mm above a table at 0.7 m, seen from straight above."""
    depth = np.full((400, 400), 0.7, np.float32)
    depth[190:211, 157:243] = 0.66
    return depth


def scene(depth, below=0.69):
    """Returns the candidates where a network calls everything good that is nearer than `below`, fingers up and down."""
    image = prepare(depth, Crop(0, 0, 400))
    good = (image.depth < below).astype(np.float32)
    maps = Maps(gaussian(good, 2.0), np.full_like(good, 0.5 * np.pi - 1e-3), np.full_like(good, 20.0))
    return candidates(maps, np.ones_like(good), image, CAMERA)


def test_the_same_thing_turned_looks_the_same_in_its_own_axes():
    one, other = scene(bar_depth()), scene(np.ascontiguousarray(bar_depth().T))
    for name in ("along", "from middle", "thickness", "height"):
        a, b = (np.sort(found.tastes[:, TASTES.index(name)]) for found in (one, other))
        assert a.max() == pytest.approx(b.max(), abs=0.1), name
    across = TASTES.index("across")
    assert one.tastes[:, across].mean() < -0.5 < 0.5 < other.tastes[:, across].mean()


def test_a_tilted_camera_sees_a_level_frame():
    """A table that leans in the image by 10 degrees has its normal as z, and heights are measured along that."""
    y = (np.arange(400) - 199.5) / 570.0
    tilt = np.radians(10.0)
    table = 0.7 * np.cos(tilt) / (np.cos(tilt) + y * np.sin(tilt))
    depth = np.repeat(table[:, None], 400, axis=1).astype(np.float32)
    depth[190:211, 157:243] -= 0.04
    found = scene(depth, below=0.665)
    assert len(found.peaks) > 10
    found = found._replace(points=found.points[np.abs(found.points[:, 0]) < 0.04])
    np.testing.assert_allclose(found.frame.R[:, 2], [0.0, np.sin(tilt), np.cos(tilt)], atol=0.01)
    assert np.median(found.heights) == pytest.approx(0.04 * np.cos(tilt), abs=0.004)


def test_ambiguous_lines_have_rivals_of_less_quality():
    image = prepare(bar_depth(), Crop(0, 0, 400))
    good = (image.depth < 0.69).astype(np.float32)
    maps = Maps(gaussian(good, 2.0), np.full_like(good, 0.2), np.full_like(good, 20.0))
    sure, unsure = (candidates(maps, np.full_like(good, c), image, CAMERA) for c in (0.9, 0.3))
    assert len(unsure.peaks) == 4 * len(sure.peaks)
    assert unsure.peaks[0] == sure.peaks[0]
    assert not sure.lifts[:, OTHER].any()
    assert unsure.lifts[:, OTHER].sum() == 3 * len(sure.peaks)
    assert np.all(np.diff(unsure.quality) <= 0.0)


def test_an_empty_table_has_no_candidates():
    image = prepare(np.full((400, 400), 0.7, np.float32), Crop(0, 0, 400))
    nothing = np.zeros((300, 300), np.float32)
    assert not candidates(Maps(nothing, nothing, nothing), nothing, image, CAMERA).peaks
