"""The library behind its adapter: which corner is which, where a pixel's centre is, what a pattern looks like."""

from __future__ import annotations

import apriltag
import numpy as np
import pytest
from tag_renderer import CODES, cells, render

from apriltag_ros.detector import LOOK_AGAIN_S, TagDetector, TagFinder
from apriltag_ros.settings import CORNERS, FAMILIES, detector_settings, targets
from common.camera_model import pinhole
from common.poses import pose
from common.rotations import rotation_about

FACING = np.diag([1.0, -1.0, -1.0])
"""A tag upright in front of the camera and facing it."""
ZERO = ["00000000", "01101010", "00111010", "00110000", "01010000", "00101100", "00001000", "00000000"]
"""Id 0 of tag36h11 with its black border, top row first, 1 = white."""


@pytest.fixture(scope="module")
def finder():
    return TagFinder(detector_settings({"tag_threads": 1}))


@pytest.fixture(scope="module")
def straight():
    return pinhole("straight", 640, 480, [[525.0, 0, 319.5], [0, 525.0, 239.5], [0, 0, 1]])


def test_the_rendered_patterns_are_the_published_ones():
    np.testing.assert_array_equal(cells(0), [[c == "1" for c in row] for row in ZERO])


def test_every_rendered_tag_is_read_without_a_wrong_bit(finder, straight):
    row = [(tag, 0.06, 0.08 * (tag - 2), 0.0) for tag in range(len(CODES))]
    found = finder.find(render(straight, pose(FACING @ rotation_about(2, 0.1), (0, 0, 0.7)), row, 0.5))
    assert sorted((tag.id, tag.hamming) for tag in found) == [(tag, 0) for tag in range(len(CODES))]


def test_the_library_knows_the_families():
    known = {name.decode() for name in apriltag.Detector(apriltag.DetectorOptions()).families}
    assert set(FAMILIES) == known


@pytest.mark.parametrize("turn", [0, 90, 180, 270, 37])
def test_corner_order_and_half_pixel(finder, straight, turn):
    errors = []
    for part in np.arange(
        0.0, 1.0, 0.25
    ):  # edges along the pixels are seen up to 0.4 px off, by where they cut a pixel
        place = np.array([0.031, -0.017, 0.5]) + part * 0.5 / 525.0 * np.array([1.0, 1.0, 0.0])
        T = pose(FACING @ rotation_about(2, np.radians(turn)), place)
        (tag,) = finder.find(render(straight, T, [(0, 0.1, 0.0, 0.0)], 0.15))
        assert (tag.id, tag.hamming) == (0, 0)
        errors.append(tag.corners - straight.project(0.1 * CORNERS @ T[:3, :3].T + T[:3, 3]))
    np.testing.assert_allclose(errors, 0.0, atol=0.6)
    np.testing.assert_allclose(np.mean(errors, axis=0), 0.0, atol=0.15)


def test_a_tag_seen_twice_is_dropped_unless_wanted(straight):
    twice = [(0, 0.08, -0.06, 0.0), (0, 0.08, 0.06, 0.0), (2, 0.05, 0.0, 0.1)]
    image = render(straight, pose(FACING, (0, 0, 0.6)), twice, 0.28)
    find = {drop: TagFinder(detector_settings({"tag_threads": 1, "remove_duplicates": drop})) for drop in (True, False)}
    assert [tag.id for tag in find[True].find(image)] == [2]
    assert sorted(tag.id for tag in find[False].find(image)) == [0, 0, 2]


def detector(**settings):
    return TagDetector(
        detector_settings({"tag_threads": 1, **settings}), targets({"standalone_tags": [{"id": 0, "size": 0.1}]})
    )


@pytest.mark.parametrize(
    ("side", "tilt"), [((0, -1), 0.0), ((0, -1), 0.3), ((-1, 0), 0.3), ((0, 1), 0.3), ((1, 0), 0.3)]
)
@pytest.mark.parametrize("decimate", [1.0, 4.0])
def test_a_tag_whose_part_is_outside_the_image_has_no_pose_beside_the_truth(straight, tilt, side, decimate):
    """The library finds such a tag with corners where the image ends: poses that are wrong by centimetres.

    Reported in https://github.com/AprilRobotics/apriltag/issues/375,
    https://github.com/PhotonVision/photonvision/issues/1817: a tag that is partly outside the image is detected,
    with wrong corners. Tried: tags over each edge.
    """
    find, counted = detector(tag_decimate=decimate), 0
    for outside in (-40, -12, *range(-8, 12, 2), -3, -1, 1):
        middle = [outside * s + (half - 52.5) * s for half, s in zip((319.5, 239.5), side)]
        T = pose(rotation_about(0, tilt) @ rotation_about(1, tilt / 2) @ FACING, (*np.array(middle) * 0.5 / 525, 0.5))
        find.reset()
        result = find.detect(render(straight, T, [(0, 0.1, 0.0, 0.0)], 0.14), straight, 0.0)
        true = straight.project(0.1 * CORNERS @ T[:3, :3].T + T[:3, 3])
        for tag in result.tags:
            np.testing.assert_allclose(tag.corners, true, atol=0.8)
        counted += len(result.targets)
        assert not (result.targets and result.failed)
    assert counted


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        (lambda image: image[:, ::-1], "is mirrored"),
        (lambda image: image[::-1], "is mirrored"),
        (lambda image: 255 - image, "black and white exchanged"),
        (lambda image: np.vstack([image[213:], image[:213]]), "at the image's edge"),
        (lambda image: np.hstack([image[:, 160:480], image[:, 160:480]]), "visible 2 times"),
    ],
)
def test_a_known_tag_that_does_not_count_is_named(straight, changed, sentence):
    """Reported in https://github.com/AprilRobotics/apriltag/issues/56, https://github.com/openmv/openmv/issues/564:
    mirrored images show no tag. Tried: a mirrored image.
    Reported in https://github.com/AprilRobotics/apriltag_ros/issues/96: tags printed inverted. Tried: an inverted
    image.
    Reported in https://github.com/AprilRobotics/apriltag_ros/issues/11: two tags of one id disappear. Tried: that
    image.
    """
    image = render(straight, pose(FACING, (0.01, 0.02, 0.6)), [(0, 0.1, 0.0, 0.0)], 0.14)
    find = detector()
    seen = [find.detect(np.ascontiguousarray(changed(image)), straight, now) for now in (0.0, 1.0, LOOK_AGAIN_S)]
    assert not any(result.targets for result in seen)
    for result in (seen[0], seen[2]):
        assert len(result.failed) == 1 and "the tag 0" in result.failed[0] and sentence in result.failed[0]


def test_wanted_duplicates_have_a_pose_each(straight):
    """Reported in https://github.com/AprilRobotics/apriltag_ros/pull/137: `remove_duplicates: false` needs a pose for
    each. Tried: that image.
    """
    image = render(straight, pose(FACING, (0.0, 0.0, 0.6)), [(0, 0.1, -0.1, 0.0), (0, 0.1, 0.1, 0.0)], 0.34)
    found = detector(remove_duplicates=False).detect(image, straight, 0.0).targets
    assert sorted(round(float(target.pose.T_camera_tag[0, 3]), 2) for target in found) == [-0.1, 0.1]


def test_other_arrays_than_grey_images_are_refused(finder):
    for image in (np.zeros((48, 64)), np.zeros((48, 64, 3), dtype=np.uint8)):
        with pytest.raises(ValueError, match="uint8"):
            finder.find(image)


def test_another_package_of_the_same_name_is_named(monkeypatch):
    monkeypatch.delattr(apriltag, "DetectorOptions")
    with pytest.raises(ImportError, match="Debian"):
        TagFinder(detector_settings({}))
