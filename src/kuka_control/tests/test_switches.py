"""What the services answer."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kuka_control.model.switches import ExitInPlace, Switches


def switches(mode="home", stopped=None):
    result = Switches()
    result.report(mode, stopped)
    return result


def test_control_goes_on_and_off():
    s = switches()
    assert s.set_control(True).success and s.now.control_on
    assert s.set_control(True).message == "Control is on already."
    assert s.set_control(False).success and not s.now.control_on
    assert s.set_control(False).message == "Control is off already."


def test_each_engagement_counts():
    s = switches()
    for on in (True, True, False, True, False, False, True):
        s.set_control(on)
    assert s.now.enable_count == 3


def test_before_home_control_says_that_the_arm_goes_there_first():
    assert "home first" in switches("homing").set_control(True).message


def test_a_stopped_arm_wants_control_off_and_on_again():
    s = switches()
    s.set_control(True)
    s.report("stopped", "The arm does not follow.")
    answer = s.set_control(True)
    assert not answer.success and "off and on again" in answer.message and "does not follow" in answer.message
    assert "stays where it is" in s.set_control(False).message
    assert s.set_control(True).success


@given(st.floats(0.1, 1.5))
def test_scaling_within_its_range(factor):
    s = switches()
    assert s.set_scale(float(np.float32(factor))).success
    assert s.now.scale == pytest.approx(factor, abs=1e-6)


@pytest.mark.parametrize("factor", [0.0999, 1.5001, 0.0, -1.0, float("nan"), float("inf")])
def test_scaling_outside_its_range_is_refused(factor):
    s = switches()
    answer = s.set_scale(factor)
    assert not answer.success and "0.1 to 1.5" in answer.message and s.now.scale == 1.0


@pytest.mark.parametrize("on", [False, True])
def test_scaling_may_change_whether_control_is_on_or_off(on):
    s = switches()
    s.set_control(on)
    assert s.set_scale(np.float32(0.7)) == (True, "The scaling factor is 0.7.") and s.now.scale == 0.7


@pytest.mark.parametrize("outlook", [None, "It comes too slowly and is not followed."])
def test_the_answer_says_what_becomes_of_the_frame_that_comes(outlook):
    s = switches()
    s.report("home", None, outlook)
    answer = s.set_control(True)
    assert answer.success and answer.message.startswith("Control is on. ")
    assert (outlook or "once it comes") in answer.message and "home first" not in answer.message


def test_exit_switches_everything_off_for_good():
    s = switches()
    s.set_control(True)
    s.set_gripper(True)
    assert s.request_exit().success
    now = s.now
    assert (now.control_on, now.gripper_on, now.exit_requested) == (False, False, True)
    assert not s.set_control(True).success and not s.set_gripper(True).success
    assert s.request_exit().success


def test_while_control_is_held_it_cannot_be_switched_on():
    switches = Switches()
    switches.set_control(True)
    switches.hold("the robot is out of reach")
    assert not switches.now.control_on
    answer = switches.set_control(True)
    assert not answer.success and answer.message == "Control stays off: the robot is out of reach."
    assert switches.set_control(False).success
    switches.release()
    assert switches.set_control(True).success and switches.now.enable_count == 2


def test_a_controller_whose_control_is_held_says_that_it_leaves_the_arm():
    switches = Switches()
    switches.hold("the robot is out of reach")
    assert "leaves the arm as it is: the robot is out of reach" in switches.request_exit().message


def test_while_the_joints_are_not_believed_control_stays_as_it_is_and_the_answers_say_so():
    s = switches()
    s.set_control(True)
    s.report("stopped", "The measured joints are not believed.", None, ExitInPlace.IN_DOUBT)
    answer = s.set_control(True)
    assert not answer.success and answer.message.startswith("Control stays on: the arm does not move while")
    answer = s.set_control(False)
    assert answer.success and "before its measured joints are believed" in answer.message
    answer = s.set_control(True)
    assert not answer.success and answer.message.startswith("Control stays off: the arm does not move while")
    assert not s.now.control_on and s.now.enable_count == 1
    s.report("stopped", "The measured joints are not believed.")
    assert s.set_control(True).success and s.now.enable_count == 2


@pytest.mark.parametrize("stays", list(ExitInPlace))
def test_an_exit_that_leaves_the_arm_says_so_and_is_held_to_it(stays):
    s = switches()
    s.report("stopped", "It is stopped.", None, stays)
    assert s.request_exit().message == f"The controller exits and leaves the arm where it is: {stays.value}."
    s.report("stopped", "It is stopped.")
    assert s.now.exit_in_place is stays


def test_after_a_contact_control_leads_home():
    s = switches("stopped")
    s.report("stopped", "The arm touched something.", None, ExitInPlace.TOUCHED)
    assert "home first" in s.set_control(True).message
