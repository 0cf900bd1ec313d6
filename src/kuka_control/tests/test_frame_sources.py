"""Two nodes that publish one frame are distinguished from one node, and from one that takes over; and a frame of the
chain that was calibrated anew from a hand that moves.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.poses import pose, translation
from common.rotations import rotation_about
from kuka_control.model.desired_frame import ChainWatch, FrameSources
from kuka_control.model.frame_chain import FrameChain
from kuka_control.numbers import HANDOVER_S

BASE, LEAP, TOOL = "kuka/base_frame", "leap_motion/virtual_frame", "kuka/tool_frame/desired"


@given(st.lists(st.floats(0.0, 3.0), max_size=50))
def test_one_node_for_each_frame_is_no_conflict(gaps):
    sources, now = FrameSources(), 0.0
    for gap in gaps:
        now += gap
        assert sources.heard(TOOL, LEAP, "/a", now) and sources.heard(LEAP, BASE, "/b", now)
        assert sources.conflict(TOOL, now) is None


@pytest.mark.hazard(10)
@given(st.floats(0.001, HANDOVER_S / 2.01), st.integers(2, 20))
def test_two_that_alternate_are_named_from_the_first_word_of_the_second(gap, count):
    sources = FrameSources()
    assert sources.heard(TOOL, LEAP, "/b", 0.0)
    for i in range(1, count):
        assert not sources.heard(TOOL, LEAP, "/a" if i % 2 else "/b", i * gap)
        conflict = sources.conflict(TOOL, i * gap)
        assert conflict.when == i * gap
        assert str(conflict) == f"/a and /b both publish {TOOL}; end one of them"


def test_a_conflict_about_a_frame_that_others_stand_in_counts_for_them_and_not_the_other_way_round():
    sources = FrameSources()
    sources.heard(TOOL, LEAP, "/a", 0.0)
    sources.heard(LEAP, BASE, "/a", 0.0)
    sources.heard(LEAP, BASE, "/b", 0.1)
    sources.heard("hand/frame", LEAP, "/a", 0.1)
    assert sources.conflict(TOOL, 0.2).frame == sources.conflict("hand/frame", 0.2).frame == LEAP
    sources = FrameSources()
    sources.heard(LEAP, BASE, "/a", 0.0)
    sources.heard(TOOL, LEAP, "/a", 0.0)
    sources.heard(TOOL, LEAP, "/b", 0.1)
    assert sources.conflict(LEAP, 0.2) is None


def test_frames_in_a_circle_end_the_search():
    sources = FrameSources()
    sources.heard("a", "b", "/n", 0.0)
    sources.heard("b", "a", "/n", 0.0)
    assert sources.conflict("a", 0.1) is None


steps = st.floats(-0.3, 0.3).filter(lambda x: abs(x) > 0.021)


@given(st.lists(st.tuples(st.floats(-0.3, 0.3), st.floats(-3.0, 3.0)), max_size=20), st.floats(0.001, 0.05))
def test_a_tool_that_moves_and_jumps_in_frames_that_stay_is_no_jump_of_a_frame(moves, dt):
    watch, T_base_parent = ChainWatch(), pose(rotation_about(2, 0.7), [0.5, -0.4, 0.1])
    for i, (x, turn) in enumerate(moves):
        T_parent_tool = pose(rotation_about(1, turn), [x, 0.1, 0.2])
        assert watch.step(i * dt, LEAP, T_base_parent, T_base_parent @ T_parent_tool) is None


@given(steps, st.floats(0.001, 0.1))
def test_a_frame_that_jumps_with_the_tool_in_it_is_named(x, dt):
    watch, T_parent_tool = ChainWatch(), pose(rotation_about(1, 0.3), [0.0, 0.1, 0.2])
    assert watch.step(5.0, LEAP, np.eye(4), T_parent_tool) is None
    T = translation(x, 0.0, 0.0)
    assert LEAP in watch.step(5.0 + 0.9 * dt, LEAP, T, T @ T_parent_tool)
    assert watch.step(5.0 + 1.8 * dt, LEAP, T, T @ T_parent_tool) is None


@given(steps, st.floats(0.11, 10.0))
def test_a_frame_that_turns_with_the_next_hand_or_without_moving_the_tool_has_not_jumped(x, pause):
    T, T_tool = translation(x, 0.0, 0.0), translation(0.5, 0.0, 0.4)
    watch = ChainWatch()
    watch.step(0.0, LEAP, np.eye(4), T_tool)
    assert watch.step(pause, LEAP, T, T @ T_tool) is None
    assert watch.step(pause + 0.01, LEAP, np.eye(4), T @ T_tool) is None
    assert watch.step(pause + 0.02, BASE, T, T @ T_tool @ T) is None


FRAMES = st.sampled_from(["base", "tool", "leap", "mount", "camera", "tag"])


@given(st.lists(st.tuples(FRAMES, FRAMES), max_size=30))
def test_all_transforms_of_frames_that_the_tool_or_the_base_ever_stood_in_are_passed_on_in_their_order(sent):
    chain, passed, parents, needed = FrameChain("tool", "base"), [], {}, set()
    for number, (child, parent) in enumerate(sent):
        passed += chain.put(child, parent)
        passed += [(child, number)] if chain.needs(child, (child, number)) else []
        parents[child] = parent
        needed.update(reached(parents))
    for frame in dict(sent):
        came = [(child, number) for number, (child, _) in enumerate(sent) if child == frame]
        assert [each for each in passed if each[0] == frame] == (came if frame in needed else [])


def reached(parents):
    """Returns the frames that the tool and the base stand in now, and both."""
    found = ["tool", "base"]
    for frame in found:
        found += [parents[frame]] if parents.get(frame, frame) not in found else []
    return found
