"""What judges grasps: rectangles, heuristics and the lifting."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.poses import pose
from common.rotations import rotation_about
from grasping.lab.evaluation import trials
from grasping.lab.evaluation.lifting import lift
from grasping.lab.evaluation.trials import angle_between, is_right, judge, oracle, overlap, situation
from grasping.lab.programs.evaluate import calibration, table
from grasping.lab.synthetic.labels import Gripper
from grasping.lab.synthetic.scene import HeapScene, world_xml
from grasping.lab.synthetic.shapes import Geom
from grasping.network.depth_image import Crop, NetworkImage
from grasping.network.maps import Peak

DOWN = np.diag([1.0, -1.0, -1.0])


@given(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0))
def test_angles_between_lines(a, b):
    d = angle_between(a, b)
    assert 0.0 <= d <= 0.5 * np.pi + 1e-9
    assert d == pytest.approx(angle_between(b, a), abs=1e-9)
    assert d == pytest.approx(angle_between(a + np.pi, b), abs=1e-6)


def test_overlap_of_rectangles():
    a = Peak(100, 100, 1.0, 0.3, 40.0)
    assert overlap(a, a) == pytest.approx(1.0, abs=1e-3)
    assert overlap(a, a._replace(row=200)) == 0.0
    level = a._replace(angle=0.0)
    assert overlap(level, level._replace(column=120)) == pytest.approx(1.0 / 3.0, abs=1e-3)
    assert overlap(level, level._replace(width=0.0)) == 0.0
    # The angle is anticlockwise: moved along itself, up and right, a rectangle still touches; the other way less.
    up = a._replace(angle=0.7)
    assert overlap(up, up._replace(row=87, column=115)) > overlap(up, up._replace(row=113, column=115)) + 0.05


def test_rectangle_metric_needs_angle_and_place():
    label = Peak(100, 100, 1.0, np.radians(80.0), 40.0)
    assert is_right(label._replace(angle=np.radians(-80.0)), [label])
    assert not is_right(label._replace(angle=np.radians(-65.0)), [label])
    assert not is_right(label._replace(column=140), [label])
    assert not is_right(label, [])


def bar_image():
    """A bar 60 x 20 pixels, 50 mm high, at +30 degrees on a sloping table."""
    row, column = np.mgrid[:300, :300].astype(float)
    a = np.radians(30.0)
    along = (column - 170) * np.cos(a) - (row - 130) * np.sin(a)
    across = (column - 170) * np.sin(a) + (row - 130) * np.cos(a)
    depth = 0.7 + 1e-4 * row
    depth[(np.abs(along) < 30) & (np.abs(across) < 10)] -= 0.05
    depth = depth.astype(np.float32)
    return NetworkImage(Crop(0, 0, 400), depth - depth.mean(), depth, depth > 0.0, float(depth.mean()))


@pytest.mark.parametrize("name", ["principal axis", "edge pair"])
def test_heuristics_grasp_a_bar_across(name):
    found = trials.HEURISTICS[name](bar_image(), 60.0, np.random.default_rng(1))
    assert np.hypot(found.row - 130, found.column - 170) < 32.0
    assert angle_between(found.angle, np.radians(-60.0)) < np.radians(12.0)
    assert 20.0 < found.width < 42.0


def test_random_pixel_is_on_the_object():
    image = bar_image()
    for seed in range(10):
        found = trials.random_pixel(image, 60.0, np.random.default_rng(seed))
        assert image.depth[found.row, found.column] < 0.69


@pytest.mark.parametrize("name", trials.HEURISTICS)
def test_heuristics_find_nothing_on_a_bare_table(name):
    depth = np.full((300, 300), 0.7, np.float32)
    image = NetworkImage(Crop(0, 0, 400), depth * 0, depth, depth > 0.0, 0.7)
    assert trials.HEURISTICS[name](image, 60.0, np.random.default_rng(1)) is None


def box_scene():
    objects = ((Geom("box", (0.05, 0.015, 0.02)),),)
    state = np.array([0.0, 0.0, 0.02, 1.0, 0.0, 0.0, 0.0])
    return HeapScene(world_xml(objects), state, objects, ("box",))


@pytest.mark.parametrize(
    ("R", "place", "lifted"),
    [
        (DOWN @ rotation_about(2, 0.5 * np.pi), (0.0, 0.0, 0.04), True),
        (DOWN, (0.0, 0.0, 0.04), False),
        (DOWN @ rotation_about(2, 0.5 * np.pi), (0.2, 0.0, 0.04), False),
    ],
    ids=["across", "along, where it is too long", "beside"],
)
def test_lifting_a_bar(R, place, lifted):
    trial = lift(box_scene(), pose(R, place), 0.05, Gripper(), 0.5)
    assert trial.lifted == lifted
    assert (trial.rise > 0.1) == lifted


def test_the_oracle_lifts_what_it_labels():
    of = situation("test", 2, 1)
    chosen = oracle(of)
    outcome = judge(of, chosen)
    assert outcome.rectangle
    assert outcome.lifted
    assert judge(of, chosen) == outcome
    assert not judge(of, None).found


def test_table_of_results():
    rows = [
        {"scene": i, "objects": 1 if i % 2 else 4, "method": "oracle", "lifted": str(i < 9), "rectangle": "True"}
        for i in range(10)
    ]
    assert "| oracle | 80 (38 to 96), n = 5 | 100 (57 to 100), n = 5 | 100" in table(rows, ["oracle", "none"])
    assert "| none | - | - | - | - |" in table(rows, ["oracle", "none"])


def test_calibration_counts_each_grasp_once():
    rows = [{"method": "net", "quality": q, "lifted": q > 0.35} for q in (-0.1, 0.3, 0.39, 0.55, 0.6, 0.9)]
    text = calibration(rows, ["net"])
    cells = [c.strip() for c in text.splitlines()[-1].split("|")[2:-1]]
    assert [c.rsplit(" ", 1)[-1] for c in cells] == ["1", "2", "-", "1", "2"]
    assert cells[1].startswith("50 (")
