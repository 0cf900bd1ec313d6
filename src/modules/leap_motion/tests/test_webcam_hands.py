"""Hands in front of a webcam: the metric hand from landmarks, Leap axes, and what of it can be trusted.

The landmarks are those of a rigid hand that is posed, projected, and given noise; the world landmarks are its shape as
seen along the ray to it, which is how MediaPipe's turn out to be.
"""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from leap_motion.service.hand import KNUCKLES_MM
from leap_motion.webcam import hand_tracks, palm_width
from leap_motion.webcam.hand_tracks import HandTracks, SeenHand
from leap_motion.webcam.lens import lens_of_view
from leap_motion.webcam.palm_pose import PALM, TEMPLATE_MM, _along, camera_hand
from leap_motion.webcam.setups import ABOVE, BOX_CENTRE_MM, FRONT, placement

SHAPE = (480, 640)
LENS = lens_of_view(math.radians(60.0), SHAPE)
FINGERS_MM = np.array([[0.0, 45.0, 75.0, 95.0], *[[0.0, 40.0, 63.0, 80.0]] * 4])


def open_hand(side="right", width=84.25, curl=0.0):
    """The 21 landmarks in palm axes [mm], the fingers bent by `curl` [rad] at the knuckles."""
    shape = np.empty((21, 3))
    shape[PALM] = TEMPLATE_MM
    for finger in range(5):
        start = KNUCKLES_MM[finger]
        along = np.array([0.0, -math.sin(curl), -math.cos(curl)]) if finger else np.array([-0.7, 0.0, -0.714])
        for i, distance in enumerate(FINGERS_MM[finger]):
            shape[1 + 4 * finger + i] = start + distance * along
    return shape * [-1.0 if side == "left" else 1.0, 1.0, 1.0] * (width / 84.25)


def seen(axes, palm, side="right", width=84.25, noise=None, score=0.98, curl=0.0):
    """The hand as the camera sees it: palm axes in camera axes, centre of the palm [mm], noise [px]."""
    shape = open_hand(side, width, curl)
    points = shape @ axes.T + palm
    rays = points[:, :2] / points[:, 2:]
    landmarks = LENS.landmarks(points, SHAPE)
    if noise is not None:
        landmarks = landmarks + noise / 640.0
        rays = LENS.rays(landmarks, SHAPE)
    world = 1e-3 * shape @ axes.T @ _along(rays[PALM].mean(axis=0))
    return SeenHand(side, score, landmarks, rays, world)


def rotation(vector):
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = np.asarray(vector) / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


angles = st.tuples(*[st.floats(-1.0, 1.0)] * 3)
places = st.tuples(st.floats(-120, 120), st.floats(-80, 80), st.floats(300, 700))
sides = st.sampled_from(["right", "left"])
FACING = np.diag([-1.0, -1.0, 1.0]) @ rotation(
    [math.pi / 2, 0.0, 0.0]
)  # fingers up in the image, the palm to the camera


def measured(hand, width=84.25):
    result = camera_hand(hand.side, hand.rays, hand.world, width)
    assert result is not None
    return result


@given(angles, places, sides, st.floats(60.0, 110.0))
@settings(max_examples=50, deadline=None)
def test_a_hand_is_found_where_it_is(turn, place, side, width):
    """Reported in https://github.com/google-ai-edge/mediapipe/issues/1374,
    https://github.com/google-ai-edge/mediapipe/issues/4803: left and right are those of a mirror. Tried: a
    mirrored hand.
    """
    axes = rotation(turn) @ FACING
    hand = measured(seen(axes, place, side, width), width)
    assert_allclose(hand.palm, place, atol=0.5)
    assert_allclose(hand.axes, axes, atol=1e-3)
    assert hand.residual < 1e-3
    assert_allclose(hand.joints[1:, 1:].reshape(-1, 3), open_hand(side, width)[5:], atol=1e-3)


@given(angles, places, st.floats(60.0, 110.0))
@settings(max_examples=30, deadline=None)
def test_another_palm_width_scales_the_place(turn, place, width):
    hand = seen(rotation(turn) @ FACING, place)
    assert_allclose(measured(hand, width).palm, np.array(place) * width / 84.25, rtol=1e-3, atol=0.1)


NUMBERS = st.one_of(st.floats(-2.0, 2.0), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e300]))


@given(st.lists(NUMBERS, min_size=105, max_size=105), sides, st.booleans())
@settings(max_examples=50, deadline=None)
def test_garbage_is_no_hand_and_no_exception(numbers, side, equal):
    values = np.array([numbers[0]] * 105 if equal else numbers)
    hand = SeenHand(side, 0.9, values[:42].reshape(21, 2), values[:42].reshape(21, 2), values[42:].reshape(21, 3))
    tracks = HandTracks(placement(FRONT), 85.0)
    for i in range(4):
        found = tracks.step([hand], 128.0, i / 30.0)
        for report in found.hands:
            assert np.isfinite(report.joints).all()


def test_a_hand_behind_the_camera_is_none():
    hand = seen(FACING, (0, 0, 400))
    assert (
        camera_hand("right", -hand.rays, hand.world, 85.0) is None
        or camera_hand("right", -hand.rays, hand.world, 85.0).residual > hand_tracks.WORST_RESIDUAL
    )


class TestSetups:
    # A step of the person's hand, and the directions in camera axes that it is.
    @pytest.mark.parametrize(
        "setup, right, up, near",
        [(FRONT, (-1, 0, 0), (0, -1, 0), (0, 0, 1)), (ABOVE, (1, 0, 0), (0, 0, -1), (0, 1, 0))],
    )
    @pytest.mark.parametrize("tilt", [0.0, 0.3])
    def test_up_is_up_and_right_is_right(self, setup, right, up, near, tilt):
        place = placement(setup, tilt)
        level = rotation([-tilt, 0.0, 0.0])  # of the world in the camera that looks up
        for leap, camera in zip(np.eye(3), (right, up, near)):
            assert_allclose(
                place.axes @ level.T @ camera if tilt == 0 else place.axes @ level @ camera, leap, atol=1e-9
            )

    @pytest.mark.parametrize("setup", [FRONT, ABOVE])
    def test_the_box_is_before_the_camera(self, setup):
        place = placement(setup, 0.2, 450.0)
        assert_allclose(place.in_camera(BOX_CENTRE_MM[None])[0], [0, 0, 450.0], atol=1e-9)

    def test_a_level_hand_under_the_camera_is_level(self):
        place = placement(ABOVE)
        hand = measured(seen(place.axes.T, place.in_camera(BOX_CENTRE_MM[None])[0]))
        assert_allclose(place.palm(hand), BOX_CENTRE_MM, atol=0.5)
        assert_allclose(place.axes @ hand.axes, np.eye(3), atol=1e-3)


def run(tracks, make, frames, start=0, brightness=128.0, rate=30.0):
    """Steps through frames of `make(i)`; returns what was found."""
    return [tracks.step(make(i), brightness, i / rate) for i in range(start, start + frames)]


def held(place=(0, 0, 500), **more):
    return lambda i: [seen(FACING, place, **more)]


class TestTracks:
    def test_a_hand_is_reported_from_its_third_frame_and_followed_once_it_was_held_still(self):
        found = run(HandTracks(placement(FRONT), 84.25), held(), 40)
        assert [len(f.hands) for f in found[:4]] == [0, 0, 1, 1]
        assert found[20].hands[0].confidence == 0.0 and found[20].remark == hand_tracks.HOLD_STILL
        assert found[-1].hands[0].confidence > 0.9 and found[-1].remark == ""
        assert found[-1].rate == pytest.approx(30.0)

    @pytest.mark.parametrize("seed", range(6))
    def test_the_neutral_pose_is_level_and_in_the_middle_and_turns_as_the_hand_turns(self, seed):
        rng = np.random.default_rng(seed)
        side = ("right", "left")[seed % 2]
        first, place = rotation(rng.uniform(-0.5, 0.5, 3)) @ FACING, np.array([0.0, 0.0, 500.0])
        turn, move = rng.uniform(-0.3, 0.3, 3), rng.uniform(-50.0, 50.0, 3)
        tracks = HandTracks(placement(FRONT), 84.25)
        level = run(tracks, lambda i: [seen(first, place, side)], 40)[-1].hands[0]
        assert_allclose(level.palm, BOX_CENTRE_MM, atol=1.0)
        assert_allclose([level.direction, level.normal], [[0, 0, -1], [0, -1, 0]], atol=1e-2)

        def steps(i):
            part = (i - 39) / 15
            return [seen(rotation(part * turn) @ first, place + part * move, side)]

        after = run(tracks, steps, 15, 40)[-1].hands[0]
        leap = placement(FRONT).axes
        assert_allclose(after.palm - level.palm, leap @ move, atol=1.5)
        change = leap @ rotation(turn) @ leap.T
        assert_allclose(after.direction, change @ [0, 0, -1], atol=2e-2)
        assert_allclose(after.normal, change @ [0, -1, 0], atol=2e-2)
        assert after.id == level.id

    @pytest.mark.parametrize(
        "make, brightness, remark",
        [
            (lambda i: [], 128.0, hand_tracks.NO_HAND),
            (held(), 10.0, hand_tracks.TOO_DARK),
            (held((0, 0, 150)), 128.0, "too near, 15 cm"),
            (held((0, 0, 1200)), 128.0, "too far away, 120 cm"),
            (held((285, 0, 500)), 128.0, hand_tracks.CUT),
        ],
    )
    def test_what_cannot_be_trusted_is_withheld_with_a_sentence(self, make, brightness, remark):
        found = run(HandTracks(placement(ABOVE), 84.25), make, 10, brightness=brightness)
        assert remark in found[-1].remark
        assert not any(f.hands for f in found)

    def test_cut_fingers_and_little_light_cost_confidence(self):
        def confidence(place=(0, 0, 500), brightness=128.0):
            return (
                run(HandTracks(placement(ABOVE), 84.25), held(place), 9, brightness=brightness)[-1].hands[0].confidence
            )

        assert confidence((0, -120, 500)) < 0.6 * confidence()
        assert confidence(brightness=30.0) < 0.6 * confidence()
        assert confidence((0, 0, 900)) < 0.5 * confidence()

    def test_a_slow_camera_is_said(self):
        found = run(HandTracks(placement(ABOVE), 84.25), held(), 20, rate=5.0)
        assert "Only 5 frames per second" in found[-1].remark and found[-1].rate == pytest.approx(5.0)

    def test_of_three_hands_the_two_most_certain_count(self):
        def three(i):
            return [seen(FACING, (x, 0, 700), score=score) for x, score in ((-150, 0.7), (0, 0.9), (150, 0.8))]

        found = run(HandTracks(placement(ABOVE), 84.25), three, 10)[-1]
        assert found.remark == hand_tracks.SEVERAL
        assert sorted(round(hand.palm[0]) for hand in found.hands) == [0, 150]

    def test_a_hand_found_twice_is_one(self):
        twice = lambda i: [seen(FACING, (0, 0, 500)), seen(FACING, (4, 0, 500), score=0.8)]  # noqa: E731
        assert len(run(HandTracks(placement(ABOVE), 84.25), twice, 10)[-1].hands) == 1

    def test_a_surer_hand_that_reaches_over_the_one_that_is_followed_does_not_take_its_number(self):
        def crossing(i):
            return [seen(FACING, (0, 0, 400), score=0.9), seen(FACING, (5 * i - 200, 0, 390), score=0.97)]

        tracks = HandTracks(placement(ABOVE), 84.25)
        followed = run(tracks, held((0, 0, 400)), 10)[-1].hands[0]
        found = run(tracks, crossing, 80, 10)
        assert all(abs(h.palm[0] - followed.palm[0]) < 5.0 for f in found for h in f.hands if h.id == followed.id)
        assert all(followed.id in [h.id for h in f.hands] for f in found)

    def test_ids_stay_while_a_hand_is_tracked_and_are_new_after_it_was_lost(self):
        tracks = HandTracks(placement(ABOVE), 84.25)
        gap = lambda i: [] if 10 <= i < 14 or 30 <= i < 38 else [seen(FACING, (0, 0, 500))]  # noqa: E731
        ids = [f.hands[0].id if f.hands else 0 for f in run(tracks, gap, 50)]
        assert ids[5] == ids[20] != 0 and ids[49] > ids[20]

    def test_a_side_that_is_mistaken_for_some_frames_stays(self):
        tracks = HandTracks(placement(ABOVE), 84.25)
        names = lambda i: "left" if 10 <= i < 13 or i >= 20 else "right"  # noqa: E731
        found = run(tracks, lambda i: [seen(FACING, (0, 0, 500), names(i))], 40)
        sides = [f.hands[0].side if f.hands else "" for f in found]
        assert "left" not in sides[:20] and sides[-1] == "left"
        assert found[-1].hands[0].id != found[19].hands[0].id

    def test_a_hand_that_jumps_is_withheld(self):
        def jumping(i):
            return [seen(FACING, (0, 0, 500 if i % 2 else 800), width=84.25 if i % 2 else 100.0)]

        found = run(HandTracks(placement(ABOVE), 84.25), lambda i: held()(i) if i < 10 else jumping(i), 20)
        assert found[10].remark == hand_tracks.JUMPS and not found[10].hands

    def test_a_palm_that_turns_over_at_once_is_withheld(self):
        over = rotation([0.0, math.pi, 0.0]) @ FACING
        found = run(HandTracks(placement(ABOVE), 84.25), lambda i: [seen(FACING if i < 10 else over, (0, 0, 500))], 11)
        assert found[9].hands and found[10].remark == hand_tracks.JUMPS and not found[10].hands

    def test_landmarks_that_are_no_palm_are_withheld(self):
        def warped(i):
            hand = seen(FACING, (0, 0, 500))
            middle = hand.rays[PALM].mean(axis=0)
            return [replace(hand, rays=middle + (hand.rays - middle) * [1.0, 2.0])]

        found = run(HandTracks(placement(ABOVE), 84.25), warped, 10)
        assert found[-1].remark == hand_tracks.UNCLEAR and not any(f.hands for f in found)

    def test_a_new_middle_of_the_box_makes_another_hand(self):
        tracks = HandTracks(placement(FRONT), 84.25)
        moved = lambda i: [seen(FACING, (max(0.0, min(150.0, 5.0 * (i - 50))), 0, 500))]  # noqa: E731
        before = run(tracks, moved, 85)[-1].hands[0]
        tracks.renew()
        found = [hand for f in run(tracks, moved, 60, 85) for hand in f.hands]
        after = [hand for hand in found if hand.id != before.id]
        assert after and np.linalg.norm(found[-1].palm - before.palm) > 100.0
        assert all(np.linalg.norm(hand.palm - before.palm) < 1.0 for hand in found if hand.id == before.id)
        assert all(np.linalg.norm(hand.velocity) < 50.0 for hand in after)

    def test_a_hand_whose_level_is_taken_anew_is_gone_for_a_moment(self):
        """So no mean over its samples holds axes of before and after: a start would count them as a turn."""
        tracks = HandTracks(placement(FRONT), 84.25)
        run(tracks, held(), 45)
        run(tracks, lambda i: [], 100, 45)
        found = run(tracks, held((0, 40, 500)), 60, 145)
        sure = [f.hands[0].confidence > 0.0 if f.hands else None for f in found]
        change = sure.index(True)
        assert sure[change - 2 : change] == [None, None] and False in sure[:change]
        assert all(sure[change:])

    def test_a_new_neutral_pose_turns_no_hand_that_steers(self):
        tracks = HandTracks(placement(FRONT), 84.25)
        before = run(tracks, held(), 45)[-1].hands[0]
        tracks.renew()
        found = run(tracks, held(), 60, 45)
        assert not any(f.hands for f in found[:7])  # longer than an engagement outlives its hand
        assert all(hand.id > before.id for f in found for hand in f.hands) and found[-1].hands


class TestPalmWidth:
    @given(st.tuples(*[st.floats(-0.5, 0.5)] * 3), st.floats(65.0, 105.0))
    @example((0.0, 0.0, 0.125), 85.0)  # exactly parallel to the image: IPPE answers NaN
    @settings(max_examples=20, deadline=None)
    def test_a_hand_in_the_plane_of_a_card(self, turn, width):
        axes, shift = rotation(turn), np.array([0.0, 0.0, 450.0])
        flat = open_hand(width=width)[:, [0, 2, 1]] * [1.0, 1.0, 0.0] + [60.0, 0.0, 0.0]
        card = 0.5 * np.array([[-85.6, -53.98, 0], [85.6, -53.98, 0], [85.6, 53.98, 0], [-85.6, 53.98, 0]])
        flat[PALM] = TEMPLATE_MM[:, [0, 2, 1]] * [1, 1, 0] * width / 84.25 + [60.0, 0.0, 0.0]
        corners, hand = (points @ axes.T + shift for points in (card, flat))
        found = palm_width.palm_width(corners[:, :2] / corners[:, 2:], palm_width.CARD_MM, hand[:, :2] / hand[:, 2:])
        assert found == pytest.approx(width, rel=0.01)

    def test_finds_a_card_and_a_tag_in_an_image(self):
        image = np.full((480, 640, 3), 60, np.uint8)
        card = np.array([[100, 100], [271, 100], [271, 208], [100, 208]], np.int32)
        cv2.fillPoly(image, [card], (210, 200, 190))
        assert_allclose(np.sort(palm_width.find_card(image), axis=0), np.sort(card, axis=0), atol=4)
        assert palm_width.find_card(np.full((480, 640, 3), 60, np.uint8)) is None
        tag = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11), 3, 160)
        image = np.full((480, 640, 3), 255, np.uint8)
        image[200:360, 300:460] = tag[..., None]
        assert_allclose(palm_width.find_tag(image).mean(axis=0), [380, 280], atol=2)

    def test_a_square_is_no_card(self):
        square = 0.1 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=float)
        assert palm_width.palm_width(square, palm_width.CARD_MM, open_hand()[:, :2] / 500.0) is None

    def test_widths_that_differ_too_much_are_refused(self):
        assert palm_width.agreed([85.0] * 40) == 85.0
        assert palm_width.agreed([85.0] * 10) is None
        assert palm_width.agreed([70.0, 100.0] * 30) is None
