"""Grasp rectangles in depth images: their geometry, the folders they come from, and the maps that networks learn."""

from __future__ import annotations

import json
import math
import re

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.errors import RigError
from grasping.lab.dataset import labelled_images as li
from grasping.network.depth_image import Crop
from grasping.network.maps import WIDTH_SCALE_PX, half_turn

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
    (folder / "pcd0100.txt").touch()
    (image,), _ = li.read(folder)
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
    (image,), _ = li.read(tmp_path)
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
    (image,), _ = li.read(tmp_path)
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


SQUARE = "10 10\n40 10\n40 25\n10 25\n"
LINE = "300;200;30;80;20\n"
GRASPS = json.dumps({"schema": 1, "grasps": [GOOD]})
OWN = ("{}.grasps.json", "{}.npy", GRASPS, {
    GRASPS[:-9]: "not a file of labelled grasps",
    GRASPS.replace("30.0", "0.062"): "must be at least 1 px: they are in pixels, not in metres",
    GRASPS.replace("30.0", "0.0"): "must be positive",
    GRASPS.replace("0.1", "45.0"): "angle is 45 rad and must be within 2 pi",
    '{"schema": 1, "grasps": []}': "holds no grasp",
    **dict.fromkeys((
        "[]", "{}", '{"schema": 2, "grasps": []}', '{"schema": 1, "grasps": [{}]}', '{"schema": 1, "grasps": 7}',
        GRASPS.replace("1.0,", "NaN,"), GRASPS.replace("0.1", '"0.1"'), GRASPS.replace("9.0", "true"),
        GRASPS.replace("9.0", '9.0, "more": 1.0'), "[" * 100_000,
    ), "not a file of labelled grasps"),
})  # fmt: skip
SETS = {  # good label file, its image, a good text; bad texts and what is said of them
    "own": OWN,
    "cornell": ("pcd{}cpos.txt", "pcd{}d.tiff", SQUARE, {
        "1 2\n3 4\n5 6\n": "does not hold four corners",
        SQUARE + "10 10\n40": "does not hold four corners",
        SQUARE.replace("40 25", "40 x"): "does not hold four corners",
        "1 2\n1 2\n1 2\n1 2\n": "must be positive",
        "NaN NaN\n" * 4: "holds no grasp",
        "0.10 0.10\n0.40 0.10\n0.40 0.25\n0.10 0.25\n": "at least 1 px",
    }),
    "jacquard": ("0_{}_grasps.txt", "0_{}_perfect_depth.tiff", LINE, {
        LINE + "300;200;30": "does not hold five numbers",
        LINE.replace("80", "nan"): "must be a number",
    }),
}  # fmt: skip
EVERY_SET = {"": "holds no grasp|not a file", "\0\0": "does not hold|not a file", "\xe4": "does not hold|not a file"}


def write_image(path, shape=(480, 640)):
    depth = np.full(shape, 0.7, np.float32)
    np.save(path, depth) if path.suffix == ".npy" else cv2.imwrite(str(path), depth)


def bad_files():
    for kind, (_, _, _, bad) in SETS.items():
        for text, said in {**bad, **EVERY_SET}.items():
            yield pytest.param(kind, text.encode("latin-1"), said, id=f"{kind}: {said}, {text[-8:]!r}")


@pytest.mark.parametrize(("kind", "content", "said"), bad_files())
def test_one_bad_label_file_of_many_is_named_and_left_out(tmp_path, kind, content, said):
    label, image, good, _ = SETS[kind]
    for name in "abc":
        (tmp_path / label.format(name)).write_text(good)
        write_image(tmp_path / image.format(name))
    (tmp_path / label.format("b")).write_bytes(content)
    found = li.read(tmp_path)
    (sentence,) = found.left_out
    assert len(found.images) == 2
    assert label.format("b") in sentence and re.search(said, sentence)


@pytest.mark.parametrize("kind", SETS)
def test_labels_without_their_image_are_named_and_left_out(tmp_path, kind):
    label, image, good, _ = SETS[kind]
    for name in "ab":
        (tmp_path / label.format(name)).write_text(good)
    write_image(tmp_path / image.format("a"))
    found = li.read(tmp_path)
    assert len(found.images) == 1 and "belongs to no image" in found.left_out[0]
    (tmp_path / image.format("a")).unlink()
    with pytest.raises(li.LabelError, match="None of the 2 label files .* belongs to no image"):
        li.read(tmp_path)


@pytest.mark.parametrize(
    ("row", "column", "opening"), [(480.0, 320.0, 30.0), (240.0, 900.0, 30.0), (-3.0, 5.0, 30.0), (240.0, 320.0, 801.0)]
)
def test_labels_of_an_image_of_another_size_are_named(row, column, opening):
    image = image_of(li.GraspRectangle(240.0, 320.0, 0.0, 30.0, 9.0), li.GraspRectangle(row, column, 0.0, opening, 9.0))
    with pytest.raises(RigError, match="not of an image of 640 x 480: its labels are of another size"):
        li.sample(image, 400)


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


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("depth.png", lambda path: cv2.imwrite(str(path), np.full((4, 5), 1500, np.uint16))),
        ("depth.npy", lambda path: np.save(path, np.full((4, 5), 1.5))),
        ("depth.npy", lambda path: np.save(path, np.full((4, 5), 1500, np.uint16))),
        ("depth.npy", lambda path: np.save(path, np.full((4, 5), 1500, ">u2"))),
        ("DEPTH.TIF", lambda path: cv2.imwrite(str(path), np.full((4, 5), 1500, np.uint16))),
        ("depth.tiff", lambda path: cv2.imwrite(str(path), np.full((4, 5), 1.5, np.float32))),
    ],
)
def test_depth_is_read_in_metres(tmp_path, name, write):
    write(tmp_path / name)
    np.testing.assert_allclose(li.read_depth(tmp_path / name), np.full((4, 5), 1.5))
    assert li.depth_images(tmp_path) == [tmp_path / name]


@pytest.mark.parametrize("kind", SETS)
def test_names_in_capitals_and_texts_from_windows_are_the_same(tmp_path, kind):
    label, image, good, _ = SETS[kind]
    (tmp_path / label.format("a")).write_text(good)
    write_image(tmp_path / image.format("a"))
    expected = li.read(tmp_path).images[0].grasps
    (tmp_path / label.format("a")).unlink()
    text = good.replace("\n", " \t\r\n") + " \r\n\r\n"
    (tmp_path / label.format("a").upper()).write_bytes(text.encode("utf-16"))
    (tmp_path / image.format("a")).rename(tmp_path / image.format("a").upper())
    ((found,), left_out) = li.read(tmp_path)
    assert found.grasps == expected and found.checked_depth().shape == (480, 640) and not left_out


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("depth.png", b"", "is not an image"),
        ("depth.png", b"no image", "is not an image"),
        ("depth.tiff", b"II*\0", "is not an image"),
        ("depth.npy", b"", "depth.npy"),
        ("depth.npy", b"\x93NUMPY", "depth.npy"),
        ("depth.npy", np.full((48, 64), 700.0), "the median of the depth is 700 m"),
        ("depth.tiff", np.full((48, 64), 70.0, np.float32), "the median of the depth is 70 m"),
        ("depth.png", np.full((48, 64), 65535, np.uint16), "the median of the depth is 65.5"),
        ("depth.png", np.full((48, 64), 1, np.uint16), "the median of the depth is 0.001 m"),
        ("depth.png", np.full((48, 64), 180, np.uint8), "holds uint8"),
        ("depth.npy", np.full((48, 64), 700, np.int32), "holds int32"),
    ],
)
def test_what_is_no_depth_image_or_in_another_unit_is_refused_by_name(tmp_path, name, content, said):
    path = tmp_path / name
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        np.save(path, content) if path.suffix == ".npy" else cv2.imwrite(str(path), content)
    with pytest.raises(RigError, match=said) as error:
        li.read_depth(path)
    assert name in str(error.value)


def test_several_arrays_are_no_depth_image(tmp_path):
    np.savez(tmp_path / "depth.npz", np.full((4, 5), 1.5))
    (tmp_path / "depth.npz").rename(tmp_path / "depth.npy")
    with pytest.raises(RigError, match=r"depth.npy is not an image.$"):
        li.read_depth(tmp_path / "depth.npy")


@given(st.integers(60, 420), st.integers(60, 580), st.integers(200, 480))
def test_a_label_lies_on_what_it_was_drawn_on(row, column, side):
    depth = np.full((480, 640), 0.7, np.float32)
    depth[row - 20 : row + 21, column - 20 : column + 21] = 0.65
    grasp = li.GraspRectangle(float(row), float(column), 0.0, 60.0, 30.0)
    made = li.sample(li.LabelledImage("square", "square", lambda: depth, (grasp,)), side)
    square, label = (np.argwhere(mask).mean(axis=0) for mask in (made.depth < -0.02, made.quality > 0))
    np.testing.assert_allclose(label, square, atol=0.8)
