"""The table under the things: seen past them, whatever the camera's lean and focal length."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.camera_model import pinhole
from grasping.network.depth_image import Crop, prepare, table_depth

SIDE = 400


def leaning_table(focal: float, distance: float, lean_x: float, lean_y: float) -> np.ndarray:
    """Returns the depth of a bare table whose normal leans, shape (SIDE, SIDE), float32 [m]."""
    centre = 0.5 * (SIDE - 1)
    camera = pinhole("camera", SIDE, SIDE, [[focal, 0.0, centre], [0.0, focal, centre], [0.0, 0.0, 1.0]])
    column, row = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    rays = camera.rays(np.stack([column, row], axis=-1).astype(float))
    normal = np.array([np.tan(lean_x), np.tan(lean_y), 1.0])
    return (distance / (rays @ normal)).astype(np.float32)


@settings(max_examples=20)
@given(st.floats(450.0, 700.0), st.floats(0.5, 0.9), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.integers(0, 99))
def test_it_is_seen_past_things_noise_and_holes(focal, distance, lean_x, lean_y, seed):
    rng = np.random.default_rng(seed)
    table = leaning_table(focal, distance, lean_x, lean_y)
    depth = 1.0 / (1.0 / table + rng.normal(0.0, 0.002, table.shape))
    row, column = rng.integers(0, SIDE - 160, 2)
    depth[row : row + 160, column : column + 160] -= 0.06
    depth[rng.random(table.shape) < 0.1] = np.nan
    found = table_depth(prepare(depth, Crop(0, 0, SIDE)))
    wanted = prepare(table, Crop(0, 0, SIDE)).depth
    np.testing.assert_allclose(found, wanted, atol=0.004)
    assert found.dtype == np.float32


def test_where_no_plane_is_seen_it_is_the_mean():
    depth = np.full((SIDE, SIDE), np.nan)
    depth[0, 0] = 0.7
    image = prepare(depth, Crop(0, 0, SIDE))
    np.testing.assert_array_equal(table_depth(image), np.full_like(image.depth, image.mean))


def test_a_table_seen_edge_on_ends_at_the_horizon():
    table = leaning_table(570.0, 0.7, 0.0, -1.4)
    depth = np.where((table > 0.0) & (table < 8.0), table, np.nan)
    found = table_depth(prepare(depth, Crop(0, 0, SIDE)))
    assert found.min() > 0.0
    assert found.max() == pytest.approx(10.0)
