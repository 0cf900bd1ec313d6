"""Two arms and one tracker: each arm follows the hand of its side as if the other one were not there."""

import dataclasses

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from common.poses import translation
from leap_kuka.teleop import ArmTeleop
from leap_kuka.teleop_result import StreamState
from leap_motion.frames import TrackingFrame

OFFSET = {"left": -0.15, "right": 0.15}
LEFT_ID, RIGHT_ID = 5, 6
PHASES = st.lists(
    st.tuples(
        st.integers(1, 40),  # frames
        st.sampled_from(["away", "in", "beside", "tilted", "unsure", "in the other box", "renumbered"]),
        st.floats(0.0, 1.0),  # grab
    ),
    min_size=1,
    max_size=6,
)
"""What one hand does, one phase after the other."""
RELATIVE = {"engagement": "relative", "hold_time": 1.0}


def hands_of(side, phases, sample):
    """The hand of a side, or None, frame by frame."""
    is_left, number = side == "left", LEFT_ID if side == "left" else RIGHT_ID
    far = sample(position=(OFFSET[side], 0.35, 0.3), id=number, is_left=is_left)
    yield from (far, far, far, None)  # it comes in while control is on
    for frames, what, grab in phases:
        number += 10 * (what == "renumbered")
        x = -OFFSET[side] if what == "in the other box" else OFFSET[side] + (0.2 if what == "beside" else 0.0)
        for i in range(frames):
            hand = sample(
                position=(x, 0.35, 0.001 * (i % 5)),
                roll=40.0 if what == "tilted" else 0.0,
                confidence=0.0 if what == "unsure" else 1.0,
                id=number,
                is_left=is_left,
                grab=grab,
            )
            yield None if what == "away" else hand


def run(teleop, frames, is_left=None):
    """The results of an arm's teleoperation, if only hands of a side are seen (None: all), control being on at home."""
    results = []
    teleop.control(False, "home", 1.0, 0.0)
    for number, hands in enumerate(frames):
        now = 50.0 + 0.01 * number
        teleop.control(True, "servo" if results and results[-1].owner else "home", 1.0, now)
        seen = tuple(hand for hand in hands if hand is not None and is_left in (None, hand.is_left))
        results.append(teleop.step(TrackingFrame(number + 1, 0.0, seen), now))
    return results


def same(one, other):
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        equal = np.array_equal(a, b) if isinstance(a, np.ndarray) and isinstance(b, np.ndarray) else a == b
        assert equal, (field.name, a, b)


def made(leap, arm, hand, **changes):
    config = leap(hand=hand, box_offset=OFFSET.get(hand, 0.0), **changes)
    return ArmTeleop(config, arm(), measured_tool=lambda: translation(0.42, -0.42, 0.4))


@settings(max_examples=40)
@given(PHASES, PHASES, st.booleans())
def test_what_one_hand_does_changes_nothing_for_the_arm_of_the_other(leap, arm, sample, left, right, relative):
    changes = RELATIVE if relative else {}
    left, right = [*hands_of("left", [(30, "in", 0.0), *left], sample)], [*hands_of("right", right, sample)]
    length = max(len(left), len(right))
    frames = [*zip(*(hands + [None] * (length - len(hands)) for hands in (left, right)))]
    for side, is_left in (("left", True), ("right", False)):
        both, alone = (run(made(leap, arm, side, **changes), frames, only) for only in (None, is_left))
        for one, other in zip(both, alone):
            same(one, other)
            assert one.owner is None or one.owner[1] is is_left
    assert any(result.state is StreamState.RUNNING for result in run(made(leap, arm, "left", **changes), frames))


def test_the_second_hand_clutches_although_it_steers_nothing(leap, arm, sample):
    teleop = made(leap, arm, "right", clutch="second_hand_fist", **RELATIVE)
    right = [*hands_of("right", [(60, "in", 0.0)], sample)]
    left = [*hands_of("left", [(30, "beside", 0.0), (30, "beside", 1.0)], sample)]
    results = run(teleop, [*zip(left, right)])
    assert results[33].follows and not results[33].clutched
    assert results[-1].clutched and not results[-1].follows
