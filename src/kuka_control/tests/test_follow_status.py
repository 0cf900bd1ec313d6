"""Law of the status: while the desired tool moves and the arm does not, it never says that the arm follows, and names
the first reason.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loop_world import DT, HOME, World, at_rate, shifted, tipped

from kuka_control.model.config import PtpConfig, RealTimeConfig

FOLLOWS = "follows the desired tool frame in servo mode"
AT_ONCE_M, MOVED_M = 0.004, 0.01  # the arm stands still if its tool moves less, while the desired one moves by more


def circle(t):
    """The tool on a circle of 5 cm through home, in 4 s."""
    angle = 0.5 * math.pi * t
    return shifted(0.05 * math.sin(angle), 0.0, 0.05 * (1.0 - math.cos(angle)))


def outwards(T, v):
    """A function of time from the tool T on a straight line [m/s]."""

    def tool(t):
        moved = T.copy()
        moved[:3, 3] += np.multiply(v, t)
        return moved

    return tool


def off(world):
    world.at_home()
    return circle


def early_hand(world):
    world.at_home().run(0.5, circle)
    world.control_on = True
    return circle


def rare(world):
    world.following()
    return circle


def refused(world):
    world.following()
    world.skew = -1.0
    return circle


def two_publishers(world):
    world.at_home()
    world.control_on = world.foreign = True
    world.conflict = "The desired tool frame is refused: /a and /b both publish kuka/tool_frame/desired."
    return circle


def out_of_reach(world):
    world.following(shifted(0.0, 0.0, 0.15))
    return outwards(tipped(1.4, z=0.15), (0.0, 0.0, 0.05))


def outside(world):
    world.following(shifted(0.0, 0.0, -0.19)).run(2.0, shifted(0.0, 0.0, -0.25))
    return outwards(shifted(0.0, 0.0, -0.25), (0.0, 0.0, -0.05))


CASES = {
    "control off": (off, 80.0, "Control is off"),
    "a hand that was there before control was switched on": (early_hand, 80.0, "take the hand out"),
    **{f"{rate:g} Hz": (rare, rate, "Hz, but the arm follows it only from 22 Hz on") for rate in (6.0, 10.0, 19.0)},
    "stamps of the past": (refused, 80.0, "behind this machine's clock"),
    "two publishers": (two_publishers, 80.0, "/a and /b both publish kuka/tool_frame/desired"),
    "out of reach": (out_of_reach, 80.0, "The arm keeps its joints: The tool pose is out of reach"),
    "outside the workspace": (outside, 80.0, "outside the workspace; the tool stays at the lower z limit"),
}


@pytest.mark.parametrize("case", CASES)
def test_what_keeps_the_arm_from_following_is_said_instead_of_that_it_follows(case):
    prepare, rate, said = CASES[case]
    world = World()
    tool = prepare(world)
    at_rate(world, rate, tool, 0.8)  # until the rate is known, and the arm has braked
    first = len(world.steps)
    before, since = world.rig.kinematics.forward(world.arm.q), world.now
    at_rate(world, rate, lambda t: tool(0.8 + t), 0.6)
    moved = np.linalg.norm(world.rig.kinematics.forward(world.arm.q)[:3, 3] - before[:3, 3])
    assert moved < AT_ONCE_M and world.now > since, "the arm stands still"
    for step in world.steps[first:]:
        assert FOLLOWS not in step.reason and said in step.reason


@pytest.mark.parametrize("case", [case for case in CASES if case not in ("control off", "outside the workspace")])
def test_it_is_logged_and_shown_in_diagnostics(case):
    prepare, rate, said = CASES[case]
    world = World()
    tool = prepare(world)
    at_rate(world, rate, tool, 1.0)
    assert world.steps[-1].inhibited or case == "out of reach"
    logged = [event for event in world.events if said in event]
    assert logged or case == "a hand that was there before control was switched on"
    assert len(logged) <= 1 + (case == "stamps of the past")


@pytest.mark.parametrize("rate", [6.25, 10.0, 12.5])
def test_the_rate_is_the_measured_one(rate):
    world = World().at_home()
    world.control_on = world.foreign = True
    at_rate(world, rate, circle, 3.0)
    assert f"comes at {rate:.3g} Hz," in world.steps[-1].reason, world.steps[-1].reason
    assert any(f"comes at {rate:.3g} Hz," in event for event in world.events)


def test_frames_that_come_too_rarely_are_said_to_be_nothing_else():
    """The same circle at 100 Hz has no orientation out of reach."""
    for rate in (10.0, 20.0, 100.0):
        world = at_rate(World().following(), rate, circle, 4.0)
        assert not any("out of the arm's reach" in event for event in world.events)
        assert not any("reach" in step.limited_by for step in world.steps)
        assert ("only from 22 Hz" in world.steps[-1].reason) == (rate < 21.0)
        assert (FOLLOWS in world.steps[-1].reason) == (rate > 21.0)


def test_a_controller_that_waits_says_for_what():
    world = World().at_home()
    world.missing = "It waits for kuka/tool_frame/desired."
    assert world.run(DT).steps[-1].reason == "The arm is at home."
    world.control_on = True
    assert world.run(DT).steps[-1].reason == "The arm is at home. It waits for kuka/tool_frame/desired."
    world.until("servo", 4.0, circle)
    assert FOLLOWS in world.steps[-1].reason


def test_a_longer_time_out_hides_no_silence():
    world = World(time_out=2.0).following()
    world.run(1.0)
    assert world.mode == "servo" and world.steps[-1].reason.endswith("No desired tool frame comes.")
    assert FOLLOWS not in world.steps[-1].reason


def test_the_ptp_arm_that_stands_at_its_pose_does_not_say_that_it_moves():
    world = World(PtpConfig).at_home()
    world.control_on = True
    world.run(3.0, shifted(0.05, 0.0, 0.0))
    assert world.mode == "pick_up" and world.steps[-1].reason.startswith("The arm is at the desired pose;")


@pytest.mark.parametrize("schema", [RealTimeConfig, PtpConfig])
@pytest.mark.parametrize("foreign, advice", [(True, "after a pause of 2 s"), (False, "take the hand out")])
def test_the_advice_after_a_conflict_is_about_what_publishes(schema, foreign, advice):
    world = World(schema).at_home()
    world.control_on, world.foreign, world.conflict = True, foreign, "/a and /b both publish it; end one of them."
    world.run(0.5, circle)
    for _ in range(2):
        assert world.conflict in world.steps[-1].reason and "hand" not in world.steps[-1].reason
        world.run(0.5, circle)
    said, world.conflict = world.conflict, None
    reason = world.run(1.0, circle).steps[-1].reason
    assert said in reason and advice in reason and ("hand" in reason) == (not foreign)
    world.run(2.1)
    world.run(3.0, circle)
    assert world.arm.commands, "a pause ends it, as it says"


PATHS = {
    "circle": circle,
    "down": outwards(HOME.T_base_tool, (0.0, 0.0, -0.1)),
    "up": outwards(HOME.T_base_tool, (0.0, 0.0, 0.1)),
    "outwards": outwards(HOME.T_base_tool, (0.1, -0.1, 0.0)),
    "inwards": outwards(HOME.T_base_tool, (-0.08, 0.08, 0.0)),
    "tipped": lambda t: tipped(min(0.3 * t, 1.5), z=min(0.1 * t, 0.2)),
    "jumping": lambda t: shifted(0.0, 0.04 * (int(t / 0.3) % 2), 0.0),
}
SEEN_M, STILL_M = 0.02, 0.002  # the desired tool moves by more than the one, the arm by less than the other
WINDOW, REACTION = 100, 50  # cycles that are looked at, the last of which show how the arm reacts to those before


@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(sorted(PATHS)),
            st.sampled_from([2.0, 6.0, 10.0, 15.0, 19.0, 21.0, 25.0, 50.0, 100.0]),
            st.sampled_from([0.0, 0.0, 0.0, -1.0, 1.0]),
            st.sampled_from([True, True, True, False]),
            st.sampled_from([1.0, 0.1, 1.5]),
        ),
        min_size=1,
        max_size=2,
    ),
    st.booleans(),
    st.sampled_from([0.2, 2.0]),
)
def test_while_the_desired_tool_moves_and_the_arm_does_not_the_status_never_says_that_it_follows(parts, foreign, out):
    world = World(time_out=out).at_home()
    world.foreign, world.control_on = foreign, True
    desired, measured = [], []
    for path, rate, skew, on, scale in parts:
        world.skew, world.control_on, world.scale = skew, on, scale
        start, frame = world.now, -1
        while world.now - start < 2.5:
            number = int((world.now - start) * rate)
            fresh, frame = number > frame, number
            world.run(DT, PATHS[path](number / rate) if fresh else None)
            desired.append(world.newest.T_base_tool[:3, 3] if world.newest else np.zeros(3))
            measured.append(world.rig.kinematics.forward(world.arm.q)[:3, 3])
    steps = world.steps[-len(desired) :]
    for i in range(WINDOW, len(steps), 10):
        seen = np.ptp(desired[i - WINDOW : i - REACTION], axis=0).max()
        stood = np.ptp(measured[i - WINDOW : i], axis=0).max()
        reasons = {step.reason for step in steps[i - WINDOW : i]}
        moves = seen > SEEN_M and stood < STILL_M
        assert not moves or not all(FOLLOWS in reason for reason in reasons), (i, seen, stood, reasons)
