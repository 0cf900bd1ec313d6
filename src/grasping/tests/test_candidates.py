"""The places of an image that can be grasped, and what is seen of each."""

from __future__ import annotations

import numpy as np
import pytest

from common.camera_model import pinhole
from grasping.network.depth_image import Crop, prepare
from grasping.network.maps import Maps, gaussian, half_turn
from grasping.poses.candidates import TASTES, Candidates, candidates
from grasping.poses.chooser import ImageMaps

CAMERA = pinhole("camera", 400, 400, [[570.0, 0.0, 199.5], [0.0, 570.0, 199.5], [0.0, 0.0, 1.0]])


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


def scene(depth, below=0.69, line=0.5 * np.pi - 1e-3, certainty=1.0) -> Candidates:
    """Returns the candidates where a network calls everything good that is nearer than `below`, fingers up and down."""
    image = prepare(depth, Crop(0, 0, 400))
    good = (image.depth < below).astype(np.float32)
    maps = Maps(gaussian(good, 2.0), np.full_like(good, line), np.full_like(good, 20.0))
    of = ImageMaps(image, CAMERA, maps, np.full_like(good, certainty))
    return candidates(of.maps, of.certainty, of.image, of.camera, of.frame)


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
    sure, unsure = (scene(bar_depth(), line=0.2, certainty=certainty) for certainty in (0.9, 0.3))
    assert len(unsure.peaks) == 4 * len(sure.peaks)
    assert unsure.peaks[0] == sure.peaks[0]
    off, against = np.abs(half_turn(unsure.angles - 0.2)), unsure.tastes[:, TASTES.index("against line")]
    for turn in (0.0, 0.25 * np.pi, 0.5 * np.pi):
        assert np.isclose(off, turn, atol=1e-5).sum() == len(sure.peaks) * (2 if turn == 0.25 * np.pi else 1)
    np.testing.assert_allclose(against, 0.3 * np.sin(off) ** 2, atol=1e-5)
    assert np.all(np.diff(unsure.quality) <= 0.0)


def test_an_empty_table_has_no_candidates():
    assert not scene(np.full((400, 400), 0.7, np.float32)).peaks
