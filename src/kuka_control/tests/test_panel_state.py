"""What the control panel shows: nothing is green that was not said to be on just now."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kuka_control.gui.panel_state import ABSENT_S, ControllerStatus, PanelContext, Tone, factor_text, panel_state

STATUS = ControllerStatus(10.0, True, True, 0.7, "servo", "the hand steers the arm", ("z lower limit",))


def test_before_the_first_status_everything_is_off():
    state = panel_state(None, 0.0)
    assert not (state.present or state.control_on or state.gripper_on)
    assert state.status_line == "Waiting for the controller of the arm."


def test_what_the_controller_says_is_shown():
    state = panel_state(STATUS, 10.1)
    assert state.present and state.control_on and state.gripper_on and state.scaling_factor == 0.7
    assert state.status_line == "servo: the hand steers the arm (limited by: z lower limit)"


def test_what_the_robot_can_is_known_also_of_a_controller_that_hangs():
    able = replace(STATUS, abilities=("stop", "watchdog"), paused=True)
    state, silent = panel_state(able, 10.1), panel_state(able, 100.0)
    assert state.stops and state.paused and silent.stops and not silent.paused
    assert not panel_state(STATUS, 10.1).stops and not panel_state(None, 0.0).stops


@given(st.integers(100_000, 1_500_000), st.booleans())
def test_a_factor_is_shown_with_two_decimals_and_all_that_it_has(millionths, as_float32):
    factor = millionths / 1e6
    text = factor_text(float(np.float32(factor)) if as_float32 else factor)
    assert float(text) == factor and len(text.partition(".")[2]) >= 2
    assert len(text) == 4 or not text.endswith("0")


@given(st.floats(0.0, 1e4))
def test_a_silent_controller_is_shown_as_off(silence):
    state = panel_state(STATUS, 10.0 + silence)
    assert state.control_on == state.gripper_on == state.present == (10.0 + silence - 10.0 <= ABSENT_S)
    if not state.present:
        assert "silent" in state.status_line and state.scaling_factor == 0.7


def test_a_controller_whose_process_is_gone_is_off_at_once():
    state = panel_state(STATUS, 10.0, PanelContext(runs=False))
    assert not (state.present or state.control_on or state.gripper_on)
    assert state.status_line == "The controller has exited. Its last state was servo: the hand steers the arm" + (
        " (limited by: z lower limit)"
    )
    assert state.tone is Tone.WARNING


def test_a_controller_that_was_never_heard_is_no_normal_start():
    state = panel_state(None, 100.0, PanelContext(unheard=True))
    assert not state.present and state.tone is Tone.FAULT
    assert "has not been heard" in state.status_line and "smartPad" in state.status_line


def test_silence_is_a_fault_and_says_what_is_known():
    here, elsewhere = (panel_state(STATUS, 20.0, PanelContext(runs=runs)) for runs in (True, None))
    assert here.status_line == "The controller has been silent for 10 s: it hangs."
    assert elsewhere.status_line == "The controller has been silent for 10 s: it exited, hangs, or is out of reach."
    assert here.tone is elsewhere.tone is Tone.FAULT


def test_a_lost_master_is_said_and_changes_nothing_else():
    context = PanelContext(master="http://rig:11311", master_lost=True)
    assert panel_state(None, 0.0, context).status_line == "Waiting for the ROS master at http://rig:11311."
    state, calm = panel_state(STATUS, 10.0, context), panel_state(STATUS, 10.0)
    assert replace(state, status_line=calm.status_line, tone=calm.tone) == calm
    assert "http://rig:11311 does not answer" in state.status_line and state.tone is Tone.WARNING


def test_a_stopped_arm_is_a_fault():
    stopped = replace(STATUS, mode="stopped")
    for context in (PanelContext(), PanelContext(master_lost=True)):
        assert panel_state(stopped, 10.0, context).tone is Tone.FAULT
    assert panel_state(STATUS, 10.0).tone is Tone.NORMAL
