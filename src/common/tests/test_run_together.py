"""Several parts in one node: which failure ends the others, and that the reason is in the log."""

from __future__ import annotations

import threading
from functools import partial

import pytest

from common.errors import ConfigError, DeviceError, RigError

rospy = pytest.importorskip("rospy")
from common.ros.node import dispensable, run_together  # noqa: E402 - needs rospy


@pytest.fixture
def fatal(monkeypatch):
    """What goes to the log, in the order; ROS is not shut down."""
    said: list[str] = []
    monkeypatch.setattr(rospy, "logfatal", lambda text, *words: said.append(text % words))
    monkeypatch.setattr(rospy, "signal_shutdown", lambda reason: said.append("shutdown"))
    return said


@pytest.mark.parametrize("error", [ConfigError(["x is 0."]), DeviceError("no robot."), KeyError("x")])
def test_a_part_that_fails_ends_all_and_the_reason_is_in_the_log_before(fatal, error):
    def fail():
        raise error

    with pytest.raises(type(error)):
        run_together(fail, lambda: None)
    assert str(error) in fatal[0] and fatal[1] == "shutdown"


def test_a_dispensable_part_without_its_device_ends_alone(fatal):
    ended, at_work = threading.Event(), []

    def hand():
        try:
            raise DeviceError("The robot hand is not there.")
        finally:
            ended.set()

    def arm():
        ended.wait()
        at_work.append(list(fatal))

    run_together(partial(dispensable, hand), arm)
    assert "shutdown" not in at_work[0]
    assert "The robot hand is not there." in fatal[0] and fatal[1:] == ["shutdown"]


def test_a_dispensable_part_with_another_fault_ends_all(fatal):
    def fail():
        raise RigError("The configuration is wrong.")

    with pytest.raises(RigError):
        run_together(partial(dispensable, fail), lambda: None)
    assert "The configuration is wrong." in fatal[0]
