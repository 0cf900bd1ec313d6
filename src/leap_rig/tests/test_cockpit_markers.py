"""What markers say is to be drawn in the cockpit's scene: all kinds that RViz draws, their life, and hostile ones."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leap_rig.cockpit.markers import MOST_MARKERS, MOST_POINTS, Form, Kind, MarkerStore


def vector(*numbers):
    return SimpleNamespace(**dict(zip("xyzw", numbers)))


def colour(*numbers):
    return SimpleNamespace(**dict(zip("rgba", numbers)))


def marker(kind=Kind.CUBE, number=0, **more):
    points = [vector(*point) for point in more.pop("points", ())]
    values = {
        "header": SimpleNamespace(frame_id="base"), "ns": "thing", "id": number, "type": int(kind), "action": 0,
        "pose": SimpleNamespace(position=vector(0.1, 0.2, 0.3), orientation=vector(0.0, 0.0, 0.0, 1.0)),
        "scale": vector(0.1, 0.2, 0.3), "color": colour(1.0, 0.5, 0.0, 1.0), "colors": [], "text": "",
        "lifetime": SimpleNamespace(to_sec=lambda: 0.0), "points": points,
    }  # fmt: skip
    return SimpleNamespace(**{**values, **more})


def drawn(*markers, now=0.0):
    store = MarkerStore()
    assert store.take(markers, now) == []
    return list(store.drawings(now).values())


@pytest.mark.parametrize(
    ("kind", "form", "shape"),
    [
        (Kind.ARROW, Form.ARROWS, (1, 2, 3)), (Kind.CUBE, Form.BOXES, (1, 3)), (Kind.SPHERE, Form.BALLS, (1, 3)),
        (Kind.CYLINDER, Form.CYLINDERS, (1, 3)), (Kind.LINE_STRIP, Form.LINES, (5, 2, 3)),
        (Kind.LINE_LIST, Form.LINES, (3, 2, 3)), (Kind.CUBE_LIST, Form.BOXES, (6, 3)),
        (Kind.SPHERE_LIST, Form.BALLS, (6, 3)), (Kind.POINTS, Form.POINTS, (6, 3)), (Kind.TEXT, Form.TEXT, (1, 3)),
        (Kind.TRIANGLES, Form.TRIANGLES, (2, 3, 3)),
    ],
)  # fmt: skip
def test_every_kind_is_drawn(kind, form, shape):
    six = [(0.1 * n, 0.0, 0.0) for n in range(6)]
    (drawing,) = drawn(marker(kind, points=[] if kind == Kind.ARROW else six, text="near"))
    assert drawing.form is form and drawing.points.shape == shape
    assert drawing.position == pytest.approx((0.1, 0.2, 0.3))
    assert drawing.colours.tolist() == [255, 127, 0]


def test_an_arrow_goes_from_point_to_point_or_along_x():
    (by_points,) = drawn(marker(Kind.ARROW, points=[(0.0, 0.0, 0.0), (0.0, 0.0, 0.5)]))
    assert by_points.points.tolist() == [[[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]]]
    (by_pose,) = drawn(marker(Kind.ARROW, scale=vector(0.4, 0.02, 0.02)))
    assert by_pose.points[0, 1] == pytest.approx((0.4, 0.0, 0.0))


def test_each_point_can_have_its_colour():
    (lines,) = drawn(
        marker(Kind.LINE_LIST, points=[(0, 0, 0), (1, 0, 0), (2, 0, 0)], colors=3 * [colour(0.0, 0.0, 1.0, 1.0)])
    )
    assert lines.colours.tolist() == [[[0, 0, 255], [0, 0, 255]]]


class TestLife:
    def test_a_marker_replaces_that_of_its_number_and_is_deleted(self):
        store = MarkerStore()
        store.take([marker(number=1), marker(number=2)], 0.0)
        store.take([marker(Kind.SPHERE, number=1), marker(number=2, action=2)], 1.0)
        assert [drawing.form for drawing in store.drawings(1.0).values()] == [Form.BALLS]
        store.take([marker(action=3), marker(number=5)], 2.0)
        assert list(store.drawings(2.0)) == [("thing", 5)]

    def test_a_marker_lasts_as_long_as_it_says(self):
        store = MarkerStore()
        store.take([marker(lifetime=SimpleNamespace(to_sec=lambda: 1.0))], 10.0)
        assert store.drawings(10.9) and not store.drawings(11.1)

    def test_what_looks_the_same_stays_the_same_object(self):
        store = MarkerStore()
        store.take([marker()], 0.0)
        (before,) = store.drawings(0.0).values()
        noise = SimpleNamespace(position=vector(0.1001, 0.2, 0.3), orientation=vector(1e-5, 0.0, 0.0, 1.0))
        store.take([marker(action=3), marker(pose=noise)], 1.0)
        assert store.drawings(1.0)["thing", 0] is before
        moved = SimpleNamespace(position=vector(0.103, 0.2, 0.3), orientation=vector(0.0, 0.0, 0.0, 1.0))
        store.take([marker(pose=moved)], 2.0)
        assert store.drawings(2.0)["thing", 0] is not before

    def test_several_messages_at_once_are_as_one_after_the_other(self):
        many = [marker(number=n % 3, action=a) for n, a in enumerate((0, 0, 0, 2, 0, 3, 0, 0, 2, 0, 0))]
        at_once, one_by_one = MarkerStore(), MarkerStore()
        at_once.take(many, 0.0)
        for one in many:
            one_by_one.take([one], 0.0)
        assert set(at_once.drawings(0.0)) == set(one_by_one.drawings(0.0)) != set()

    def test_hidden_namespaces_are_left_out(self):
        store = MarkerStore(hidden=("thing",))
        assert store.take([marker()], 0.0) == [] and not store.drawings(0.0)


class TestHostile:
    @pytest.mark.parametrize(
        "bad",
        [
            {"pose": SimpleNamespace(position=vector(math.nan, 0, 0), orientation=vector(0, 0, 0, 1))},
            {"pose": SimpleNamespace(position=vector(0, 0, 0), orientation=vector(0, math.inf, 0, 1))},
            {"pose": SimpleNamespace(position=vector(1e9, 0, 0), orientation=vector(0, 0, 0, 1))},
            {"scale": vector(math.inf, 1, 1)}, {"color": colour(math.nan, 0, 0, 1)},
            {"type": 10}, {"type": -1}, {"type": 99},
            {"type": 5, "points": [(0, 0, 0), (0, math.nan, 0)]},
            {"type": 5, "points": (MOST_POINTS + 2) * [(0, 0, 0)]},
            {"type": 5, "points": [(0, 0, 0)], "colors": [colour(math.nan, 0, 0, 1)]},
        ],
    )  # fmt: skip
    def test_is_left_out_and_said_once(self, bad):
        store = MarkerStore()
        found = store.take([marker(**bad), marker(number=7)], 0.0)
        assert len(found) == 1 and list(store.drawings(0.0)) == [("thing", 7)]
        assert store.take([marker(**bad)], 1.0) == []

    def test_too_many_are_cut_off(self):
        store = MarkerStore()
        assert len(store.take([marker(number=n) for n in range(MOST_MARKERS + 5)], 0.0)) == 1
        assert len(store.drawings(0.0)) == MOST_MARKERS

    def test_points_are_counted_over_a_whole_message(self):
        half = (MOST_POINTS // 2 + 2) * [(0.0, 0.0, 0.0)]
        store = MarkerStore()
        assert len(store.take([marker(Kind.POINTS, n, points=half) for n in range(3)], 0.0)) == 1
        assert len(store.drawings(0.0)) == 1

    def test_sentences_are_few_even_if_all_differ(self):
        store = MarkerStore()
        said = [store.take([marker(ns=f"thing {n}", type=99)], 0.0) for n in range(100)]
        assert sum(map(len, said)) == 20

    @given(st.integers(0, 11), st.lists(st.tuples(*3 * [st.floats(width=32)]), max_size=7), st.floats(width=32))
    def test_any_numbers_give_a_drawing_or_a_sentence(self, kind, points, size):
        store = MarkerStore()
        said = store.take([marker(kind, points=points, scale=vector(size, size, size), text="x")], 0.0)
        drawings = list(store.drawings(0.0).values())
        assert len(said) + len(drawings) <= 1
        assert all(np.isfinite(drawing.points).all() and np.isfinite(drawing.size).all() for drawing in drawings)


@pytest.mark.parametrize(
    "more",
    [
        {"color": colour(1.0, 1.0, 1.0, 0.0)}, {"type": 9, "text": " "}, {"type": 5, "points": [(0, 0, 0)]},
        {"type": 4, "points": [(0, 0, 0)]}, {"type": 7},
    ],
)  # fmt: skip
def test_what_shows_nothing_is_no_fault(more):
    assert drawn(marker(**more)) == []


def test_a_pose_of_zeros_does_not_turn():
    zeros = SimpleNamespace(position=vector(0.0, 0.0, 0.0), orientation=vector(0.0, 0.0, 0.0, 0.0))
    assert drawn(marker(pose=zeros))[0].orientation == (0.0, 0.0, 0.0, 1.0)
