"""Laws of the actions of a program that steers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from common.action_stream import FADE_S, MAX_AHEAD_S, MOST_ACTIONS, ActionChunk, ActionStream, check_chunk
from common.poses import pose
from common.rotations import rotation_about, rotation_angle

NOW = 100.0


def chunk(start=NOW, period=0.1, count=5, from_z=0.3, step=0.01, fingers=4) -> ActionChunk:
    T = np.array([pose(rotation_about(2, 0.2 * i), (0.4, 0.0, from_z + step * i)) for i in range(count)])
    return ActionChunk(start, period, T, np.tile(0.1 * np.arange(count)[:, None], (1, fingers)))


def stream(*chunks: ActionChunk) -> ActionStream:
    of = ActionStream()
    for one in chunks:
        of.take(one, max(one.start, NOW))
    return of


def test_at_each_actions_time_it_holds_and_between_two_what_is_between():
    of, wanted = stream(chunk()), chunk()
    for i in range(5):
        found = of.at(NOW + 0.1 * i)
        np.testing.assert_allclose(found.T_base_tool, wanted.T_base_tool[i], atol=1e-9)
        np.testing.assert_allclose(found.fingers, wanted.fingers[i], atol=1e-9)
    half = of.at(NOW + 0.25)
    assert half.T_base_tool[2, 3] == pytest.approx(0.325) and half.fingers == pytest.approx(0.25 * np.ones(4))
    assert rotation_angle(rotation_about(2, -0.5) @ half.T_base_tool[:3, :3]) < 1e-9


def test_before_the_first_action_it_holds_already_and_after_the_last_ones_period_none():
    of = stream(chunk(start=NOW + 0.4))
    np.testing.assert_allclose(of.at(NOW).T_base_tool, chunk().T_base_tool[0])
    assert of.at(NOW + 0.89) is not None and of.at(NOW + 0.9) is None
    assert ActionStream().at(NOW) is None


@pytest.mark.parametrize("at", np.linspace(0.0, 0.4, 9))
def test_a_chunk_that_follows_another_brings_no_jump(at):
    of, step = stream(chunk()), 1e-3
    before = of.at(NOW + at).T_base_tool
    of.take(chunk(start=NOW + at, from_z=0.36), NOW + at)
    np.testing.assert_allclose(of.at(NOW + at).T_base_tool, before, atol=1e-9)
    times = NOW + at + np.arange(0.0, 0.2, step)
    heights = [of.at(t).T_base_tool[2, 3] for t in times]
    assert np.abs(np.diff(heights)).max() <= step * (0.06 / FADE_S + 0.3)
    after = of.at(NOW + at + FADE_S)
    np.testing.assert_allclose(after.T_base_tool, chunk(from_z=0.36).T_base_tool[1], atol=1e-9)


def test_the_fingers_stay_for_a_chunk_without_them():
    assert stream(chunk(fingers=0)).at(NOW).fingers.shape == (0,)
    of = stream(chunk())
    of.take(chunk(start=NOW + 0.1, fingers=0), NOW + 0.1)
    assert of.at(NOW + 0.12).fingers.shape == (0,)


def bad_pose(value: float) -> np.ndarray:
    T = chunk().T_base_tool.copy()
    T[3, 0, 3] = value
    return T


REFUSED = {
    "has 0 actions": chunk(count=0),
    f"has {MOST_ACTIONS + 1} actions": chunk(count=MOST_ACTIONS + 1),
    "period is nan": chunk(period=float("nan")),
    "period is 0 s": chunk(period=0.0),
    "came 0.50 s after its end": chunk(start=NOW - 1.0),
    "came nan s": chunk(start=float("nan")),
    f"begins in {MAX_AHEAD_S + 0.1:.2f} s": chunk(start=NOW + MAX_AHEAD_S + 0.1),
    "has 15 finger commands": chunk(fingers=3),
    "not a finite number": replace(chunk(), fingers=np.full((5, 4), np.inf)),
    "4 x 4 finite numbers": replace(chunk(), T_base_tool=bad_pose(np.nan)),
    "not orthonormal": replace(
        chunk(), T_base_tool=2.0 * np.tile(np.eye(4), (5, 1, 1)) - np.diag([0.0, 0.0, 0.0, 1.0])
    ),
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_is_refused_is_named(sentence):
    check_chunk(chunk(), 4, NOW)
    with pytest.raises(ValueError, match=sentence):
        check_chunk(REFUSED[sentence], 4, NOW)


def test_actions_that_come_faster_than_they_fade_move_evenly():
    """Single actions, 30 in a second, of a policy that moves with 0.6 m/s."""
    of, places, frame = ActionStream(), [], 0.009
    for k in range(60):
        T = pose(p=(0.6 * k / 30.0, 0.0, 0.0))[None]
        of.take(ActionChunk(NOW + k / 30.0, 0.3, T, np.zeros((1, 0))), NOW + k / 30.0)
        places += [of.at(NOW + k / 30.0 + dt).T_base_tool[0, 3] for dt in (0.0, 0.009, 0.018, 0.027)]
    steps = np.diff(places[20:])
    assert steps.min() >= 0.0 and steps.max() < 1.3 * 0.6 * frame


def test_a_program_that_is_gone_brings_the_tool_no_further_than_its_chunk():
    of = stream(chunk())
    assert [of.at(NOW + t) is None for t in (0.49, 0.5, 5.0)] == [False, True, True]
    with pytest.raises(ValueError, match="it lasts 5.0 s, and at most 2 s"):
        check_chunk(chunk(period=1.0), 4, NOW)
