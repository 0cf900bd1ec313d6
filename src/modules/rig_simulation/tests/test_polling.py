"""A simulated device that starts is waited for without a word; one that stays silent is complained of."""

from __future__ import annotations

import pytest

pytest.importorskip("rig_msgs.msg")
from common.errors import DeviceError
from rig_simulation.ros import monitors
from rig_simulation.ros.monitors import RETRY_PERIOD_S, START_S, poll

pytestmark = pytest.mark.ros
PERIOD_S = 0.25


@pytest.fixture
def rig(monkeypatch):
    class Rig:
        """A device that answers between two times [s] and is polled for `end` seconds."""

        now = 100.0
        answers = (0.0, 0.0)
        end = 0.0
        asked: list
        warned: list

        def publish(self):
            past = self.now - 100.0
            self.asked.append(past)
            if not self.answers[0] <= past < self.answers[1]:
                raise DeviceError("It does not answer.")

        def sleep(self, seconds):
            self.now += seconds

    rig = Rig()
    rig.asked, rig.warned = [], []
    monkeypatch.setattr(monitors.clock, "monotonic", lambda: rig.now)
    monkeypatch.setattr(monitors.clock, "sleep", rig.sleep)
    monkeypatch.setattr(monitors.rospy, "is_shutdown", lambda: rig.now - 100.0 > rig.end)
    monkeypatch.setattr(monitors.rospy, "logwarn_throttle", lambda _, text, error: rig.warned.append(text % error))
    return rig


@pytest.mark.parametrize(
    ("answers", "end", "warned"),
    [
        ((0.0, 0.0), 0.9 * START_S, False),
        ((0.0, 0.0), 1.2 * START_S, True),
        ((START_S, 1.1 * START_S), 1.9 * START_S, False),
        ((START_S, 1.1 * START_S), 2.3 * START_S, True),
    ],
)
def test_only_a_silence_that_lasts_is_said(rig, answers, end, warned):
    rig.answers, rig.end = answers, end
    poll(rig.publish, PERIOD_S)
    assert set(rig.warned) == ({"It does not answer."} if warned else set())


def test_a_device_that_answers_is_asked_at_the_rate_and_a_silent_one_seldom(rig):
    rig.answers, rig.end = (1.0, 2.0), 2.6
    poll(rig.publish, PERIOD_S)
    assert rig.asked == [0.0, 0.5, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5] and RETRY_PERIOD_S == 0.5


def test_time_that_was_lost_is_not_made_up_for(rig):
    rig.answers, rig.end = (0.0, 9.0), 2.0

    def takes_long_once():
        rig.publish()
        if len(rig.asked) == 2:
            rig.now += 1.0

    poll(takes_long_once, PERIOD_S)
    assert rig.asked == [0.0, 0.25, 1.25, 1.5, 1.75, 2.0]
