"""Motions that were taught by hand: what a file of one must be, and which way points are kept of a path."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from common.errors import RigError
from iiwa_kinematics.robot_model import robot_model
from kuka_control.model.taught import TaughtArm, content_of, points_of, reduced

ARM = TaughtArm("LBR7R800", "MF_elektrisch", "")
MODEL = robot_model(ARM.robot, ARM.flange)
POINTS = np.array([[0.1, 0.2, 0.3, -1.0, 0.0, 0.5, 1.25], [0.0] * 7, [0.4] * 7])
TEXT = yaml.safe_dump(content_of(POINTS, ARM), sort_keys=False)


def test_what_was_written_is_read():
    np.testing.assert_array_equal(points_of(yaml.safe_load(TEXT), ARM, MODEL), POINTS)


@given(st.integers(0, len(TEXT.rstrip()) - 1))
def test_a_torn_file_is_refused_wherever_it_ends(length):
    try:
        content = yaml.safe_load(TEXT[:length])
    except yaml.YAMLError:
        return
    with pytest.raises(RigError):
        points_of(content, ARM, MODEL)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"format": "a film"}, "no taught motion"),
        ({"version": 2}, "its version is 2, but this program reads 1"),
        ({"robot": "LBR14R820"}, "taught to robot 'LBR14R820', but this arm has 'LBR7R800'"),
        ({"name": "left"}, "taught to name 'left'"),
        ({"points": [], "count": 0}, "it is torn"),
        ({"points": [[0.0] * 6], "count": 1}, "seven finite angles"),
        ({"points": [[0.0] * 6 + [float("nan")]], "count": 1}, "seven finite angles"),
        ({"points": [[0.0] * 6 + [True]], "count": 1}, "seven finite angles"),
        ({"points": [[0.0] * 6 + [9.0]], "count": 1}, "way point 1: "),
    ],
)
def test_a_file_that_cannot_be_meant_is_refused(changes, sentence):
    with pytest.raises(RigError, match=sentence):
        points_of({**content_of(POINTS, ARM), **changes}, ARM, MODEL)


def test_a_path_keeps_its_corners():
    straight = np.linspace(0.0, 1.0, 50)[:, None] * np.ones(7)
    back = straight[::-1] * [1, 1, 1, 1, 1, 1, 0.5]
    path = np.concatenate([straight, back])
    np.testing.assert_array_equal(reduced(path)[[0, 1, -1]], path[[0, 49, -1]])
    assert len(reduced(path)) <= 4


@given(st.integers(1, 60), st.integers(0, 2**32 - 1))
def test_no_point_of_a_path_is_far_from_what_is_kept(count, seed):
    path = np.cumsum(np.random.default_rng(seed).normal(0.0, 0.02, (count, 7)), axis=0)
    kept = reduced(path, 0.05)
    np.testing.assert_array_equal(kept[[0, -1]], path[[0, -1]])
    for q in path:
        spans = [(a, b - a) for a, b in zip(kept, kept[1:])] or [(kept[0], np.zeros(7))]
        near = [q - a - np.clip((q - a) @ d / max(d @ d, 1e-12), 0.0, 1.0) * d for a, d in spans]
        assert min(np.max(np.abs(each)) for each in near) <= 0.05 + 1e-9
