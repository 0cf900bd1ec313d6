"""Grasp rectangles in depth images: their geometry, the folders they come from, and the maps that networks learn."""

from __future__ import annotations

import json
import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.errors import RigError
from grasping.lab.dataset import labelled_images as li
from grasping.lab.evaluation.trials import is_right
from grasping.network.depth_image import Crop
from grasping.network.maps import WIDTH_SCALE_PX
from grasping.refinement.taste import half_turn

PIXELS = st.floats(0.0, 400.0)
RECTANGLES = st.builds(
    li.GraspRectangle, st.floats(120.0, 280.0), st.floats(120.0, 280.0), st.floats(-1.57, 1.57), st.floats(8.0, 80.0),
    st.floats(8.0, 60.0),
)  # fmt: skip


@given(PIXELS, PIXELS, PIXELS, PIXELS)
def test_the_line_between_two_fingers_has_their_distance_middle_and_direction(ax, ay, bx, by):
    if math.hypot(ax - bx, ay - by) < 1e-3:
        return
    grasp = li.GraspRectangle.between((ax, ay), (bx, by), 10.0)
    other = li.GraspRectangle.between((bx, by), (ax, ay), 10.0)
    assert (grasp.row, grasp.column, grasp.opening) == (other.row, other.column, other.opening)
    assert abs(half_turn(grasp.angle - other.angle)) < 1e-9
    corners = grasp.corners()
    fingers = 0.5 * (corners[[0, 1]] + corners[[3, 2]])
    wanted = np.array([[ax, ay], [bx, by]])
    assert min(np.abs(fingers - order).max() for order in (wanted, wanted[::-1])) < 1e-6


@given(RECTANGLES)
def test_a_rectangle_of_cornell_is_the_one_that_was_written(tmp_path_factory, grasp):
    folder = tmp_path_factory.mktemp("cornell")
    lines = [f"{x!r} {y!r}" for x, y in grasp.corners().tolist()]
    text = "\n".join([*lines, "1 1", "NaN NaN", "1 9", "9 9", ""])
    (folder / "pcd0100cpos.txt").write_text(text)
    (image,) = li.read(folder)
    (found,) = image.grasps
    assert image.name == "pcd0100"
    assert (found.row, found.column, found.opening, found.breadth) == pytest.approx(
        (grasp.row, grasp.column, grasp.opening, grasp.breadth), abs=1e-6
    )
    assert abs(half_turn(found.angle - grasp.angle)) < 1e-6 or abs(found.angle) > 1.57


def test_a_point_cloud_of_cornell_is_its_distances(tmp_path):
    head = "# .PCD v.7\nFIELDS x y z rgb index\nPOINTS 2\nDATA ascii\n"
    (tmp_path / "pcd0100.txt").write_text(head + "300.0 0.0 400.0 1.0 0\n0.0 0.0 700.0 1.0 641\n")
    (tmp_path / "pcd0100cpos.txt").write_text("10 10\n20 10\n20 15\n10 15\n")
    (image,) = li.read(tmp_path)
    depth = image.depth()
    assert depth.shape == (480, 640) and np.isfinite(depth).sum() == 2
    assert depth[0, 0] == pytest.approx(0.5) and depth[1, 1] == pytest.approx(0.7)
    assert image.grasps == (li.GraspRectangle(12.5, 15.0, 0.0, 10.0, 5.0),)
    (tmp_path / "pcd0100.txt").write_text(head + "300.0 0.0 400.0 1.0 307200\n")
    with pytest.raises(RigError, match="not a point cloud"):
        image.depth()


def test_angles_of_jacquard_are_clockwise_degrees_and_things_are_their_models(tmp_path):
    (tmp_path / "thing").mkdir()
    (tmp_path / "thing" / "3_abc_grasps.txt").write_text("512.5;300;30;80;20\n512.5;300;-90;80;20\n")
    cv2.imwrite(str(tmp_path / "thing" / "3_abc_perfect_depth.tiff"), np.full((1024, 1024), 1.5, np.float32))
    (image,) = li.read(tmp_path)
    assert image.thing == "abc" and image.depth()[3, 4] == 1.5
    assert [grasp.angle for grasp in image.grasps] == pytest.approx([-math.pi / 6.0, -math.pi / 2.0])
    assert (image.grasps[0].row, image.grasps[0].column) == (300.0, 512.5)


@given(st.lists(RECTANGLES, max_size=5))
def test_own_labels_are_read_as_written(tmp_path_factory, grasps):
    path = tmp_path_factory.mktemp("own") / "cup.grasps.json"
    li.write_grasps(path, grasps)
    assert li.read_grasps(path) == grasps
    assert [p.name for p in path.parent.iterdir()] == [path.name]


GOOD = {"row": 1.0, "column": 2.0, "angle": 0.1, "opening": 30.0, "breadth": 9.0}


@pytest.mark.parametrize(
    "content",
    [
        "", "[]", "{}", '{"schema": 2, "grasps": []}', '{"schema": 1, "grasps": [{}]}', '{"schema": 1, "grasps": 7}',
        json.dumps({"schema": 1, "grasps": [{**GOOD, "row": float("nan")}]}),
        json.dumps({"schema": 1, "grasps": [{**GOOD, "opening": 0.0}]}),
        json.dumps({"schema": 1, "grasps": [{**GOOD, "angle": "0.1"}]}),
        json.dumps({"schema": 1, "grasps": [{**GOOD, "breadth": True}]}),
        json.dumps({"schema": 1, "grasps": [{**GOOD, "more": 1.0}]}),
        "[" * 100_000,
    ],
)  # fmt: skip
def test_a_bad_label_file_is_refused_by_name(tmp_path, content):
    path = tmp_path / "cup.grasps.json"
    path.write_text(content)
    (tmp_path / "cup.npy").write_bytes(b"")
    with pytest.raises(li.LabelError, match=r"cup\.grasps\.json"):
        li.read(tmp_path)


@pytest.mark.parametrize(
    ("name", "text"),
    [("pcd1cpos.txt", "1 2\n3 4\n5 6\n"), ("pcd1cpos.txt", "1 2\n1 2\n1 2\n1 2\n"), ("0_a_grasps.txt", "1;2;3;4\n")],
)
def test_bad_published_labels_are_refused_by_name(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(li.LabelError, match=name):
        li.read(tmp_path)


def test_a_folder_without_labels_names_all_three_kinds(tmp_path):
    with pytest.raises(RigError, match=r"label_grasps\.py.*pcd\*cpos\.txt.*_grasps\.txt"):
        li.read(tmp_path)


def image_of(*grasps, shape=(480, 640)):
    return li.LabelledImage("image", "image", lambda: np.full(shape, 0.7, np.float32), grasps)


@given(RECTANGLES)
def test_the_middle_of_a_rectangle_teaches_its_angle_and_opening_and_its_ends_are_no_grasp(grasp):
    made = li.sample(image_of(grasp), 400)
    crop = li.crop_around([grasp], (480, 640), 400)
    here = li.in_network_image(grasp, crop)
    row, column = round(here.row), round(here.column)
    assert made.quality[row, column] == 255 and made.known.all()
    assert abs(half_turn(made.angle[row, column] * math.pi / 256.0 - grasp.angle)) < math.pi / 256.0
    assert made.width[row, column] / 255.0 * WIDTH_SCALE_PX == pytest.approx(0.75 * grasp.opening, abs=0.31)
    ends = here.corners(0.9)
    assert all(made.quality[round(y), round(x)] == 0 for x, y in ends if here.opening > 12.0)
    assert made.quality.sum() / 255.0 < here.opening / 3.0 * here.breadth * 1.3 + 4.0 * (here.opening + here.breadth)


def test_where_two_rectangles_overlap_the_first_one_teaches():
    first, second = (li.GraspRectangle(200.0, 200.0, angle, 40.0, 30.0) for angle in (0.0, 1.0))
    for order, angle in (((first, second), 0.0), ((second, first), 1.0)):
        made = li.sample(image_of(*order), 400)
        assert made.angle[150, 150] == pytest.approx(round(256.0 * angle / math.pi), abs=1)


def test_the_window_is_inside_the_image_and_about_the_grasps():
    corner = li.GraspRectangle(2.0, 630.0, 0.0, 9.0, 9.0)
    assert li.crop_around([corner], (480, 640), 400) == Crop(0, 240, 400)
    assert li.crop_around([corner], (480, 640), 1024) == Crop(0, 160, 480)
    middle = li.GraspRectangle(240.0, 320.0, 0.0, 9.0, 9.0)
    assert li.crop_around([middle], (480, 640), 400) == Crop(40, 120, 400)


def test_an_image_that_cannot_teach_is_refused():
    far = [li.GraspRectangle(r, c, 0.0, 9.0, 9.0) for r, c in ((0.0, 0.0), (479.0, 639.0))]
    with pytest.raises(RigError, match="none of its 2 grasps"):
        li.sample(image_of(*far), 100)
    blind = li.LabelledImage("dark", "dark", lambda: np.zeros((480, 640), np.float32), tuple(far))
    with pytest.raises(RigError, match="dark: the depth image holds no reading"):
        li.sample(blind, 400)


@given(RECTANGLES)
def test_a_labelled_grasp_is_right_by_the_rectangle_metric_and_one_turned_is_not(grasp):
    (label,) = li.labels(image_of(grasp), Crop(0, 0, 400))
    assert is_right(label, [label], 0.9)
    assert not is_right(label._replace(angle=half_turn(label.angle + 0.6)), [label], 0.1)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("depth.png", lambda path: cv2.imwrite(str(path), np.full((4, 5), 1500, np.uint16))),
        ("depth.npy", lambda path: np.save(path, np.full((4, 5), 1.5))),
        ("depth.tiff", lambda path: cv2.imwrite(str(path), np.full((4, 5), 1.5, np.float32))),
    ],
)
def test_depth_is_read_in_metres(tmp_path, name, write):
    write(tmp_path / name)
    np.testing.assert_allclose(li.read_depth(tmp_path / name), np.full((4, 5), 1.5))
    assert li.depth_images(tmp_path) == [tmp_path / name]


@pytest.mark.parametrize(
    ("name", "content"),
    [("depth.png", b"no image"), ("depth.npy", b""), ("depth.npy", b"\x93NUMPY"), ("depth.tiff", b"II*\0")],
)
def test_what_is_no_depth_image_is_refused_by_name(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RigError, match=name):
        li.read_depth(tmp_path / name)


@given(st.integers(60, 420), st.integers(60, 580), st.integers(200, 480))
def test_a_label_lies_on_what_it_was_drawn_on(row, column, side):
    depth = np.full((480, 640), 0.7, np.float32)
    depth[row - 20 : row + 21, column - 20 : column + 21] = 0.65
    grasp = li.GraspRectangle(float(row), float(column), 0.0, 60.0, 30.0)
    made = li.sample(li.LabelledImage("square", "square", lambda: depth, (grasp,)), side)
    square, label = (np.argwhere(mask).mean(axis=0) for mask in (made.depth < -0.02, made.quality > 0))
    np.testing.assert_allclose(label, square, atol=0.8)
