"""The choice among hands and the watch over the stream of tracking frames."""

from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.hand_tracking import MAX_SKEW_S, FrameWatch, HandChoice


@dataclass(frozen=True)
class Hand:
    id: int
    is_left: bool = False


@given(st.lists(st.sets(st.integers(0, 5), max_size=2), max_size=30))
def test_the_chosen_hand_stays_chosen_as_long_as_it_is_visible(frames):
    choice = HandChoice()
    before = None
    for ids in frames:
        chosen = choice.choose([Hand(i) for i in sorted(ids, reverse=True)])
        assert (chosen is None) == (not ids)
        if before is not None and before.id in ids:
            assert chosen == before
        before = chosen


def test_the_order_of_appearance_counts_and_not_the_id():
    choice = HandChoice()
    choice.choose([Hand(30)])
    assert choice.choose([Hand(7), Hand(30)]) == Hand(30)
    assert choice.choose([Hand(7)]) == Hand(7)
    assert choice.choose([Hand(7), Hand(30)]) == Hand(7)


def test_hands_that_appear_together_are_ordered_by_id():
    assert HandChoice().choose([Hand(9), Hand(4)]) == Hand(4)


def test_a_hand_that_changes_its_side_is_another_hand():
    choice = HandChoice()
    choice.choose([Hand(4)])
    choice.choose([Hand(4), Hand(5)])
    assert choice.choose([Hand(4, is_left=True), Hand(5)]) == Hand(5)


def test_a_frame_without_hands_forgets_the_order():
    choice = HandChoice()
    choice.choose([Hand(9)])
    choice.choose([])
    assert choice.choose([Hand(9), Hand(4)]) == Hand(4)


def test_frames_in_order_are_usable():
    watch = FrameWatch(0.2)
    for i in range(10):
        arrival = watch.arrived(i, 0.001, 10.0 + 0.01 * i)
        assert arrival.usable and arrival.broken is None


def test_a_repeated_frame_is_left_aside_and_does_not_end_the_silence():
    watch = FrameWatch(0.2)
    watch.arrived(1, 0.0, 0.0)
    for now in (0.1, 0.2, 0.25):
        arrival = watch.arrived(1, 0.0, now)
        assert not arrival.usable and arrival.broken is None
    assert watch.silence(0.25) == "the tracker repeats frame 1"
    assert watch.silence(0.5) == "no tracking frames come in"


@pytest.mark.parametrize("age, word", [(0.7, "old"), (-3.0, "future"), (float("nan"), "stamp")])
def test_a_stamp_far_from_now_is_refused_with_the_skew(age, word):
    watch = FrameWatch(0.2)
    arrival = watch.arrived(1, age, 0.0)
    assert not arrival.usable and word in arrival.broken
    assert watch.silence(0.0) == arrival.broken


@given(st.floats(-MAX_SKEW_S, MAX_SKEW_S))
def test_a_stamp_near_now_is_taken(age):
    assert FrameWatch(0.2).arrived(1, age, 0.0).usable


def test_gaps_and_restarts_break_the_stream():
    watch = FrameWatch(0.2)
    assert watch.arrived(5, 0.0, 0.0).broken is None
    assert "0.3 s" in watch.arrived(6, 0.0, 0.3).broken
    assert "from 6 to 2" in watch.arrived(2, 0.0, 0.31).broken
    assert watch.arrived(3, 0.0, 0.32).broken is None


def test_silence():
    watch = FrameWatch(0.2)
    assert watch.silence(0.0)
    watch.arrived(1, 0.0, 0.0)
    assert watch.silence(0.2) is None
    assert watch.silence(0.21) == "no tracking frames come in"
