"""The registration of a tracker: from points to a pose, and a frame in the axes of the desk."""

import dataclasses
import re

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from common.poses import inverse, pose
from common.rotations import check_rotation, rotation_angle
from leap_motion.codec import read_message
from leap_motion.registration import (
    FINGER_M,
    MAX_TURN_DEG,
    MIN_FRAMES,
    RegistrationRefused,
    check_fit,
    check_points,
    fit,
    fit_level,
    registered,
    sheet_points,
    still_tip,
    tilt_deg,
)
from rig_simulation.operator.guided import GuidedOperator
from rig_simulation.operator.motion import Script
from rig_simulation.operator.sources import Playback, ScriptedOperator

SHEET = sheet_points(0.2)
LIMIT_M, SCALE_LIMIT = 8e-3, 0.025
NOISE_M = 2e-3
ABOVE = np.array([0.0, FINGER_M, 0.0])  # the tip, of what it touches
unit_cube = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)
directions = unit_cube.filter(lambda v: np.linalg.norm(v) > 0.1).map(lambda v: v / np.linalg.norm(v))


@st.composite
def stands(draw, most_deg=MAX_TURN_DEG - 5.0):
    """T_desk_leap of a tracker that is turned and moved."""
    turn = np.radians(draw(st.floats(0.0, most_deg))) * draw(directions)
    return pose(pin.exp3(turn), 0.3 * draw(unit_cube))


@st.composite
def point_sets(draw):
    """Three to six points that a registration accepts."""
    points = {f"P{i}": tuple(0.2 * draw(unit_cube)) for i in range(draw(st.integers(3, 6)))}
    try:
        check_points(points)
    except RegistrationRefused:
        assume(False)
    return points


def touched(T_desk_leap, points, noise=None):
    """The tips that a tracker reports."""
    T = inverse(T_desk_leap)
    noise = np.zeros((len(points), 3)) if noise is None else noise
    tips = {name: T[:3, :3] @ (np.array(p) + ABOVE) + T[:3, 3] for name, p in points.items()}
    return {name: tip + error for (name, tip), error in zip(tips.items(), noise)}


def check(found, points=SHEET):
    check_fit(found, list(points), LIMIT_M, SCALE_LIMIT)


@given(stands(), st.one_of(st.just(SHEET), point_sets()))
def test_exact_points_give_the_pose(T, points):
    found = fit(points, touched(T, points))
    assert_allclose(found.T_desk_leap, T, atol=1e-9)
    assert found.residuals.max() < 1e-9 and found.scale == pytest.approx(1.0)
    check(found, points)


@given(stands(), st.lists(st.tuples(directions, st.floats(0.0, NOISE_M)), min_size=4, max_size=4))
def test_noise_gives_an_error_within_its_bound(T, errors):
    noise = np.array([size * direction for direction, size in errors])
    found = fit(SHEET, touched(T, SHEET, noise))
    middle = inverse(T) @ (0.0, 0.2 + FINGER_M, 0.0, 1.0)
    assert np.linalg.norm((found.T_desk_leap - T) @ middle) <= NOISE_M + 1e-9
    assert rotation_angle(found.T_desk_leap[:3, :3].T @ T[:3, :3]) <= np.sqrt(3.0) * NOISE_M / 0.07
    assert found.residuals.max() <= 3.0 * NOISE_M
    check(found)


@given(stands(), point_sets(), st.floats(0.03, 0.3), st.booleans())
def test_a_wrong_scale_is_named(T, points, error, smaller):
    scale = 1.0 - error if smaller else 1.0 + error
    try:
        found = fit(points, {name: scale * tip for name, tip in touched(T, points).items()})
    except RegistrationRefused:  # too near each other then
        assume(False)
    assert found.scale == pytest.approx(scale)
    with pytest.raises(RegistrationRefused, match=re.escape(f"{100 * (scale - 1):+.1f} %")):
        check(found, points)


@given(stands(most_deg=30.0), st.sampled_from([0, 2]))
def test_a_mirrored_sheet_is_refused(T, axis):
    """Its points lie in a plane, so the mirrored ones fit a tracker that stands upside down or back to front."""
    mirror = np.ones(3)
    mirror[axis] = -1.0
    mirrored = {name: tuple(mirror * p) for name, p in SHEET.items()}
    with pytest.raises(RegistrationRefused):
        check(fit(SHEET, touched(T, mirrored)))


@given(stands(), st.sampled_from([1, 2]))
def test_the_sheet_in_another_order_is_refused(T, step):
    names = list(SHEET)
    tips = touched(T, SHEET)
    rolled = {name: tips[names[(i + step) % 4]] for i, name in enumerate(names)}
    found = fit(SHEET, rolled)
    turn = np.degrees(rotation_angle(found.T_desk_leap[:3, :3]))
    assert turn > MAX_TURN_DEG or found.residuals.max() > LIMIT_M
    with pytest.raises(RegistrationRefused):
        check(found)


@given(directions, unit_cube, st.integers(3, 6), st.floats(0.06, 0.2), st.floats(-3e-3, 3e-3))
def test_points_on_a_line_are_refused(along, start, n, step, off):
    across = np.cross(along, [along[1], -along[0], 0.3])
    points = {f"P{i}": tuple(start + step * i * along + off * across * (i % 2)) for i in range(n)}
    with pytest.raises(RegistrationRefused, match="one line"):
        check_points(points)
    with pytest.raises(RegistrationRefused, match="one line"):
        fit(dict(list(SHEET.items())[:3]), dict(zip(SHEET, map(np.array, list(points.values())[:3]))))


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ({"a": (0, 0, 0), "b": (0.1, 0, 0)}, "at least 3"),
        ({"a": (0, 0, 0), "b": (0.1, 0, 0), "c": (0.1, 0.03, 0)}, "b and c are 30 mm apart"),
        ({"a": (0, 0, 0), "b": (0.1, 0, 0), "c": (0.1, float("nan"), 0)}, "nan"),
    ],
)
def test_points_that_cannot_be_used(points, words):
    with pytest.raises(RegistrationRefused, match=words):
        check_points(points)


@given(stands(), st.floats(0.05, 0.4))
def test_a_level_needs_one_height_only(T, height):
    found = fit_level(touched(T, sheet_points(height)))
    assert tilt_deg(found.T_desk_leap) == pytest.approx(tilt_deg(T), abs=1e-4)
    assert_allclose(found.T_desk_leap[1, :3], T[1, :3], atol=1e-6)  # the vertical in the tracker's axes
    assert not found.T_desk_leap[:3, 3].any() and found.residuals.max() < 1e-9
    turn = np.degrees(rotation_angle(check_rotation(found.T_desk_leap[:3, :3], 1e-9)))
    assert turn == pytest.approx(tilt_deg(T), abs=1e-4)  # no rotation about the vertical beside it


def frames(operator=None, seconds=0.3, act=lambda guided: guided.show()):
    """Frames of the simulated service with a guided hand."""
    guided = GuidedOperator(operator or ScriptedOperator(Script()))
    playback = Playback(guided)
    act(guided)
    texts = [playback.next().text for _ in range(round(seconds * 115.0))]
    return [read_message(text) for text in texts]


@pytest.fixture(scope="module", params=["right", "left"])
def frame(request):
    return frames(ScriptedOperator(Script(), side=request.param))[-1]


@given(T=stands())
def test_every_part_of_a_hand_moves_as_one_body(frame, T):
    hand, moved = frame.hands[0], registered(frame, T).hands[0]
    for array in ("palm", "sphere_center"):
        assert_allclose(getattr(moved, array), (T @ [*getattr(hand, array), 1.0])[:3], atol=1e-12)
    for array in ("normal", "direction", "velocity"):
        assert_allclose(getattr(moved, array), T[:3, :3] @ getattr(hand, array), atol=1e-12)
    for now, then in zip((*moved.fingers, moved.arm), (*hand.fingers, hand.arm)):
        bones = zip((now,), (then,)) if now is moved.arm else zip(now.bones, then.bones)
        for bone, was in bones:
            assert_allclose(bone.start, (T @ [*was.start, 1.0])[:3], atol=1e-12)
            assert_allclose(bone.end, (T @ [*was.end, 1.0])[:3], atol=1e-12)
            check_rotation(bone.rotation, 1e-4)
            assert_allclose(bone.rotation, T[:3, :3] @ was.rotation, atol=1e-12)
    for now, then in zip(moved.fingers, hand.fingers):
        assert_allclose(now.tip, (T @ [*then.tip, 1.0])[:3], atol=1e-12)
        assert (now.id, now.type, now.extended, now.length) == (then.id, then.type, then.extended, then.length)
    assert (moved.id, moved.side, moved.grab) == (hand.id, hand.side, hand.grab)


def test_what_the_service_does_not_report_stays_unknown(frame):
    bare = dataclasses.replace(frame.hands[0], arm=None, sphere_radius=0.0, sphere_center=np.zeros(3), fingers=())
    hand = registered(dataclasses.replace(frame, hands=(bare,)), pose(p=(0.1, 0.2, 0.3))).hands[0]
    assert hand.arm is None and not hand.sphere_center.any() and hand.fingers == ()


def test_a_still_finger_is_averaged():
    seen = frames(seconds=1.0)
    tips = np.array([seen_frame.hands[0].fingers[1].tip for seen_frame in seen])
    assert_allclose(still_tip(seen), tips.mean(axis=0), atol=1e-3)


def moving(guided):
    guided.show()
    guided.reach(right=0.03, seconds=1.0)


def both(guided):
    guided.show()
    guided.second(0.0)


@pytest.mark.parametrize(
    ("seen", "words"),
    [
        (lambda: frames(seconds=1.0, act=moving), "moved by"),
        (lambda: frames(act=both), "Two hands"),
        (lambda: frames(act=lambda guided: guided.show(curl=1.0)), "not stretched"),
        (lambda: frames(act=lambda guided: None), "does not see"),
        (lambda: frames()[: MIN_FRAMES - 1], "Only 9 frames"),
        (lambda: [], "Only 0 frames"),
        (
            lambda: [
                *frames(),
                *(dataclasses.replace(f, hands=(dataclasses.replace(f.hands[0], id=9),)) for f in frames()),
            ],
            "lost the hand",
        ),
        (
            lambda: [
                dataclasses.replace(f, hands=(dataclasses.replace(f.hands[0], confidence=0.1),)) for f in frames()
            ],
            "unsure",
        ),
        (
            lambda: [dataclasses.replace(f, hands=(dataclasses.replace(f.hands[0], fingers=()),)) for f in frames()],
            "not",
        ),
    ],
)
def test_a_hand_that_shows_no_point_is_refused_with_a_sentence(seen, words):
    with pytest.raises(RegistrationRefused, match=words):
        still_tip(seen())


@settings(max_examples=5)
@given(stands(most_deg=40.0), st.sampled_from(["right", "left"]))
def test_a_tilted_and_moved_tracker_of_the_simulated_service_is_found(T, side):
    """With the noise and wander of a real hand; the sheet's points stand where the guided hand reaches."""
    T_mm = T.copy()
    T_mm[:3, 3] *= 1e3
    operator = ScriptedOperator(Script(), side=side, centre=(0.0, 0.0, 0.0), T_desk_leap=T_mm)
    tip = operator.pose(np.zeros(7))
    tip = 1e-3 * dataclasses.replace(operator, T_desk_leap=None).hand_model.place(tip).tips[1]

    def at(point):
        right, up, back = np.array(point) + ABOVE - tip
        return frames(operator, 0.25, lambda guided: guided.show(right=right, up=up, back=back))

    shown = {name: at(point) for name, point in SHEET.items()}
    found = fit(SHEET, {name: still_tip(seen) for name, seen in shown.items()})
    check(found)
    hand = registered(shown["far left"][-1], found.T_desk_leap).hands[0]
    assert_allclose(hand.fingers[1].tip, np.array(SHEET["far left"]) + ABOVE, atol=8e-3)
    assert np.degrees(rotation_angle(found.T_desk_leap[:3, :3].T @ T[:3, :3])) < 3.0
    assert abs(hand.pitch) < np.radians(4.0) and abs(hand.roll) < np.radians(4.0)  # level again
    found = fit_level({name: still_tip(seen) for name, seen in shown.items()})
    hand = registered(shown["far left"][-1], found.T_desk_leap).hands[0]
    assert abs(hand.roll) < np.radians(5.0) and abs(np.arcsin(hand.direction[1])) < np.radians(5.0)
