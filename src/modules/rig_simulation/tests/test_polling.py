"""A simulated device that starts is waited for without a word; one that stays silent is complained of."""

from __future__ import annotations

import pytest

pytest.importorskip("rig_msgs.msg")
import rospy

from common import clock
from common.errors import DeviceError
from rig_simulation.ros.monitors import poll

pytestmark = pytest.mark.ros
PERIOD_S, RETRY_PERIOD_S, START_S = 0.25, 0.5, 5.0


class Device:
    """Answers between two times [s] after its start; notes when it is asked. The third answer takes `slow` [s]."""

    def __init__(self, begin, end, slow=0.0):
        self._from, self._until, self._slow, self.asked = begin, end, slow, []
        self._began = clock.monotonic()

    def publish(self):
        past = clock.monotonic() - self._began
        self.asked.append(round(past, 6))
        if len(self.asked) == 2:
            clock.sleep(self._slow)
        if not self._from <= past < self._until:
            raise DeviceError("It does not answer.")


@pytest.fixture
def polled(virtual_graph):
    """Lets a node poll a device; returns what the node says after some seconds."""

    def polled(device, seconds):
        def main():
            rospy.init_node("monitor")
            poll(device.publish, PERIOD_S)

        node = virtual_graph.start("monitor", main, "monitor")
        clock.sleep(seconds)
        return node.log_path.read_text()

    return polled


@pytest.mark.parametrize(
    ("answers", "end", "warned"),
    [
        ((0.0, 0.0), START_S + 0.1, 0),
        ((0.0, 0.0), START_S + RETRY_PERIOD_S + 0.1, 1),
        ((START_S, 1.1 * START_S), 2.0 * START_S, 0),
        ((START_S, 1.1 * START_S), 2.1 * START_S + RETRY_PERIOD_S, 1),
        ((0.0, 0.0), START_S + RETRY_PERIOD_S + 10.4, 1),
        ((0.0, 0.0), START_S + RETRY_PERIOD_S + 10.6, 2),
    ],
)
def test_only_a_silence_that_lasts_is_said_every_ten_seconds(polled, answers, end, warned):
    assert polled(Device(*answers), end).count("It does not answer.") == warned


def test_a_device_that_answers_is_asked_at_the_rate_and_a_silent_one_seldom(polled):
    device = Device(1.0, 2.0)
    polled(device, 2.6)
    assert device.asked == [0.0, 0.5, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5]


def test_time_that_was_lost_is_not_made_up_for(polled):
    device = Device(0.0, 9.0, slow=1.0)
    polled(device, 2.1)
    assert device.asked == [0.0, 0.25, 1.25, 1.5, 1.75, 2.0]
