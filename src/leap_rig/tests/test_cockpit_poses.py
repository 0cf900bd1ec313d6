"""Poses of tf's frames, and where the labels of the cockpit's scene stand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.poses import pose
from common.rotations import quaternion_from_rotation, rotation_from_quaternion, rotation_from_zyx
from leap_rig.cockpit.frame_poses import FramePoses, angle_between, compose, differ, turned
from leap_rig.cockpit.labels import ANCHORS, EDGE_PX, LETTER_PX, LINE_PX, Eye, Label, anchors

lengths = st.floats(-2.0, 2.0)
angles = st.floats(-3.0, 3.0)


@st.composite
def poses(draw):
    R = rotation_from_zyx(draw(angles), draw(angles), draw(angles))
    return (draw(lengths), draw(lengths), draw(lengths), *quaternion_from_rotation(R).tolist())


def matrix(seven):
    return pose(rotation_from_quaternion(seven[3:]), seven[:3])


class TestPoses:
    @given(poses(), poses())
    def test_are_composed_as_matrices_are(self, a, b):
        assert matrix(compose(a, b)) == pytest.approx(matrix(a) @ matrix(b), abs=1e-9)

    @given(poses(), st.tuples(lengths, lengths, lengths))
    def test_turn_vectors(self, a, v):
        assert turned(a[3:], v) == pytest.approx(rotation_from_quaternion(a[3:]) @ v, abs=1e-9)

    @given(poses(), st.floats(0.0, 3.0))
    def test_have_an_angle_between(self, a, angle):
        b = compose(a, (0.0, 0.0, 0.0, 0.0, 0.0, math.sin(0.5 * angle), math.cos(0.5 * angle)))
        assert angle_between(a, b) == pytest.approx(angle, abs=1e-6)

    def test_differ_where_an_eye_sees_it(self):
        assert not differ((0.0, 0.0, 0.0), (4e-4, 0.0, 0.0)) and differ((0.0, 0.0, 0.0), (6e-4, 0.0, 0.0))
        q = (0.0, 0.6, 0.0, 0.8)
        assert not differ(q, tuple(-part for part in q))
        assert differ(q, (0.002, 0.6, 0.0, 0.8))


class TestFrames:
    def test_hang_on_a_root(self):
        frames = FramePoses()
        frames.put("world", "base", (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), 1.0)
        frames.put("base", "tool", (0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0), 1.0)
        assert frames.chain("tool") == ("world", (1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        assert frames.relative("base", "tool") is not None and frames.relative("world", "tool") is None

    @given(poses(), poses())
    def test_are_seen_from_the_base_of_each_arm_however_it_stands(self, base, tool):
        frames = FramePoses()
        frames.put("world", "left/base", base, 1.0)
        frames.put("world", "tool", tool, 1.0)
        expected = np.linalg.inv(matrix(base)) @ matrix(tool)
        assert matrix(frames.between("left/base", "tool")) == pytest.approx(expected, abs=1e-9)
        assert frames.between("left/base", "elsewhere") is None

    def test_in_a_circle_have_no_root(self):
        frames = FramePoses()
        frames.put("a", "b", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), 0.0)
        frames.put("b", "a", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), 0.0)
        assert frames.chain("a") is None

    def test_without_end_are_not_all_kept(self):
        frames = FramePoses()
        for number in range(3000):
            frames.put("a", str(number), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), 5.0)
        frames.put("a", "1", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), 6.0)
        assert frames.received("2999") == 0.0 and frames.received("1") == 6.0


AHEAD = Eye((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), math.radians(60.0), 800.0, 600.0)  # looks along z


def box(label, anchor, eye=AHEAD):
    x, y = eye.pixel(label.point)
    width, height = len(label.text) * LETTER_PX + 2 * EDGE_PX, LINE_PX + 2 * EDGE_PX
    right, down = ANCHORS[anchor]
    return x + right * width, y + down * height, width, height


class TestLabels:
    @given(st.lists(st.tuples(lengths, lengths, st.floats(-1.0, 4.0), st.integers(1, 30)), max_size=12))
    def test_never_cover_each_other_nor_leave_the_view(self, things):
        labels = [Label(n, letters * "m", (x, y, z)) for n, (x, y, z, letters) in enumerate(things)]
        found = anchors(labels, AHEAD)
        boxes = [box(label, found[label.key]) for label in labels if label.key in found]
        for n, (x, y, w, h) in enumerate(boxes):
            assert x >= 0 and y >= 0 and x + w <= 800 and y + h <= 600
            for x2, y2, w2, h2 in boxes[n + 1 :]:
                assert x + w <= x2 or x2 + w2 <= x or y + h <= y2 or y2 + h2 <= y

    @pytest.mark.parametrize(("point", "anchor"), [((0.33, 0.3, 1.0), "bottom-right"), ((0.6, 0.5, 1.0), None)])
    def test_leave_the_image_of_the_camera_free(self, point, anchor):
        label = Label(0, "tool", point)
        assert anchors([label], AHEAD) == {0: "bottom-center"}
        assert anchors([label], AHEAD, inset=True).get(0) == anchor

    def test_at_one_point_stand_beside_each_other(self):
        found = anchors([Label(n, "desired tool", (0.0, 0.0, 2.0)) for n in range(3)], AHEAD)
        assert len(found) == 3 and len(set(found.values())) == 3

    def test_the_first_has_the_first_choice(self):
        labels = [Label("first", "a", (0.0, 0.0, 2.0)), Label("second", "b", (0.0, 0.0, 2.0))]
        assert anchors(labels, AHEAD)["first"] == "bottom-center"
        assert anchors(labels[::-1], AHEAD)["second"] == "bottom-center"

    def test_what_is_behind_the_eye_is_not_seen(self):
        assert AHEAD.pixel((0.0, 0.0, -1.0)) is None and anchors([Label(0, "a", (0.0, 0.0, -1.0))], AHEAD) == {}

    def test_a_pixel_is_where_a_pinhole_shows_it(self):
        assert AHEAD.pixel((0.0, 0.0, 3.0)) == (400.0, 300.0)
        right = AHEAD.pixel((1.0, 0.0, 1.0 / math.tan(math.radians(30.0))))
        assert right == pytest.approx((700.0, 300.0)) and np.isfinite(right).all()
