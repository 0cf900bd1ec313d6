"""The likelihood of an operator's pixel: highest for the map that the operator follows, and as sharp as they are."""

from __future__ import annotations

import numpy as np
import pytest

from grasping.lab.evaluation.operator_errors import Calibration, calibrated, place_log_likelihoods

SIDE = 12


def people(sharpness: float, count: int = 400):
    """Returns maps and the pixels that people chose who follow them so sharply."""
    rng = np.random.default_rng(3)
    qualities = rng.random((count, SIDE, SIDE)).astype(np.float32)
    odds = np.exp(sharpness * qualities.reshape(count, -1))
    places = np.zeros((count, SIDE * SIDE), np.float32)
    places[np.arange(count), [rng.choice(SIDE * SIDE, p=o / o.sum()) for o in odds.astype(float)]] = 1.0
    return qualities, places.reshape(qualities.shape)


@pytest.mark.parametrize("sharpness", [8.0, 20.0])
def test_the_calibration_finds_how_sharply_people_follow_a_map(sharpness):
    assert calibrated(*people(sharpness)) == (0.0, sharpness)


def test_a_map_that_says_nothing_makes_all_places_equal():
    _, places = people(8.0, 5)
    flat = np.full((5, SIDE, SIDE), 0.4, np.float32)
    found = place_log_likelihoods(flat, places, Calibration(1.0, 20.0))
    np.testing.assert_allclose(found, -2.0 * np.log(SIDE), rtol=1e-5)


def test_one_of_two_equal_places_costs_one_bit():
    quality = np.zeros((1, SIDE, SIDE), np.float32)
    quality[0, 2, 3] = quality[0, 9, 8] = 1.0
    place = np.zeros_like(quality)
    place[0, 9, 8] = 1.0
    assert place_log_likelihoods(quality, place, Calibration(0.0, 30.0))[0] == pytest.approx(-np.log(2.0), abs=1e-4)


def test_the_map_that_people_follow_is_the_likelier_one():
    qualities, places = people(12.0)
    right, wrong = (
        place_log_likelihoods(q, places, Calibration(0.0, 12.0)) for q in (qualities, qualities[::-1].copy())
    )
    assert right.mean() > wrong.mean() + 1.0
