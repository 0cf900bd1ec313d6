"""The guided person: the hand is where it was sent, moves smoothly, and comes and goes as hands do."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from leap_motion.codec import read_message
from rig_simulation.devices.leap.program import _source, parse
from rig_simulation.operator.guided import GuidedOperator, HandTarget
from rig_simulation.operator.motion import Script
from rig_simulation.operator.sources import PERIOD_S, Playback, ScriptedOperator
from rig_simulation.operator.steering import FARTHEST_M

CENTRE = np.array([0.0, 0.35, 0.0])
NOISE_M = 6e-3


@pytest.fixture
def guided():
    return GuidedOperator(ScriptedOperator(Script()))


def hands(playback, seconds):
    """The hands of the next so many seconds, None for a frame without one."""
    until = playback.next().time + seconds
    seen = []
    while True:
        frame = playback.next()
        hand = next(iter(read_message(frame.text).hands), None)
        seen.append(hand)
        if frame.time >= until:
            return seen


def test_nobody_is_there_before_a_hand_is_shown(guided):
    assert set(hands(Playback(guided), 1.0)) == {None}
    assert guided.hand() == {"in_view": False, "moving": False}


@settings(max_examples=10)
@given(
    *(st.floats(-0.3, 0.3) for _ in range(3)),
    st.floats(0.0, 1.0),
    st.floats(0.1, 1.2),
)
def test_the_hand_reaches_where_it_was_sent_without_a_step(right, up, back, curl, seconds):
    guided = GuidedOperator(ScriptedOperator(Script()))
    playback = Playback(guided)
    guided.show()
    start = hands(playback, 0.5)[-1]
    guided.reach(right=right, up=up, back=back, curl=curl, seconds=seconds)
    way = [start, *hands(playback, seconds + 0.2)]
    assert None not in way and len({hand.id for hand in way}) == 1
    palms = np.array([hand.palm for hand in way])
    target = np.array([right, up, back])
    assert_allclose(palms[-5:] - CENTRE, np.tile(target, (5, 1)), atol=NOISE_M)
    fastest = 1.875 * np.linalg.norm(target) / seconds
    steps = np.linalg.norm(np.diff(palms, axis=0), axis=1)
    assert steps.max() < 2.5 * PERIOD_S * fastest + NOISE_M
    state = guided.hand()
    assert state["in_view"] and not state["moving"]
    assert_allclose([state["right"], state["up"], state["back"], state["curl"]], [right, up, back, curl], atol=1e-9)


def test_a_new_reach_starts_where_the_last_one_was_left(guided):
    playback = Playback(guided)
    guided.show()
    hands(playback, 0.5)
    guided.reach(right=0.2, seconds=2.0)
    hands(playback, 1.0)
    half_way = guided.hand()["right"]
    assert 0.05 < half_way < 0.15
    guided.reach(right=0.0, seconds=1.0)
    palms = np.array([hand.palm[0] for hand in hands(playback, 1.2)])
    assert abs(palms[0] - half_way) < NOISE_M and abs(palms[-1]) < NOISE_M


def test_a_hand_that_leaves_fades_and_the_next_one_is_another(guided):
    playback = Playback(guided)
    guided.show(right=0.05)
    first = hands(playback, 0.5)[-1]
    guided.hide()
    fading = hands(playback, 1.0)
    seen = [hand for hand in fading if hand is not None]
    assert fading[-1] is None and seen[-1].confidence < 0.3 < seen[0].confidence
    guided.show(right=-0.05)
    other = hands(playback, 0.5)[-1]
    assert other.id != first.id and abs(other.palm[0] + 0.05) < NOISE_M


@pytest.mark.parametrize(
    "fields, said",
    [
        ({"right": math.nan}, "right"),
        ({"up": FARTHEST_M * 1.01}, "must lie in -0.5 to 0.5 m"),
        ({"curl": -0.1}, "curl"),
        ({"seconds": math.inf}, "seconds"),
        ({"right": "far"}, "right"),
        ({"left": 0.1}, "left"),
    ],
)
def test_a_bad_reach_is_refused_and_nothing_moves(guided, fields, said):
    playback = Playback(guided)
    guided.show()
    hands(playback, 0.2)
    before = guided.hand()
    with pytest.raises(ValueError, match=said.replace("[", r"\[")):
        guided.reach(**fields)
    hands(playback, 0.2)
    assert guided.hand() == before


def test_a_reach_without_a_hand_is_refused(guided):
    with pytest.raises(ValueError):
        guided.reach(right=0.1)


def test_a_reach_at_rest_takes_effect_at_once(guided):
    assert_allclose(HandTarget(right=0.1, curl=0.5).state, [100.0, 0, 0, 0, 0, 0, 0.5])
    playback = Playback(guided)
    guided.show()
    hands(playback, 0.2)
    guided.reach(right=0.1, seconds=0.0)
    assert abs(hands(playback, 0.1)[-1].palm[0] - 0.1) < NOISE_M


def test_the_second_hand_comes_beside_the_first_and_closes(guided):
    playback = Playback(guided)
    guided.show()
    guided.second(curl=0.0)
    frames = [read_message(playback.next().text).hands for _ in range(50)]
    assert {tuple(sorted(hand.side for hand in hands)) for hands in frames} == {("left", "right")}
    guided.second(curl=1.0)
    grabs = [next(h.grab for h in read_message(playback.next().text).hands if h.side == "left") for _ in range(60)]
    assert grabs[0] < 0.5 < 0.8 < grabs[-1] and max(np.diff(grabs)) < 0.2
    with pytest.raises(ValueError):
        guided.second(curl=2.0)


def test_of_two_guided_hands_each_goes_where_it_is_sent():
    source, requests = _source(parse(["--guided", "--hand", "both", "--apart", "300"]))
    playback = Playback(source)
    requests["show"](side="left")
    requests["reach"](side="left", up=0.05, seconds=0.5)
    assert requests["hand"](side="right") == {"in_view": False, "moving": False}
    requests["show"](side="right", right=0.02)
    for _ in range(200):
        frame = playback.next()
    palms = {hand["type"]: hand["palmPosition"] for hand in json.loads(frame.text)["hands"]}
    np.testing.assert_allclose([palms["left"], palms["right"]], [(-150, 400, 0), (170, 350, 0)], atol=8.0)
    requests["hide"](side="left")
    for _ in range(100):
        frame = playback.next()
    assert [hand["type"] for hand in json.loads(frame.text)["hands"]] == ["right"]
    with pytest.raises(ValueError, match="side is 'both', but must be left or right"):
        requests["show"](side="both")
