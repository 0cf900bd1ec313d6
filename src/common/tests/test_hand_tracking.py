"""The lock on one hand and the watch over the stream of tracking frames."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.hand_tracking import LEFT_BOX_FRAMES, FrameWatch, HandLock
from common.numbers import STAMP_SKEW_S

GAP = 0.2


@dataclass(frozen=True)
class Hand:
    id: int
    is_left: bool = False
    palm: np.ndarray = field(default_factory=lambda: np.zeros(3), compare=False)
    direction: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -1.0]), compare=False)
    normal: np.ndarray = field(default_factory=lambda: np.array([0.0, -1.0, 0.0]), compare=False)


def at(id, x, is_left=False):
    return Hand(id, is_left, np.array([x, 0.0, 0.0]))


def outside(palm):
    """Of a box of 0.2 m around the origin, along x."""
    return abs(palm[0]) - 0.1


class Frames:
    """Feeds a lock at 100 Hz."""

    def __init__(self, *box):
        self.lock, self.now = HandLock(GAP, *box), 10.0

    def see(self, *hands, frames=1):
        chosen = None
        for _ in range(frames):
            self.now += 0.01
            chosen = self.lock.update(hands, self.now)
        return chosen


@given(st.lists(st.sets(st.integers(0, 5), max_size=3), max_size=30))
def test_the_owner_stays_the_owner_while_it_is_missing_for_less_than_the_gap(frames):
    view = Frames()
    apart = {i: at(i, 0.2 * i) for i in range(6)}
    owner = view.see(apart[0], apart[1])
    view.lock.engage()
    missing = 0
    for ids in frames:
        chosen = view.see(*(apart[i] for i in ids))
        missing = 0 if 0 in ids else missing + 1
        if 0.01 * (missing + 1) > GAP:
            break
        assert view.lock.engaged and not view.lock.changed
        assert chosen == (owner if 0 in ids else None)


def test_the_order_of_appearance_counts_and_not_the_id():
    view = Frames()
    view.see(at(30, 0.5))
    assert view.see(at(7, 0.0), at(30, 0.5)) == Hand(30)
    assert view.see(at(7, 0.0), frames=30) == Hand(7)
    assert view.see(at(7, 0.0), at(31, 0.5)) == Hand(7)


def test_hands_that_appear_together_are_ordered_by_id():
    assert Frames().see(at(9, 0.5), at(4, 0.0)) == Hand(4)


def test_a_hand_that_changes_its_side_is_another_hand():
    view = Frames()
    view.see(Hand(4))
    view.lock.engage()
    assert view.see(Hand(4, is_left=True), frames=20) is None and view.lock.engaged
    view.see(Hand(4, is_left=True), frames=2)
    assert not view.lock.engaged and not view.lock.came_in


@pytest.mark.parametrize(
    "step, turn, missing, follows",
    [
        (0.0, 0.0, 0, True), (0.019, 0.0, 0, True), (0.022, 0.0, 0, False), (0.065, 0.0, 5, True),
        (0.075, 0.0, 5, False), (0.055, 0.0, 18, True), (0.065, 0.0, 18, False), (0.0, 18.0, 0, True),
        (0.0, 22.0, 0, False), (0.0, 0.0, 21, False), (np.nan, 0.0, 0, False),
    ],
)  # fmt: skip
def test_a_hand_with_a_new_id_is_the_owner_if_it_is_near_in_place_orientation_and_time(step, turn, missing, follows):
    """Reported in https://github.com/logotype/LeapMotionAS3/issues/10: the id of a hand changes while it stays in
    view. Tried: a new id in the same place.
    """
    view = Frames()
    view.see(at(4, 0.0))
    view.lock.engage()
    view.see(frames=missing)
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    new = Hand(5, False, np.array([step, 0.0, 0.0]), np.array([s, 0.0, -c]))
    assert (view.see(new) == new and view.lock.engaged) == follows


def test_a_hand_that_was_in_view_before_is_not_a_successor():
    """Two hands one upon the other, and the lower one is lost."""
    view = Frames()
    view.see(at(4, 0.0), at(5, 0.01))
    view.lock.engage()
    assert view.see(at(5, 0.01), frames=30) == Hand(5) and not view.lock.engaged and not view.lock.came_in


def test_with_a_box_a_hand_must_come_in_from_outside_after_an_end():
    view = Frames(outside)
    view.see(at(4, 0.0), at(5, 0.08))
    assert view.lock.came_in, "the first engagement takes any hand"
    view.lock.engage()
    view.see(at(5, 0.08), frames=30)
    assert not view.lock.engaged and not view.lock.came_in
    view.see(at(5, 0.0), at(6, 0.05), frames=30)
    assert not view.lock.came_in, "one that was there, and one that was found there"
    view.see(at(5, 0.11), frames=50)
    view.see(at(5, 0.13), frames=LEFT_BOX_FRAMES - 1)
    view.see(at(5, 0.09))
    assert not view.lock.came_in, "the edge and two outliers"
    view.see(at(5, 0.13), frames=LEFT_BOX_FRAMES)
    assert view.see(at(5, 0.09), at(6, 0.0)) == Hand(5) and view.lock.came_in
    assert view.see(at(8, 0.08), at(6, 0.0)) == Hand(8) and view.lock.came_in, "also under a new id"


def test_without_a_box_a_hand_must_come_into_view_after_an_end():
    view = Frames()
    view.see(at(4, 0.0), at(5, 0.3))
    view.lock.engage()
    view.see(at(5, 0.3), frames=30)
    assert not view.lock.came_in
    view.see(at(6, 0.31), frames=2)
    assert not view.lock.came_in, "a new id of the one that was there"
    assert view.see(at(6, 0.31), at(7, 0.0)) == Hand(7) and view.lock.came_in


def test_a_hand_in_the_box_counts_before_one_beside_it():
    view = Frames(outside)
    view.see(at(4, 0.3), frames=50)
    assert view.see(at(4, 0.3), at(5, 0.0)) == Hand(5)
    view.lock.engage()
    assert view.see(at(4, 0.0), at(5, 0.3)) == Hand(5), "but not before the owner"


@given(st.lists(st.floats(0.001, 0.3), min_size=5, max_size=60))
def test_the_frame_rate_is_that_of_the_last_half_second_and_the_frame_before(intervals):
    watch, now, times = FrameWatch(10.0), 100.0, []
    for i, interval in enumerate(intervals):
        now += interval
        times.append(now)
        watch.arrived(i, 0.0, now)
    newest = [t for t, following in zip(times, [*times[1:], now]) if now - following < 0.5]
    if len(newest) >= 3:
        assert watch.rate == pytest.approx((len(newest) - 1) / (newest[-1] - newest[0]))
    else:
        assert watch.rate is None


def test_stamps_never_go_back():
    """Where the clock of the stamps is read a moment before the one of the arrival."""
    watch = FrameWatch(0.2)
    stamps = [watch.arrived(i, age, 1.0 + 0.01 * i).stamp for i, age in enumerate((0.0, -0.03, 0.0, 0.0, 0.0))]
    assert stamps == pytest.approx([1.0, 1.04, 1.04, 1.04, 1.04])


def test_a_repeated_frame_is_left_aside_and_does_not_end_the_silence():
    watch = FrameWatch(0.2)
    watch.arrived(1, 0.0, 0.0)
    for now in (0.1, 0.2, 0.25):
        arrival = watch.arrived(1, 0.0, now)
        assert not arrival.usable and arrival.broken is None
    assert watch.silence(0.25) == "the tracker repeats frame 1"
    assert watch.silence(0.5) == "no tracking frames come in"


@pytest.mark.parametrize("age, word", [(0.7, "old"), (-3.0, "future"), (float("nan"), "stamp")])
def test_a_stamp_far_from_now_is_refused_with_the_skew_and_does_not_end_the_silence(age, word):
    watch = FrameWatch(0.2)
    assert not watch.arrived(1, age, 0.0).usable and word in watch.silence(0.0)
    assert watch.arrived(2, 0.0, 0.01).usable
    for now in (0.1, 0.2, 0.25):
        assert not watch.arrived(3, age, now).usable
    assert word in watch.silence(0.25)


@pytest.mark.parametrize("age", [2.0, -2.0])
def test_a_frame_that_was_on_its_way_when_the_wall_clock_was_set_does_not_break_the_stream(age):
    watch = FrameWatch(0.2)
    for i in range(10):
        arrival = watch.arrived(i, age if i == 5 else 0.0, 0.01 * i)
        assert arrival.usable is (i != 5) and arrival.broken is None
        assert watch.silence(0.01 * i) is None


@given(st.floats(-STAMP_SKEW_S, STAMP_SKEW_S))
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
