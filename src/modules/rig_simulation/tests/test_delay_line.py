"""Messages that wait."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from rig_simulation.faults.injection import DelayLine


def test_messages_come_when_they_are_due():
    line = DelayLine()
    line.put("a", 1.0)
    line.put("b", 2.0)
    assert (line.next_due(), line.take(0.9)) == (1.0, [])
    assert line.take(1.0) == ["a"]
    assert line.take(5.0) == ["b"]
    assert (line.next_due(), line.take(9.0)) == (math.inf, [])


@given(st.lists(st.floats(0.0, 10.0)), st.lists(st.floats(0.0, 20.0)))
def test_none_is_lost_and_none_overtakes(dues, times):
    line = DelayLine()
    for i, due in enumerate(dues):
        line.put(i, due)
    taken = [message for now in [*sorted(times), 20.0] for message in line.take(now)]
    assert taken == list(range(len(dues)))


def test_what_is_cleared_never_comes():
    line = DelayLine()
    line.put("a", 1.0)
    line.clear()
    assert line.take(2.0) == []
