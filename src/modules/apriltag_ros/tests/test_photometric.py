"""The photometric refinement: the truth stays, errors become smaller, and what spoils the image is rejection."""

from __future__ import annotations

import cv2
import numpy as np
import pinocchio as pin
import pytest
from tag_renderer import render
from test_tag_pose import error, view

from apriltag_ros.detector import TagDetector
from apriltag_ros.photometric import PhotometricRefiner
from apriltag_ros.settings import TagTarget, TargetTag, detector_settings
from apriltag_ros.tag_pose import corner_jacobian
from apriltag_ros.tag_rendering import TagView, black_cells
from common import tag36h11
from common.poses import pose

FAMILY = "tag36h11"
PLATE = {1: 0.13, 5: 0.3}


def image(camera, target, truth, **how):
    tags = [(t.id, t.size, *t.T_target_tag[:2, 3]) for t in target.tags]
    return render(camera, truth, tags, PLATE[len(tags)], **how)


def corner_shift(camera, target, T, truth):
    """How far the pose T moves a corner at most [px]."""
    points = np.concatenate([tag.corners for tag in target.tags])
    return np.abs(corner_jacobian(truth, points, camera.K) @ error(T, truth)).max()


def disturbed(T, rng, distance):
    """A pose about a pixel away."""
    shift = rng.normal(0.0, 1.0, 3) * (0.0008, 0.0008, 0.004) * distance
    return pose(pin.exp3(rng.normal(0.0, 0.01, 3)) @ T[:3, :3], T[:3, 3] + shift)


@pytest.mark.parametrize(("distance", "tilt", "blur"), [(0.5, 35.0, 0.6), (0.8, 0.0, 1.2), (1.2, 50.0, 0.3)])
def test_the_truth_stays_where_it_is(camera, bundle, distance, tilt, blur):
    truth = view(distance, tilt, x=0.05)
    grey = image(camera, bundle, truth, blur=blur, noise=0.0)
    found = PhotometricRefiner(FAMILY, bundle).refine(grey, camera, truth)
    assert found.rejection == ""
    assert corner_shift(camera, bundle, found.T_camera_tag, truth) < 0.03
    assert found.blur == pytest.approx(blur, abs=0.12)


@pytest.mark.parametrize("many", [False, True])
def test_errors_of_a_pixel_become_those_of_a_fiftieth(camera, bundle, single, many):
    target = bundle if many else single
    refiner, rng = PhotometricRefiner(FAMILY, target), np.random.default_rng(1)
    for seed, (distance, tilt) in enumerate([(0.6, 20.0), (1.0, 35.0)]):
        truth = view(distance, tilt, azimuth=seed, turn=2.0 * seed)
        grey = image(camera, target, truth, seed=seed)
        ends = []
        for _ in range(2):
            start = disturbed(truth, rng, distance)
            found = refiner.refine(grey, camera, start)
            assert found.rejection == ""
            assert corner_shift(camera, target, start, truth) > 0.3
            assert corner_shift(camera, target, found.T_camera_tag, truth) < 0.06
            ends.append(found.T_camera_tag)
        assert corner_shift(camera, target, *ends) < 0.01, "wherever it starts it ends in one place"


def test_it_is_nearer_to_the_truth_than_the_corners_and_knows_how_near(camera, bundle):
    detector = TagDetector(detector_settings({"tag_threads": 1, "rectified": False}), (bundle,))
    refiner = PhotometricRefiner(FAMILY, bundle)
    by_corners, refined, squares = [], [], []
    for seed in range(0, 8, 2):
        truth = view(0.9 + 0.1 * seed, 15.0 + 4.0 * seed, azimuth=seed, turn=seed, x=0.05)
        grey = image(camera, bundle, truth, seed=seed)
        (seen,) = detector.detect(grey, camera, float(seed)).targets
        found = refiner.refine(grey, camera, seen.pose.T_camera_tag)
        by_corners.append(np.abs(error(seen.pose.T_camera_tag, truth)))
        e = error(found.T_camera_tag, truth)
        refined.append(np.abs(e))
        squares.append(e @ np.linalg.inv(found.covariance) @ e / 6.0)
    assert np.all(np.median(refined, axis=0)[[2, 3, 4]] < 0.5 * np.median(by_corners, axis=0)[[2, 3, 4]])
    assert np.mean(squares) < 2.0


def test_noise_makes_it_less_sure(camera, single):
    truth, refiner = view(1.2, 35.0), PhotometricRefiner(FAMILY, single)
    quiet, loud = (refiner.refine(image(camera, single, truth, noise=n), camera, truth) for n in (1.0, 12.0))
    sd = [np.sqrt(np.diag(found.covariance)) for found in (quiet, loud)]
    assert np.all(sd[1] > 1.2 * sd[0])
    e = error(loud.T_camera_tag, truth)
    assert e @ np.linalg.inv(loud.covariance) @ e / 6.0 < 3.0


def test_the_wrong_one_of_two_tilts_is_left(camera, single):
    truth = view(1.2, 12.0)
    grey = image(camera, single, truth)
    refiner = PhotometricRefiner(FAMILY, single)
    (mirrored,) = refiner._second(camera, truth)
    assert np.degrees(np.linalg.norm(error(mirrored, truth)[3:])) > 15.0
    found = refiner.refine(grey, camera, mirrored)
    assert found.rejection == ""
    assert np.degrees(np.linalg.norm(error(found.T_camera_tag, truth)[3:])) < 1.0


def test_light_and_shade_on_the_tags_do_not_move_the_pose(camera, bundle):
    truth = view(0.7, 30.0)
    grey = image(camera, bundle, truth, noise=0.0)
    shade = np.linspace(0.5, 1.0, camera.width)[None, :]
    dim = np.clip(np.rint(grey * shade + 15.0), 0, 255).astype(np.uint8)
    found = PhotometricRefiner(FAMILY, bundle).refine(dim, camera, truth)
    assert found.rejection == "" and corner_shift(camera, bundle, found.T_camera_tag, truth) < 0.05


def covered(camera, target, truth):
    """The image with a grey patch on the third tag."""
    grey = image(camera, target, truth)
    u, v = camera.project((truth @ [*target.tags[2].T_target_tag[:3, 3], 1.0])[:3][None])[0].astype(int)
    grey[v - 10 : v + 12, u - 10 : u + 10] = 160
    return grey


def of_another_tag(camera, target, truth):
    return image(camera, TagTarget("tag", (TargetTag(3, target.tags[0].size),)), truth)


NEAR, BEHIND = view(0.7, 30.0), pose(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, -0.5))
REFUSALS = {
    "cut off": (5, view(0.5, 20.0, x=0.45), image, "cuts off"),
    "behind the camera": (1, BEHIND, lambda *_: np.zeros((480, 640), np.uint8), "cuts off"),
    "too bright": (5, NEAR, lambda *a: cv2.convertScaleAbs(image(*a), alpha=1.6), "exposed"),
    "too dark": (5, NEAR, lambda *a: cv2.convertScaleAbs(image(*a), alpha=0.08, beta=20), "contrast"),
    "blurred": (5, view(1.2, 30.0), lambda *a: image(*a, blur=3.0), "blur"),
    "a covered tag": (5, NEAR, covered, "uncover"),
    "another pattern": (1, view(0.6, 30.0), of_another_tag, ""),
    "nothing to see": (1, view(0.6, 30.0), lambda *_: np.full((480, 640), 90, np.uint8), "contrast"),
}


@pytest.mark.parametrize("name", [*REFUSALS, "a start that is far off"])
def test_the_start_stays_and_a_sentence_says_why(camera, bundle, single, name):
    tags, truth, picture, sentence = REFUSALS.get(name, (5, NEAR, image, ""))
    target = bundle if tags == 5 else single
    start = truth if name in REFUSALS else pose(truth[:3, :3], truth[:3, 3] + (0.03, 0.0, 0.0))
    found = PhotometricRefiner(FAMILY, target).refine(picture(camera, target, truth), camera, start)
    assert found.covariance is None and found.rejection and sentence in found.rejection
    np.testing.assert_array_equal(found.T_camera_tag, start)


@pytest.mark.parametrize(
    "grey", [np.zeros((480, 640, 3), np.uint8), np.zeros((48, 64), np.uint8), np.zeros((480, 640))]
)
def test_what_is_no_image_of_the_camera_is_an_error(camera, single, grey):
    with pytest.raises(ValueError, match="uint8"):
        PhotometricRefiner(FAMILY, single).refine(grey, camera, view(0.6, 30.0))


def test_patterns_are_those_that_are_printed():
    for tag in range(len(tag36h11.CODES)):
        np.testing.assert_array_equal(black_cells(FAMILY, tag), tag36h11.black_cells(tag))
    assert black_cells("tag16h5", 0).shape == (6, 6)
    for family, tag, sentence in ((FAMILY, 587, "587"), ("tag99h9", 0, "tag99h9")):
        with pytest.raises(ValueError, match=sentence):
            black_cells(family, tag)


def test_derivatives_are_those_of_the_drawing(camera, bundle):
    T, blur, step = view(0.8, 30.0), 0.8, 5e-4
    grey = image(camera, bundle, T)
    patterns = PhotometricRefiner(FAMILY, bundle)._patterns
    v = TagView.of(patterns[0], grey, camera, T)
    _, J = v.render(T, blur)
    for i in range(6):
        d = np.zeros(6)
        d[i] = step

        def at(sign, d=d):
            return v.render(pose(pin.exp3(sign * d[3:]) @ T[:3, :3], T[:3, 3] + sign * d[:3]), blur)[0]

        numeric = (at(1.0) - at(-1.0)) / (2.0 * step)
        assert np.corrcoef(numeric, J[:, i])[0, 1] > 0.98
        assert (numeric @ J[:, i]) / (J[:, i] @ J[:, i]) == pytest.approx(1.0, abs=0.05)
