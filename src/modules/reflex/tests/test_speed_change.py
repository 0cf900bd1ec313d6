"""A change of speed: three packets, each after its pause however late it is asked for."""

import pytest

from reflex.motion import MotorSpeedChange

PACKETS = [bytes.fromhex(text) for text in ("0101010101", "02 0164 0564 0164 04fb", "0102020202")]


@pytest.mark.parametrize("poll", [0.001, 0.005, 0.05])
def test_packets_keep_their_pauses(poll):
    change, now, sent = MotorSpeedChange((3, 3, 3, 2), 10.0), 10.0, []
    while not change.done:
        sent += [(now, packet) for packet in change.step(now)]
        now += poll
    assert [packet for _, packet in sent] == PACKETS
    times = [time for time, _ in sent]
    assert times[1] - times[0] >= 0.0199 and times[2] - times[1] >= 0.0349 and now - times[2] >= 0.0349
    if poll < 0.01:
        assert now - 10.0 == pytest.approx(0.09, abs=0.02)
