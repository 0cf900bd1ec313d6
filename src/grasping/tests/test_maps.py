"""Smoothing and peaks: laws, and the published blur written out."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from grasping.network.maps import Maps, Smoothing, gaussian, peaks, smoothed


def blurred(image, sigma):
    """SciPy's gaussian_filter, written out."""
    radius = int(4.0 * sigma + 0.5)
    kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    kernel /= kernel.sum()
    for axis in (0, 1):
        padded = np.pad(image, [(radius, radius) if a == axis else (0, 0) for a in (0, 1)], mode="symmetric")
        image = np.apply_along_axis(np.convolve, axis, padded, kernel, "valid")
    return image


@pytest.mark.parametrize("sigma", [1.0, 2.0, 5.0])
def test_blur_is_scipys(sigma):
    image = np.random.default_rng(1).standard_normal((60, 70)).astype(np.float32)
    np.testing.assert_allclose(gaussian(image, sigma), blurred(image.astype(float), sigma), atol=1e-5)


def output(angle, quality=None, width=0.4):
    shape = angle.shape
    quality = np.ones(shape) if quality is None else quality
    maps = [quality, np.cos(2.0 * angle), np.sin(2.0 * angle), np.full(shape, width)]
    return np.stack(maps).astype(np.float32)


def test_angle_is_not_spoilt_where_it_jumps():
    angle = np.full((40, 40), np.radians(88.0))
    angle[:, 20:] = np.radians(-88.0)
    found = smoothed(output(angle), np.ones((40, 40), bool), Smoothing()).angle
    assert np.degrees(np.abs(found)).min() > 87.0


@given(st.floats(-1.5, 1.5))
@settings(max_examples=20)
def test_constant_maps_stay(angle):
    maps = smoothed(output(np.full((30, 30), angle)), np.ones((30, 30), bool), Smoothing())
    np.testing.assert_allclose(maps.angle, angle, atol=1e-3)
    np.testing.assert_allclose(maps.width, 60.0, rtol=1e-4)
    np.testing.assert_allclose(maps.quality, 1.0, rtol=1e-4)


def test_missing_pixels_have_no_quality():
    valid = np.ones((60, 60), bool)
    valid[:, :30] = False
    maps = smoothed(output(np.zeros((60, 60))), valid, Smoothing())
    assert maps.quality[:, :8].max() == 0.0
    assert maps.quality[:, -8:].min() > 0.99


@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(1, 6))
@settings(max_examples=30)
def test_peaks_are_those_of_a_maximum_over_the_whole_image(seed, distance, count):
    random = np.random.default_rng(seed)
    quality = gaussian(random.random((60, 70), dtype=np.float32), random.uniform(0.0, 3.0))
    quality = np.round(quality, random.integers(1, 6))  # with plateaus
    best = quality == cv2.dilate(quality, np.ones((2 * distance + 1, 2 * distance + 1), np.uint8))
    inner = np.zeros_like(best)
    inner[distance:-distance, distance:-distance] = True
    rows, columns = np.nonzero(best & inner & (quality > 0.3))
    wanted = []
    for i in np.argsort(-quality[rows, columns], kind="stable"):
        if all(max(abs(rows[i] - r), abs(columns[i] - c)) > distance for r, c in wanted):
            wanted.append((rows[i], columns[i]))
    found = peaks(Maps(quality, quality, quality), count, distance, 0.3)
    assert [(p.row, p.column) for p in found] == wanted[:count]
