"""The two control loops on an arm without a wire: each rule of the algorithms, in simulated time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from loop_world import DT, FAST, HOME, SLOW, World, at_rate, out_of_reach_and_back, ptp, reached, shifted, tipped

from common.poses import pose
from common.rotations import rotation_angle, rotation_from_zyx
from kst import ConnectionLost
from kuka_control.loop.admission import OFF
from kuka_control.loop.commands import End
from kuka_control.loop.goal_stream import CATCH_UP_SCALE
from kuka_control.loop.transitions import State
from kuka_control.model.config import PtpConfig, RealTimeConfig
from kuka_control.numbers import SPEED_MARGIN

both = pytest.mark.parametrize("schema", [RealTimeConfig, PtpConfig])


@both
def test_the_arm_goes_home_slowly_at_the_start_and_waits_there(schema):
    world = World(schema).run(4.0, shifted(0.05, 0.0, 0.0))
    check = [("start_servo",), ("stop_servo",)] if schema is RealTimeConfig else []
    assert world.arm.commands == [ptp(HOME.q, SLOW), *check]
    assert world.modes == ["homing", "home"]


@pytest.mark.hazard(26)
@both
def test_exit_goes_to_zero_and_ends(schema):
    world = World(schema).at_home()
    world.exit_requested = True
    world.run(5.0)
    assert world.arm.commands == [to_zero(world)]
    assert world.steps[-1].command == End(None)


def to_zero(world):
    """On the way from home the finger tips are the fastest."""
    return ptp(np.zeros(7), world.rig.ptp_velocity(HOME.q, np.zeros(7), SLOW))


@both
@pytest.mark.parametrize("lifted", [False, True])
def test_a_lifted_workspace_holds_no_tool_back_and_shuts_no_controller_down(schema, lifted):
    """Down through the lower limit; and behind the base, which ends a controller otherwise."""
    world = World(schema, lifted=lifted).at_home()
    world.control_on = True
    world.run(5.0, lambda t: shifted(0.0, 0.0, -0.24 * min(t / 3.0, 1.0)))
    height = world.rig.kinematics.forward(world.arm.q)[2, 3]
    assert height == pytest.approx(0.16 if lifted else 0.2, abs=0.006)
    assert (world.steps[-1].limited_by == ()) is lifted
    world.run(3.0, shifted(-0.9, 0.9, 0.0))
    assert isinstance(world.steps[-1].command, End) is not lifted


def test_without_shaping_every_new_frame_is_a_goal_as_it_is():
    def circle(t):
        return shifted(0.03 * np.sin(12.0 * t), 0.0, 0.03 * (1.0 - np.cos(12.0 * t)))

    world = World(shaping="none").following()
    for i in range(250):
        world.run(DT, circle(i * DT))
        tool = world.rig.kinematics.forward(world.steps[-1].command.q)[:3, 3]
        np.testing.assert_allclose(tool, world.newest.T_base_tool[:3, 3], atol=1e-6)
    assert world.steps[-1].limited_by == ()


def test_the_stamp_of_a_frame_goes_out_once_with_its_goal():
    world = World().following()
    world.steps.clear()
    world.run(0.3, shifted(0.001, 0.0, 0.0))
    stamps = [s.command.stamp for s in world.steps if s.command.stamp is not None]
    assert len(stamps) == len(set(stamps)) == 25


@pytest.mark.hazard(9)
def test_silence_for_the_time_out_sends_the_arm_home_fast():
    world = World().following()
    world.run(0.19)
    assert world.arm.commands == []
    world.run(3.0)
    assert world.arm.commands == [("stop_servo",), ptp(HOME.q, FAST)]
    assert world.modes == ["servo", "returning", "home"]
    assert any("0.2 s" in event for event in world.events)


@pytest.mark.parametrize("cycles", [0, 1])
def test_control_off_and_on_again_still_goes_home_first(cycles):
    world = World().following(shifted(0.05, 0.0, 0.0))
    world.control_on = False
    if cycles:
        world.run(cycles * DT, shifted(0.05, 0.0, 0.0))
    world.control_on = True
    world.run(3.0, shifted(0.05, 0.0, 0.0))
    assert world.arm.commands == [("stop_servo",), ptp(HOME.q, FAST)] and world.mode == "home"
    assert "take the hand out of the box" in world.steps[-1].reason
    world.run(0.3).run(3.0, shifted(0.05, 0.0, 0.0))
    assert world.mode == "servo"


def test_frames_during_a_motion_are_disregarded_and_only_a_new_one_counts():
    world = World().run(0.1)
    world.control_on = True
    world.run(1.0, shifted(0.1, 0.0, 0.0))
    world.run(3.0)
    assert world.mode == "home" and world.arm.commands == [ptp(HOME.q, SLOW), ("start_servo",), ("stop_servo",)]
    world.run(3.0, shifted(0.05, 0.0, 0.0))
    assert reached(world, shifted(0.05, 0.0, 0.0))


@pytest.mark.hazard(15)
def test_a_jump_in_the_stream_is_picked_up_anew():
    world = World().following()
    world.run(3.0, shifted(0.08, 0.0, 0.0))
    assert [t[0] for t in world.arm.commands] == ["stop_servo", "ptp", "start_servo"]
    assert world.arm.commands[1][2] == FAST
    assert world.loop.counts["limited_goals"] <= 1
    assert reached(world, shifted(0.08, 0.0, 0.0))


def test_a_hand_that_moved_on_during_the_pick_up_is_caught_up_with_slowly():
    world = World().at_home()
    world.control_on = True
    world.run(0.02, shifted(0.1, 0.0, 0.0))
    while world.mode != "servo":
        world.run(DT, shifted(0.0, 0.0, 0.15))
    first = len(world.arm.goals)
    world.run(2.0, shifted(0.0, 0.0, 0.15))
    tool = np.array([world.rig.kinematics.forward(q)[:3, 3] for q in world.arm.goals[first:]])
    assert np.linalg.norm(np.diff(tool, axis=0), axis=1).max() <= 1.02 * 0.65 / 3.0 * DT
    assert reached(world, shifted(0.0, 0.0, 0.15))
    assert [t[0] for t in world.arm.commands] == ["ptp", "start_servo"]


@pytest.mark.parametrize("ahead", [0.0, 1.0, 1.5])
def test_a_hand_that_continues_moving_is_caught_up_with_little_faster_than_it_moves(ahead):
    """It sways 40 cm at 0.38 m/s, for which the joints need up to 0.38 of their full speeds."""
    world = World().at_home()
    world.control_on = True
    begin = world.now

    def sway(_):
        there, s = divmod((world.now - begin + ahead) / 2.0, 1.0)
        s = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        left = 0.4 * (1.0 - s if int(there) % 2 else s) - 0.2
        return shifted(0.5**0.5 * left, 0.5**0.5 * left, 0.0)

    while world.mode != "servo":
        world.run(3 * DT, sway)
    first = len(world.arm.goals)
    world.run(6.0, sway)
    shares = np.max(np.abs(np.diff(world.arm.goals[first:], axis=0)) / DT / world.rig.model.max_speed, axis=1)
    assert np.max(shares[1000:]) < 0.39 and np.max(shares) < 0.5
    assert world.steps[-1].limited_by == (), "caught up with"


def test_a_hand_that_comes_back_into_reach_elsewhere_is_caught_up_with_slowly():
    world = World().following()
    tool = out_of_reach_and_back()
    world.run(5.0, tool)
    assert world.loop.counts["ik_failures"] > 100
    first = len(world.arm.goals)
    world.run(5.0, lambda t: tool(5.0 + t))
    assert world.arm.commands == [] and world.modes == ["servo"]
    assert world.loop.counts["jumps"] == world.loop.counts["flips"] == 0
    assert np.max(tool_speeds(world, first)) < 1.02 * 0.65 * (1.0 / 3.0 + 1.0 / 6.0)
    assert np.max(np.abs(np.diff(world.arm.goals[first:], axis=0)) / DT / world.rig.model.max_speed) < 0.6
    assert reached(world, tool(10.0)) and world.steps[-1].limited_by == ()


def tool_speeds(world, first):
    """Speeds of the tool of the goals from number `first` on [m/s]."""
    places = np.array([world.rig.kinematics.forward(q)[:3, 3] for q in world.arm.goals[first:]])
    return np.linalg.norm(np.diff(places, axis=0), axis=1) / DT


@pytest.mark.parametrize(
    "way, count, because",
    [
        ({"jump": -0.1}, "jumps", "The desired tool frame jumped."),
        ({"turn": -1.2}, "flips", "asks for joints far from those before"),
    ],
)
def test_a_hand_that_comes_back_into_reach_after_a_jump_or_turned_far_is_picked_up_anew(way, count, because):
    world = World().following()
    world.run(10.0, out_of_reach_and_back(**way))
    assert [t[0] for t in world.arm.commands] == ["stop_servo", "ptp", "start_servo"]
    assert (world.loop.counts["jumps"], world.loop.counts["flips"]) == ((1, 0) if count == "jumps" else (0, 1))
    assert any(because in event for event in world.events)


def wandering(seed, seconds):
    """A random smooth way of the tool about its home: half a metre, within 25 deg; some of it is out of reach."""
    rng = np.random.default_rng(seed)
    waves = [(rng.normal(size=6), rng.uniform(0.0, 6.0, 6), f) for f in (1, 2, 3)]

    def at(t):
        angle = 2.0 * np.pi * t / seconds
        return sum(size * (np.sin(f * angle + phase) - np.sin(phase)) / f for size, phase, f in waves)

    def tool(t):
        x = at(min(t, seconds))
        T = shifted(*(0.1 * x[:3]))
        T[:3, :3] = T[:3, :3] @ rotation_from_zyx(*(0.44 * np.tanh(0.45 * x[3:])))
        return T

    return tool


def check_followed_without_a_jump(tool):
    """Follows a smooth hand that is partly out of reach."""
    world = World().following()
    first = len(world.arm.goals)
    world.run(8.0, tool)
    counts = world.loop.counts
    assert counts["jumps"] == counts["flips"] == counts["ik_failures"] == 0
    assert world.arm.commands == [] and world.modes == ["servo"]
    assert np.max(tool_speeds(world, first)) < 1.02 * 0.65
    assert np.max(np.abs(np.diff(world.arm.goals[first:], axis=0)) / DT / world.rig.model.max_speed) < 0.9 + 1e-6


@settings(max_examples=2)
@given(st.integers(0, 10**6))
def test_a_smooth_hand_never_counts_as_one_that_jumped(seed):
    """Before the base and in reach no PTP motion comes of it, and the goals keep the limits of speed."""
    tool = wandering(seed, 8.0)
    assume(all(x - y > 0.05 and z > 0.02 for x, y, z in (tool(t)[:3, 3] for t in np.arange(0.0, 8.0, 0.1))))
    check_followed_without_a_jump(tool)


@pytest.mark.parametrize("seed", [40584, 55, 148])
def test_a_smooth_hand_that_leaves_the_reach_and_comes_back_is_followed(seed):
    check_followed_without_a_jump(wandering(seed, 8.0))


def test_at_the_end_of_the_reach_the_tool_keeps_its_position_and_the_status_says_what_yields():
    world = World().following(shifted(0.0, 0.0, 0.15))
    world.run(2.0, lambda t: tipped(min(t, 0.8), z=0.15))
    step = world.steps[-1]
    assert world.modes == ["servo"] and reached(world, shifted(0.0, 0.0, 0.15))
    assert step.limited_by == ("reach",) and world.loop.counts["ik_failures"] == 0
    degrees = np.degrees(step.target.deviation)
    assert 5.0 < degrees < 45.0 and f"deviates by {degrees:.0f} deg." in step.reason
    R_reached = world.rig.kinematics.forward(world.arm.q)[:3, :3]
    assert rotation_angle(R_reached.T @ step.target.T_base_tool[:3, :3]) < 1e-6
    assert sum("deviates by" in event for event in world.events) == 1
    world.run(2.0, lambda t: tipped(max(0.8 - t, 0.0), z=0.15))
    assert world.modes == ["servo"] and world.arm.commands == []
    assert world.steps[-1].limited_by == () and "deviates" not in world.steps[-1].reason
    np.testing.assert_allclose(world.rig.kinematics.forward(world.arm.q), shifted(0.0, 0.0, 0.15), atol=1e-6)


def test_without_shaping_a_hand_that_moved_on_during_the_pick_up_is_picked_up_again():
    world = World(shaping="none").at_home()
    world.control_on = True
    world.run(0.02, shifted(0.1, 0.0, 0.0))
    while world.mode != "servo":
        world.run(DT, shifted(0.0, 0.0, 0.15))
    world.run(2.0, shifted(0.0, 0.0, 0.15))
    assert [t[0] for t in world.arm.commands] == ["ptp", "start_servo", "stop_servo", "ptp", "start_servo"]
    assert reached(world, shifted(0.0, 0.0, 0.15))


@pytest.mark.parametrize("position", [(-0.3, 0.3, 0.4), (0.4, -0.4, -0.01)])
@both
def test_an_infeasible_position_shuts_the_controller_down_where_the_arm_stands(schema, position):
    world = World(schema).at_home()
    world.control_on = True
    world.run(5.0, pose(HOME.T_base_tool[:3, :3], position))
    assert not world.arm.commands
    assert isinstance(world.steps[-1].command, End) and "infeasible" in world.steps[-1].command.fault


def test_an_unreachable_frame_at_home_is_in_the_status_while_it_comes_and_control_is_on():
    world = World().at_home()
    world.run(0.5, tipped(1.4))
    assert world.steps[-1].reason == f"The arm is at home. {OFF}"
    world.control_on = True
    world.run(0.3).run(0.5, tipped(1.4))
    assert world.mode == "home" and world.arm.commands == []
    assert world.steps[-1].reason.startswith("The arm is at home. The arm keeps its joints: The tool pose is out of")
    world.run(1.0)
    assert world.steps[-1].reason == "The arm is at home."


def test_a_frame_that_two_nodes_publish_stops_the_arm_until_control_goes_off_and_on_and_the_hand_comes_anew():
    world = World().following()
    world.conflict = "Two nodes, /a and /b, publish it."
    world.run(1.0, shifted(0.05, 0.0, 0.0))
    assert world.mode == "stopped" and world.conflict in world.steps[-1].reason
    assert world.events.count(world.conflict) == 1
    assert world.loop.counts["refused_frames"] == 1 and world.loop.counts["faults"] == 1
    stood, world.conflict = world.arm.q.copy(), None
    world.run(4.0, shifted(0.05, 0.0, 0.0))
    assert world.mode == "stopped" and np.array_equal(world.arm.q, stood)
    world.control_on = False
    world.run(0.1, shifted(0.05, 0.0, 0.0))
    world.control_on = True
    world.until("home", 4.0, shifted(0.05, 0.0, 0.0)).run(1.0, shifted(0.05, 0.0, 0.0))
    assert world.mode == "home", "the stream is still that of the conflict"
    world.run(0.5).until("servo", 4.0, shifted(0.05, 0.0, 0.0))


@pytest.mark.parametrize("mode", ["home", "pick_up"])
def test_a_stream_with_a_conflict_before_the_arm_follows_does_not_count_afterwards(mode):
    world = World().at_home()
    world.control_on = True
    tool = shifted(0.0, 0.1, 0.0)
    if mode == "pick_up":
        world.until(mode, 1.0, tool)
    world.conflict = "Two nodes, /a and /b, publish it."
    world.run(0.1, tool)
    world.conflict = None
    world.run(4.0, tool)
    assert world.mode == {"home": "home", "pick_up": "stopped"}[mode] and "Two nodes" in world.steps[-1].reason
    if mode == "home":
        world.run(0.5).until("servo", 4.0, tool)


def test_the_wall_clock_may_be_set_while_the_arm_follows():
    def sway(t):
        return shifted(0.0, 0.0, 0.06 * (1.0 - np.cos(6.0 * t)))  # up to 0.36 m/s

    steady, world = World().following(), World().following()
    for i in range(40):
        world.clock += (3.0, -3.0, -3600.0, 3600.0)[i % 4]
        for each in (steady, world):
            start = 0.144 * i
            each.run(0.048, None)  # the frames that were on their way are left out
            each.run(0.096, lambda t, start=start: sway(start + 0.048 + t))
        assert world.mode == "servo" and not set(world.modes) - {"servo"}, world.steps[-1].reason
        np.testing.assert_allclose(world.arm.q, steady.arm.q, atol=np.radians(1.0))  # at a third of the speed it lags


@pytest.mark.hazard(8)
@pytest.mark.parametrize("off_s", [0.0, 1.0])
def test_a_safety_stop_is_found_held_and_latched(off_s):
    world = World().following()
    world.arm.held = True
    world.run(2.0, lambda t: shifted(0.05 * t, 0.0, 0.0))
    assert world.mode == "stopped" and world.arm.commands == [("stop_servo",)]
    assert "safety stop" in world.loop.stopped_because
    held_at = world.arm.q.copy()
    world.arm.held = False
    world.run(2.0, shifted(0.1, 0.0, 0.0))
    np.testing.assert_allclose(world.arm.q, held_at)
    world.control_on = False
    if off_s:
        world.run(off_s, shifted(0.1, 0.0, 0.0))
    np.testing.assert_allclose(world.arm.q, held_at)
    world.arm.commands.clear()
    world.control_on = True
    world.run(0.3).run(5.0, shifted(0.05, 0.0, 0.0))
    assert [t[0] for t in world.arm.commands] == ["ptp", "ptp", "start_servo"]
    assert world.arm.commands[0] == ptp(HOME.q, SLOW)
    assert world.loop.stopped_because is None


@pytest.mark.parametrize("when", ["start", "end"])
@both
def test_a_refused_motion_latches(schema, when):
    world = World(schema)
    world.arm.refuse = when
    world.run(1.0)
    assert world.mode == "stopped" and len(world.arm.commands) == 1
    assert any("refused the motion to home" in e for e in world.events)
    world.arm.refuse = None
    world.control_on = True
    world.run(4.0)
    assert world.mode == "home"


HELD_S = [0.5, 1.8, 5.0]


@pytest.mark.parametrize("seconds", HELD_S)
@both
def test_after_a_motion_to_a_hand_that_a_safety_stop_held_nothing_is_followed(schema, seconds):
    world = World(schema).at_home()
    world.control_on = True
    tool = shifted(0.1, 0.0, 0.0)
    world.run(0.05, tool)
    world.arm.held = True
    world.run(seconds, tool)
    assert sum("does not continue" in e for e in world.events) == 1
    world.arm.held = False
    world.run(2.0, tool)
    assert world.mode == "stopped" and [t[0] for t in world.arm.commands] == ["ptp"]
    assert "held the arm" in world.loop.stopped_because
    world.run(2.0, shifted(0.0, 0.1, 0.0))
    assert [t[0] for t in world.arm.commands] == ["ptp"]
    world.control_on = False
    world.run(0.3)
    world.control_on = True
    world.run(4.0, tool)
    assert world.loop.stopped_because is None and reached(world, tool)


@pytest.mark.parametrize("seconds", HELD_S)
@both
def test_after_a_way_home_that_a_safety_stop_held_the_arm_stays_there(schema, seconds):
    world = World(schema).at_home()
    world.control_on = True
    tool = shifted(0.1, 0.0, 0.0)
    world.run(2.0, tool)
    world.until("returning", 1.0).run(0.02)
    world.arm.held = True
    world.run(seconds, tool)
    world.arm.held = False
    world.arm.commands.clear()
    world.run(4.0, tool)
    assert world.mode == "stopped" and world.arm.commands == []
    np.testing.assert_allclose(world.arm.q, HOME.q)
    world.control_on = False
    world.run(0.3)
    world.control_on = True
    world.run(4.0, tool)
    assert world.arm.commands[0] == ptp(HOME.q, SLOW) and reached(world, tool)


def test_a_lost_connection_ends_the_cycle():
    world = World().following()
    world.arm.fail = ConnectionLost("the link is gone")
    with pytest.raises(ConnectionLost):
        world.run(DT, shifted(0.0, 0.0, 0.0))


def test_ptp_goes_to_frames_beyond_the_threshold_only():
    world = World(PtpConfig).at_home()
    world.control_on = True
    world.run(0.5, shifted(0.001, 0.0, 0.0))
    assert world.arm.commands == []
    world.run(2.0, shifted(0.05, 0.0, 0.0))
    assert [t[0] for t in world.arm.commands] == ["ptp"] and world.arm.commands[0][2] == 0.15
    assert reached(world, shifted(0.05, 0.0, 0.0))


@pytest.mark.hazard(1)
@settings(max_examples=15)
@given(
    st.lists(st.tuples(st.booleans(), st.booleans(), st.sampled_from([0.05, 0.15, 0.3])), min_size=1, max_size=6),
    st.sampled_from([RealTimeConfig, PtpConfig]),
)
def test_whatever_comes_first_the_arm_leaves_home_only_for_a_stream_that_began_after_control_went_on(moments, schema):
    """`moments`: whether control is on, whether the hand is shown, and for how long."""
    world = World(schema).at_home()
    began_on = False
    pause = 1.0
    for on, shown, seconds in moments:
        switched_on = on and not world.control_on
        world.control_on = on
        if switched_on and pause <= 0.2:
            began_on = False
        elif shown and pause > 0.2:
            began_on = on
        pause = 0.0 if shown else pause + seconds
        world.run(seconds, shifted(0.05, 0.0, 0.0) if shown else None)
        assert began_on or not any(command[0] == "ptp" and command[2] == FAST for command in world.arm.commands)
        if world.arm.commands:
            return


def test_a_stall_of_the_loop_costs_no_pick_up_and_no_return_home():
    """One lost packet stops TCP for 200 ms; the hand moves on meanwhile at 0.2 m/s, and its frames were there."""
    world = World().following()
    start = world.now

    def tool(_):
        return shifted(0.0, 0.2 * (world.now - start) if world.now - start < 0.7 else 0.14, 0.0)

    world.run(0.2, tool)
    for stall in (0.25, 0.05, 0.08):
        before = world.arm.goals[-1]
        world.now += stall
        world.run(DT, tool)
        np.testing.assert_array_equal(world.arm.goals[-1], before, "from rest")
        first = len(world.arm.goals) - 1
        world.run(0.1, tool)
        speeds = np.diff(world.arm.goals[first:], axis=0) / DT
        assert np.max(np.abs(np.diff(speeds, axis=0) / DT)) <= 1.01 * 12.0 * 1.84
    world.run(1.0, tool)
    assert world.arm.commands == [] and world.loop.counts["jumps"] == 0 and reached(world, tool(0.0))
    assert world.loop.counts["goal_gaps"] == 3


def test_after_a_stall_the_arm_catches_up_at_a_third_of_its_speed():
    world = World().following()
    moved_on = shifted(0.0, 0.14, 0.0)
    world.now += 0.3  # in which the hand moved there
    first = len(world.arm.goals)
    world.run(2.0, moved_on)
    assert world.arm.commands == [] and world.loop.counts["jumps"] == 0 and reached(world, moved_on)
    positions = [world.rig.kinematics.forward(q)[:3, 3] for q in world.arm.goals[first:]]
    fastest = np.max(np.linalg.norm(np.diff(positions, axis=0), axis=1)) / DT
    assert 0.9 * CATCH_UP_SCALE * TOP_M_S < fastest <= 1.01 * CATCH_UP_SCALE * TOP_M_S


def test_after_a_stall_a_hand_that_is_elsewhere_still_counts_as_one_that_jumped():
    world = World().following()
    world.now += 0.25
    world.run(0.5, shifted(0.25, 0.0, 0.0))
    assert world.arm.commands[0] == ("stop_servo",) and world.loop.counts["jumps"] == 1
    world = World().following()
    world.now += 3.0
    world.run(0.5, shifted(0.1, 0.0, 0.0))
    assert world.loop.counts["jumps"] == 1, "nobody knows what the hand did for so long"


TOP_M_S = SPEED_MARGIN * 0.65


def away(t):
    """A hand that goes aside by 0.2 m at up to 0.94 m/s."""
    s = np.clip((t - 1.0) / 0.4, 0.0, 1.0)
    left = 0.2 * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
    return shifted(0.5**0.5 * left, 0.5**0.5 * left, 0.0)


@pytest.mark.parametrize(("rate", "fraction"), [(115.0, 1.0), (50.0, 5.0 / 6.0), (30.0, 0.5), (24.0, 0.4)])
def test_the_speed_limit_falls_with_the_rate_of_the_frames(rate, fraction):
    world = at_rate(World().following(), rate, away, 1.0)
    first = len(world.arm.goals)
    at_rate(world, rate, lambda t: away(1.0 + t), 3.0)
    fastest = np.max(tool_speeds(world, first))
    assert 0.9 * fraction * TOP_M_S < fastest < 1.06 * fraction * TOP_M_S
    assert reached(world, away(9.0)) and world.mode == "servo"


def test_frames_that_come_22_times_a_second_are_followed_again():
    world = at_rate(World().following(), 15.0, lambda t: shifted(0.0, 0.0, 0.0), 1.0)
    assert "frame rate" in world.steps[-1].limited_by
    at_rate(world, 22.0, lambda t: shifted(0.0, 0.0, 0.0), 1.0)
    assert "frame rate" not in world.steps[-1].limited_by and world.mode == "servo"
    at_rate(world, 20.5, lambda t: shifted(0.0, 0.0, 0.0), 1.0)
    assert "frame rate" not in world.steps[-1].limited_by


@pytest.mark.hazard(6)
@pytest.mark.parametrize("frames", ["4 a second", "10 a second", "in pairs", "5 a second, control on in mid-stream"])
def test_however_slow_frames_come_the_tool_does_not_follow_them(frames):
    world = World(time_out=1.0).at_home()
    if "mid-stream" not in frames:
        world.control_on = True
    stamps = np.arange(0.0, 6.0, {"4": 0.25, "1": 0.1, "i": 0.18, "5": 0.2}[frames[0]])
    if frames == "in pairs":
        stamps = np.sort(np.concatenate([stamps, stamps + 0.005]))
    start, number = world.now, 0
    for _ in range(1500):
        t = world.now - start
        fresh = number < len(stamps) and stamps[number] <= t
        number += fresh
        if t > 1.0 and not world.control_on:
            world.control_on = True
        world.run(DT, shifted(0.0, 0.05 * min(t, 2.0), 0.0) if fresh else None)
    if "mid-stream" in frames:
        assert world.arm.commands == []
        return
    goals = np.array([world.rig.kinematics.forward(q)[:3, 3] for q in world.arm.goals])
    way = np.sum(np.linalg.norm(np.diff(goals[80:], axis=0), axis=1))
    assert way < 0.03, "but for the first third of a second, in which the rate is not known yet"


ENDS = {
    "control off": lambda world: setattr(world, "control_on", False),
    "exit": lambda world: setattr(world, "exit_requested", True),
    "silence": None,
    "jump": (0.0, 0.0, -0.15),
    "infeasible": (-0.9, 0.9, 0.0),
}


@pytest.mark.parametrize("end", ENDS)
@pytest.mark.parametrize("speed", [0.15, 0.5])
def test_every_end_of_the_stream_brakes_within_the_limits(end, speed):
    world = World().following()
    start = world.now

    def tool(_):
        t = world.now - start
        return shifted(*(0.5**0.5 * speed * min(t, 0.5 * t * t) * np.array([1.0, 1.0, 0.0])))

    world.run(1.2 if speed < 0.3 else 0.9, tool)
    happens = ENDS[end]
    if callable(happens):
        happens(world)
    there = tool(0.0)
    if isinstance(happens, tuple):
        there = there.copy()
        there[:3, 3] += happens
    last = len(world.arm.goals)
    moving = np.max(np.abs(np.diff(world.arm.goals[-2:], axis=0))) / DT
    assert moving > 0.3 * speed
    rests = {"exit": State.ZERO, "jump": State.SERVO_LEFT, "infeasible": State.SERVO_LEFT}
    world.until_state(rests.get(end, State.RETURN_PENDING), None if end == "silence" else lambda _: there)
    braked = np.array(world.arm.goals[last - 4 :])
    assert len(braked) > 10, "it did not end at once"
    speeds = np.diff(braked, axis=0) / DT
    accelerations = np.diff(speeds, axis=0) / DT
    pace = world.rig.model.max_speed / np.min(world.rig.model.max_speed)
    assert np.all(np.abs(accelerations) <= 12.0 * pace * 1.001)
    assert np.all(np.abs(np.diff(accelerations, axis=0) / DT) <= 1000.0 * pace * 1.01)
    np.testing.assert_allclose(speeds[-1], 0.0, atol=0.06)
    assert ("stop_servo",) in world.arm.commands
