"""Which desired tool frames count."""

from __future__ import annotations

import numpy as np
import pytest

from common.poses import pose
from kuka_control.model.desired_frame import DesiredFrame, DesiredStream

CLOCK = 1.7e9


def desired(stamp, p=(0.5, 0.0, 0.4), R=None):
    return DesiredFrame(pose(R, p), stamp)


def test_only_another_stamp_is_new():
    stream = DesiredStream()
    assert stream.take(None, CLOCK, 0.0).fresh is None
    assert stream.take(desired(CLOCK), CLOCK, 1.0).fresh.stamp == CLOCK
    assert stream.take(desired(CLOCK, (0.6, 0.0, 0.4)), CLOCK + 0.1, 1.1).fresh is None
    assert stream.take(desired(CLOCK + 0.1), CLOCK + 0.1, 1.2).fresh is not None


def test_silence_counts_from_the_last_new_stamp():
    stream = DesiredStream()
    assert stream.silence == float("inf")
    stream.take(desired(CLOCK), CLOCK, 1.0)
    stream.take(desired(CLOCK), CLOCK, 1.3)
    assert stream.silence == pytest.approx(0.3)


def looked_at(stream, start, seconds, frames, skew=0.0):
    """Looks every 10 ms; returns the time of the end."""
    for i in range(round(seconds / 0.01)):
        now = start + 0.01 * i
        stream.take(desired(CLOCK + now + skew) if frames else None, CLOCK + now, now)
    return start + seconds


@pytest.mark.parametrize("unseen", ["refused frames", "stall of the loop"])
def test_neither_refused_frames_nor_a_stall_begin_a_new_stream(unseen):
    stream = DesiredStream()
    now = looked_at(stream, 0.0, 0.5, frames=True)
    now = looked_at(stream, now, 0.5, frames=True, skew=-9.0) if unseen == "refused frames" else now + 2.0
    looked_at(stream, now, 0.1, frames=True)
    assert stream.number == 0


@pytest.mark.hazard(10)
@pytest.mark.parametrize("skew, side", [(-0.6, "behind"), (0.6, "ahead of"), (-1.6e9, "behind")])
def test_old_and_future_stamps_are_refused_with_the_measured_skew_once(skew, side):
    stream = DesiredStream()
    taken = stream.take(desired(CLOCK + skew), CLOCK, 0.0)
    assert taken.fresh is None and side in taken.refused and f"{abs(skew):.3f} s" in taken.refused
    assert stream.take(desired(CLOCK + skew + 0.01), CLOCK + 0.01, 0.01).refused is None
    assert stream.silence == float("inf")
    assert stream.take(desired(CLOCK + 0.02), CLOCK + 0.02, 0.02).fresh is not None
    assert stream.take(desired(CLOCK + skew), CLOCK, 0.03).refused is not None


def test_each_reason_among_frames_refused_in_a_row_is_said_once():
    stream = DesiredStream()
    refused = []
    for k in range(12):
        frame = DesiredFrame(np.eye(4), CLOCK + k, refused="it is not finite") if k % 3 else desired(CLOCK - 2.0 - k)
        refused.append(stream.take(frame, CLOCK + k, 0.01 * k).refused)
    assert [sentence is not None for sentence in refused] == [True, True] + 10 * [False]
    assert "behind" in refused[0] and refused[1] == "it is not finite"


@pytest.mark.parametrize(
    "frame, word",
    [
        (desired(CLOCK, (np.nan, 0.0, 0.4)), "finite"),
        (desired(CLOCK, (500.0, 0.0, 400.0)), "metres"),
        (desired(CLOCK, R=2.0 * np.eye(3)), "orthonormal"),
        (desired(CLOCK, R=np.diag([1.0, 1.0, -1.0])), "reflection"),
    ],
)
def test_frames_that_are_none_are_refused(frame, word):
    taken = DesiredStream().take(frame, CLOCK, 0.0)
    assert taken.fresh is None and word in taken.refused
