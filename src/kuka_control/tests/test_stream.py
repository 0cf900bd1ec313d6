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
    assert stream.silent_for(5.0) == float("inf")
    stream.take(desired(CLOCK), CLOCK, 1.0)
    stream.take(desired(CLOCK), CLOCK, 1.3)
    assert stream.silent_for(1.5) == pytest.approx(0.5)


@pytest.mark.parametrize("skew, side", [(-0.6, "behind"), (0.6, "ahead of"), (-1.7e9, "behind")])
def test_old_and_future_stamps_are_refused_with_the_measured_skew_once(skew, side):
    stream = DesiredStream()
    taken = stream.take(desired(CLOCK + skew), CLOCK, 0.0)
    assert taken.fresh is None and side in taken.refused and f"{abs(skew):.3f} s" in taken.refused
    assert stream.take(desired(CLOCK + skew + 0.01), CLOCK + 0.01, 0.01).refused is None
    assert stream.silent_for(0.01) == float("inf")
    assert stream.take(desired(CLOCK + 0.02), CLOCK + 0.02, 0.02).fresh is not None
    assert stream.take(desired(CLOCK + skew), CLOCK, 0.03).refused is not None


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
