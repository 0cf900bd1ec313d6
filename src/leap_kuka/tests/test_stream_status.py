"""The published state of the stream is also a heartbeat."""

import numpy as np
import pytest

pytest.importorskip("rospy")
from leap_kuka.ros import stream_status
from leap_kuka.start_gate import InteractionBox
from leap_kuka.teleop_result import StreamState, TeleopResult

pytestmark = pytest.mark.ros


def test_the_state_is_published_again_although_nothing_changes(monkeypatch):
    sent, clock = [], [100.0]

    class Publisher:
        def __init__(self, name, *_, **__):
            self.publish = lambda message: sent.append((name, clock[0]))

    monkeypatch.setattr(stream_status.rospy, "Publisher", Publisher)
    monkeypatch.setattr(stream_status.clock, "monotonic", lambda: clock[0])
    status = stream_status.StreamStatus(InteractionBox(np.zeros(3), np.ones(3)), "leap")
    status.flush()
    assert not sent
    status.update(TeleopResult(StreamState.WAITING, "no hand is seen", True, np.eye(4)))
    for _ in range(50):
        clock[0] += 0.1
        status.flush()
    times = [at for name, at in sent if name == "leap_kuka/stream"]
    assert 9 <= len(times) <= 11 and max(np.diff(times)) < 0.7
