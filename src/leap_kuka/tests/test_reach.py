"""The question to the controller whether the arm can come, with a service that answers, hangs, is absent or fails."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rig_msgs.srv")
import rospy

from common import clock
from common.poses import pose
from common.rotations import rotation_about
from leap_kuka.ros import reach
from leap_kuka.scaling import Scaling
from rig_msgs.srv import CheckToolPose

pytestmark = pytest.mark.ros

HERE = np.eye(4)
FRAME_S = 0.02
DELAY_S = 0.01  # of a call


@pytest.fixture
def check(ros):
    return reach.ReachCheck(Scaling(np.zeros(3)))


@pytest.fixture
def controller(ros):
    """Offers the service, which does what `answer` says at that time."""

    class Controller:
        answer = staticmethod(lambda: "")
        calls = 0

        def __init__(self):
            self.service = rospy.Service("kuka/check_tool_pose", CheckToolPose, self._take)

        def _take(self, _request):
            self.calls += 1
            return {"obstacle": self.answer()}

    return Controller()


def ask(check, seconds, T=HERE, starts=True):
    """Asks in each frame; returns the answers."""
    answers = []
    for _ in range(round(seconds / FRAME_S)):
        answers.append(check(T, starts))
        clock.sleep(FRAME_S)
    return answers


def becomes(check, said, within, **how):
    """Whether the answer becomes `said` within a time [s] and stays so."""
    return set(ask(check, within + FRAME_S, **how)[-1:] + ask(check, 5.0, **how)) == {said}


def fails():
    raise ValueError("no arm")


def test_only_an_absent_service_is_no_condition(check, controller):
    """One that hangs or fails is: the arm may be out of reach."""
    soon = reach.REACH_START_S + FRAME_S + DELAY_S
    assert check(HERE, True) == reach.ASKING
    assert becomes(check, None, soon)
    controller.answer = lambda: "joint 4 would pass its limit"
    assert becomes(check, "joint 4 would pass its limit", soon)
    controller.answer = lambda: clock.sleep(20.0)
    assert becomes(check, reach.SILENT, 0.1 + 0.5 + FRAME_S + DELAY_S)
    assert check(pose(p=(1.0, 0.0, 0.0)), True) == reach.SILENT, "it is so for every tool"
    controller.answer = fails
    clock.sleep(20.0)
    assert becomes(check, reach.SILENT, soon)
    controller.service.shutdown()
    assert becomes(check, None, soon)


def test_after_an_unexpected_failure_it_is_asked_again(check, controller, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(reach, "stamped_pose", lambda *_: fails())
        failed = "the check whether the arm can come has failed: ValueError('no arm')"
        assert becomes(check, failed, 0.1 + FRAME_S)
    assert becomes(check, None, 0.1 + FRAME_S + DELAY_S)


@pytest.mark.parametrize("starts, period", [(True, 0.1), (False, 0.6)])
def test_while_a_stream_runs_it_asks_less_often(check, controller, starts, period):
    ask(check, 12.0, starts=starts)
    assert 12.0 / (period + FRAME_S + DELAY_S) <= controller.calls <= 12.0 / period + 1


@pytest.mark.parametrize("age, answer", [(1.98, None), (2.01, reach.ASKING)])
def test_an_answer_that_is_older_than_two_seconds_does_not_count(check, controller, age, answer):
    check(HERE, True)
    clock.sleep(DELAY_S)
    clock.sleep(age)
    assert check(HERE, True) == answer


@pytest.mark.parametrize("far", [pose(p=(0.04, 0.0, 0.0)), pose(rotation_about(2, np.radians(12.0)))])
def test_for_a_start_only_the_answer_for_a_near_tool_counts(check, controller, far):
    near = pose(rotation_about(2, np.radians(8.0)), (0.02, 0.0, 0.0))
    assert becomes(check, None, 0.2)
    controller.answer = lambda: clock.sleep(0.4) or ""
    for T, starts, answer in ((near, True, None), (far, False, None), (far, True, reach.ASKING)):
        assert check(T, starts) == answer
    assert becomes(check, None, 0.4 + 0.4 + 0.1 + FRAME_S + DELAY_S, T=far)
