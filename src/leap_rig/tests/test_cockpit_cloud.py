"""A point cloud as the cockpit draws it."""

from types import SimpleNamespace

import numpy as np
import pytest

from leap_rig.cockpit.cloud import MOST_POINTS, NEARER, CloudFault, thinned

POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("pad", "<f4"), ("rgb", "<u4"), ("rest", "<f4", 3)])


def cloud(rows=6, columns=8, order="<", **more):
    points = np.zeros((rows, columns), dtype=POINT.newbyteorder(order))
    points["x"], points["y"] = 0.01 * np.arange(columns), 0.01 * np.arange(rows)[:, None]
    points["z"], points["rgb"] = 1.0, 0x00FF8010
    fields = [SimpleNamespace(name=name, offset=POINT.fields[name][1], datatype=7) for name in ("x", "y", "z", "rgb")]
    values = {
        "fields": fields, "height": rows, "width": columns, "point_step": POINT.itemsize, "is_bigendian": order == ">",
        "row_step": columns * POINT.itemsize, "data": points.tobytes(),
    }  # fmt: skip
    return SimpleNamespace(**{**values, **more})


@pytest.mark.parametrize("order", ["<", ">"])
def test_points_have_place_and_colour(order):
    points, colours = thinned(cloud(order=order))
    assert points.shape == colours.shape == (48, 3)
    assert points[-1] == pytest.approx(NEARER * np.array([0.07, 0.05, 1.0])) and points.dtype == np.float32
    assert colours[0].tolist() == [0xFF, 0x80, 0x10]


def test_many_points_are_thinned_alike_each_time():
    points, _ = thinned(cloud(480, 640))
    assert 0.3 * MOST_POINTS < len(points) <= MOST_POINTS
    assert np.array_equal(points, thinned(cloud(480, 640))[0])
    assert 0 < len(thinned(cloud(1, 100_000))[0]) <= MOST_POINTS


def test_points_that_are_not_seen_are_left_out():
    values = np.frombuffer(bytearray(cloud().data), dtype=POINT).copy()
    values["z"][:5], values["x"][5:8] = np.nan, np.inf
    assert len(thinned(cloud(data=values.tobytes()))[0]) == 40


def test_an_empty_cloud_has_no_points():
    assert len(thinned(cloud(0, 0))[0]) == 0


@pytest.mark.parametrize(
    "more",
    [
        {"fields": []}, {"data": b"12"}, {"height": 7}, {"width": 9}, {"point_step": 4}, {"point_step": 0},
        {"row_step": 1}, {"width": 2**31, "row_step": 2**32}, {"height": 2**31},
    ],
)  # fmt: skip
def test_bytes_that_are_no_such_cloud_are_refused(more):
    with pytest.raises(CloudFault):
        thinned(cloud(**more))


def test_a_field_of_another_type_is_refused():
    bad = cloud()
    bad.fields[1].datatype = 8
    with pytest.raises(CloudFault):
        thinned(bad)
