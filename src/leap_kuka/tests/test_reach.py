"""The question to the controller whether the arm can come, with a service that answers, hangs, is absent or fails."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rig_msgs.srv")
from common.poses import pose
from common.ros.service_calls import ServiceAbsent, ServiceFailed
from common.rotations import rotation_about
from leap_kuka.ros import reach

pytestmark = pytest.mark.ros

HERE = np.eye(4)


@pytest.fixture
def check(monkeypatch):
    """Makes a ReachCheck whose service does what `answer` says at that time; it ends with the test."""
    ended = threading.Event()
    answer = {"": lambda: ""}

    class Client:
        def __init__(self, name, kind):
            pass

        def __call__(self, tool, timeout):
            return SimpleNamespace(obstacle=answer[""]())

    monkeypatch.setattr(reach, "ServiceClient", Client)
    monkeypatch.setattr(reach, "stamped_pose", lambda *_: None)
    monkeypatch.setattr(reach.rospy.Time, "now", lambda: None)
    monkeypatch.setattr(reach.rospy, "is_shutdown", ended.is_set)
    made = reach.ReachCheck(np.zeros(3))

    def ask(what, T=HERE, starts=True):
        answer[""] = what
        return made(T, starts)

    yield ask
    ended.set()


def fails(error):
    def what():
        raise error

    return what


def settles(ask, what, said, **how):
    """Whether the answer becomes `said`."""
    end = time.monotonic() + 20.0
    while time.monotonic() < end:
        if ask(what, **how) == said:
            return True
        time.sleep(0.01)
    return False


def test_only_an_absent_service_is_no_condition(check):
    """One that hangs or fails is: the arm may be out of reach."""
    assert check(lambda: "") == reach.ASKING
    assert settles(check, lambda: "", None)
    assert settles(check, lambda: "joint 4 would pass its limit", "joint 4 would pass its limit")
    assert settles(check, fails(ServiceFailed("check", "did not answer", True)), reach.SILENT)
    assert settles(check, fails(ServiceAbsent("check", "nobody")), None)


def test_after_an_unexpected_failure_it_is_asked_again(check):
    failed = "the check whether the arm can come has failed: RuntimeError('no thread')"
    assert settles(check, fails(RuntimeError("no thread")), failed)
    assert settles(check, lambda: "", None)


def test_a_service_that_hangs_says_so_without_flicker():
    assert reach.FRESH_S > reach.TIMEOUT_S + 2.0 * reach.PERIOD_S


@pytest.mark.parametrize("far", [pose(p=(0.04, 0.0, 0.0)), pose(rotation_about(2, np.radians(12.0)))])
def test_for_a_start_only_the_answer_for_a_near_tool_counts(check, far):
    assert settles(check, lambda: "", None)
    block = threading.Event()
    try:
        wait = lambda: block.wait(20.0) and ""  # noqa: E731
        assert settles(check, wait, reach.ASKING, T=far) and check(wait, HERE, True) in (None, reach.ASKING)
    finally:
        block.set()
    assert settles(check, lambda: "", None, T=far)
