"""The network's image: the published steps where there are no holes, and holes filled where there are."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from grasping.network.depth_image import Crop, centre_crop, fill_holes, prepare


def scene(seed=0, holes=0.0):
    rng = np.random.default_rng(seed)
    depth = 0.7 + 0.05 * cv2.GaussianBlur(rng.standard_normal((480, 640)), (0, 0), 8.0).astype(np.float32)
    depth[rng.random(depth.shape) < holes] = np.nan
    return depth


def published(depth):
    """The published node's steps, in its order."""
    crop = cv2.resize(depth[40:440, 120:520], (300, 300))
    crop = cv2.copyMakeBorder(crop, 1, 1, 1, 1, cv2.BORDER_DEFAULT)
    mask = np.isnan(crop).astype(np.uint8)
    crop[mask == 1] = 0
    scale = np.abs(crop).max()
    crop = cv2.inpaint(crop.astype(np.float32) / scale, mask, 1, cv2.INPAINT_NS)[1:-1, 1:-1] * scale
    return np.clip(crop - crop.mean(), -1, 1)


def test_without_holes_it_is_the_published_image():
    depth = scene()
    np.testing.assert_allclose(prepare(depth, centre_crop(depth.shape)).input, published(depth), atol=1e-6)


def test_with_holes_it_is_close_to_the_published_image():
    depth = scene(1)
    depth[200:204, 300:306] = np.nan
    np.testing.assert_allclose(prepare(depth, centre_crop(depth.shape)).input, published(depth), atol=2e-3)


def test_crop_is_in_the_middle_and_moves_up():
    assert centre_crop((480, 640)) == Crop(40, 120, 400)
    assert centre_crop((480, 640), 300, 40) == Crop(50, 170, 300)
    with pytest.raises(ValueError, match="does not fit 640 x 480"):
        centre_crop((480, 640), 500)
    with pytest.raises(ValueError, match="does not fit"):
        centre_crop((480, 640), 400, 41)


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.floats(0.0, 0.5))
def test_filling_touches_holes_only_and_stays_in_range(seed, share):
    """Reported in https://github.com/BerkeleyAutomation/gqcnn/issues/26: large areas without depth spoil grasps.
    Tried: images with holes.
    """
    depth = scene(seed, share)[:90, :120]
    valid = np.isfinite(depth)
    filled = fill_holes(depth, valid)
    np.testing.assert_allclose(filled[valid], depth[valid], rtol=1e-6)
    assert np.isfinite(filled).all()
    assert filled.min() >= depth[valid].min() - 0.02
    assert filled.max() <= depth[valid].max() + 0.02


@pytest.mark.parametrize("nothing", [np.nan, np.inf, 0.0, -1.0])
def test_a_image_without_a_reading_is_refused(nothing):
    with pytest.raises(ValueError, match="holds no reading"):
        prepare(np.full((480, 640), nothing), centre_crop((480, 640)))


def test_zeros_and_infinities_are_holes():
    depth = scene(2)
    depth[210:215, 310:315], depth[300:303, 300:303] = 0.0, np.inf
    image = prepare(depth, centre_crop(depth.shape))
    assert not image.valid.all()
    assert np.abs(image.input).max() < 0.2
    assert image.mean == pytest.approx(float(image.depth.mean()))
