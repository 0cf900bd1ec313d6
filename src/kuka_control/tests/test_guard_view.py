"""What the display of the collision guard does when topics close under it, and when the guard fails."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rig_msgs.srv")
import rospy

from kuka_control.limits.moving_arm import GuardError
from kuka_control.ros import guard_view

pytestmark = pytest.mark.ros


class Topic:
    """A publisher with a listener; `error` is what publishing raises."""

    error: Exception | None = None

    def __init__(self, *_, **__):
        pass

    def get_num_connections(self):
        return 1

    def publish(self, _):
        if self.error is not None:
            raise self.error


@pytest.fixture
def view(monkeypatch):
    rospy = pytest.importorskip("rospy")
    monkeypatch.setattr(rospy, "Publisher", Topic)
    monkeypatch.setattr(guard_view, "repeat", lambda *_: None)
    monkeypatch.setattr(rospy.Time, "now", rospy.Time)
    monkeypatch.setattr(guard_view, "collision_guard", lambda *_: Guard())
    config = type("Config", (), {"guard_margin": 0.03})()
    return guard_view.GuardView(config, None, lambda: (np.zeros(7), 1.0))


class Guard:
    failure: Exception | None = None

    def nearest_at(self, _):
        if self.failure is not None:
            raise self.failure


@pytest.mark.parametrize("shut_down", [True, False])
def test_a_closed_topic_is_an_error_only_while_ros_runs(view, monkeypatch, shut_down):
    monkeypatch.setattr(Topic, "error", rospy.ROSException("publish() to a closed topic"))
    monkeypatch.setattr(rospy.core, "is_shutdown_requested", lambda: shut_down)
    if shut_down:
        view._show()
    else:
        with pytest.raises(rospy.ROSException):
            view._show()


def test_a_guard_that_fails_is_said_and_the_display_continues(view, monkeypatch):
    said = []
    monkeypatch.setattr(rospy, "logwarn_throttle", lambda _, text: said.append(text))
    monkeypatch.setattr(Guard, "failure", GuardError("The collision guard failed: some number is not finite."))
    view._show()
    assert said == ["The collision guard failed: some number is not finite."]
