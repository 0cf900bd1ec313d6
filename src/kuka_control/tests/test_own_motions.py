"""What the arm does of its own accord: it repeats no motion that nobody asked for at once, whatever comes; it takes a
stream over that ran before control was switched on only where that is near; a new scaling factor moves nothing.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule
from loop_world import DT, HOME, SLOW, World, reached, rig, shifted

from common.poses import pose
from common.rotations import rotation_about
from kuka_control.loop.admission import TAKEN_OVER, too_far
from kuka_control.loop.commands import Servo, StartPtp
from kuka_control.loop.moves import MoveState
from kuka_control.loop.transitions import State, Trigger
from kuka_control.model.config import PtpConfig, RealTimeConfig
from kuka_control.model.target import MotionScaling
from kuka_control.numbers import AGAIN_S, ANNOUNCED_S, NEAR_M, NEAR_RAD

both = pytest.mark.parametrize("schema", [RealTimeConfig, PtpConfig])
schemas = st.sampled_from([RealTimeConfig, RealTimeConfig, PtpConfig])
PERIOD = 3 * DT
PLACES = [shifted(0.0, 0.0, 0.0), shifted(0.005, 0.0, 0.0), shifted(0.1, 0.0, 0.0), shifted(0.0, 0.12, 0.05)]
NEAR = shifted(0.05, 0.0, 0.05)


def stream(world, seconds, tool, period=PERIOD):
    """A tool frame, or a function of time [s] that returns one, is published once in each period; cycle by cycle."""
    begin = due = world.now
    while world.now < begin + seconds - 1e-9:
        comes = world.now >= due - 1e-9
        due += period * comes
        T = tool(world.now - begin) if callable(tool) else tool
        world.run(DT, T if comes else None)
    return world


class OwnAccord(RuleBasedStateMachine):
    """In whatever order streams come, of whatever rate, interrupted and jumping: no PTP motion that nobody asked for is
    repeated within 10 s, where a hand may have come in more than once.
    """

    @initialize(schema=schemas, foreign=st.booleans(), time_out=st.sampled_from([0.2, 0.2, 1.0]))
    def start(self, schema, foreign, time_out):
        self.world = World(schema, time_out=time_out).at_home()
        self.world.foreign = foreign
        self.world.control_on = True
        self.most = 1 if foreign else 2
        self.own = {State.PICK_UP: [], State.RETURNING: []}
        self.seen = len(self.world.steps)
        self.returns_by_itself = False

    @rule(
        place=st.sampled_from(PLACES),
        other=st.sampled_from([None, *PLACES]),
        period=st.sampled_from([PERIOD, PERIOD, PERIOD, 0.1, 0.21, 0.25, 0.5, 1.5]),
        seconds=st.sampled_from([0.05, 0.3, 1.0, 3.0]),
        pause=st.sampled_from([0.0, 0.21, 0.25, 0.4, 1.0, 3.0]),
        times=st.integers(1, 4),
    )
    def come(self, place, other, period, seconds, pause, times):
        """A stream, which may jump to and fro each 0.4 s; and so on after a pause."""
        for _ in range(times):
            jumps = place if other is None else lambda t: other if int(t / 0.4) % 2 else place
            stream(self.world, seconds, jumps, period)
            self.world.run(pause) if pause else None
        self.check()

    @rule()
    def switch_off_and_on(self):
        self.world.control_on = False
        self.world.run(0.5)
        self.check()
        self.world.control_on = True
        self.asked()

    @rule()
    def program_moves(self):
        self.world.run(0.4)
        self.check()
        self.world.ask("aside")
        self.world.run(2.0)
        if self.world.progress.state in (MoveState.RUNNING, MoveState.DONE):
            self.asked()
        self.check()

    def asked(self):
        for times in self.own.values():
            times.clear()

    def check(self):
        table = self.world.table
        for i, step in enumerate(self.world.steps[self.seen :], self.seen):
            now = 100.0 + i * DT
            for source, trigger in step.transitions:
                self.returns_by_itself = trigger is Trigger.TIME_OUT or (
                    self.returns_by_itself and source in (State.BRAKING, State.RETURN_PENDING)
                )
                if not isinstance(step.command, StartPtp):
                    continue
                target = table[source, trigger].target
                if (target is State.PICK_UP and source is not State.AT_POSE) or (
                    target is State.RETURNING and self.returns_by_itself
                ):
                    times = self.own[target]
                    times.append(now)
                    assert sum(now - before < AGAIN_S - 1e-6 for before in times) <= self.most, step.reason
        self.seen = len(self.world.steps)


OwnAccord.TestCase.settings = settings(max_examples=25, stateful_step_count=8, deadline=None)
TestOwnAccord = OwnAccord.TestCase


@pytest.mark.hazard(4)
@both
@pytest.mark.parametrize("period", [0.21, 0.25, 0.5, 1.0, 6.0])
def test_a_stream_slower_than_its_time_out_is_named_with_both_figures_and_not_followed(schema, period):
    world = World(schema).at_home()
    world.control_on = True
    stream(world, 30.0, NEAR, period)
    assert world.arm.commands == []
    reason = next(step.reason for step in reversed(world.steps) if "time_out" in step.reason)
    assert f"only every {period:.2f} s, but time_out is 0.2 s" in reason
    stream(world, 3.0, NEAR)
    assert reached(world, NEAR), "one that is fast enough is"


@both
def test_a_repetition_waits_and_says_how_long_and_control_off_and_on_ends_that(schema):
    world = World(schema).at_home()
    world.control_on = world.foreign = True
    stream(world, 1.0, NEAR).run(1.0)
    assert world.mode == "home" and len(world.arm.commands) >= 2
    commands = len(world.arm.commands)
    stream(world, 3.0, NEAR)
    assert len(world.arm.commands) == commands and "it waits 7 s more" in world.steps[-1].reason
    stream(world, 7.0, NEAR)
    assert reached(world, NEAR)
    world.run(3.0)
    world.control_on = False
    world.run(0.1)
    world.control_on = True
    stream(world, 2.0, NEAR)
    assert reached(world, NEAR)


@pytest.mark.parametrize("foreign", [False, True])
def test_with_ptp_motions_each_pose_of_a_stream_is_asked_for_and_counts_as_no_repetition(foreign):
    world = World(PtpConfig).at_home()
    world.control_on = True
    world.foreign = foreign
    for tool in (NEAR, shifted(0.0, 0.1, 0.0), NEAR):
        stream(world, 1.5, tool)
        assert reached(world, tool)
    world.run(2.5)
    stream(world, 1.5, NEAR)
    assert reached(world, NEAR) == (not foreign), "the return home is the first one, a hand has one repetition free"


@both
def test_each_hand_that_comes_in_is_followed_at_once_and_one_whose_link_is_interrupted_is_not(schema):
    world = World(schema).at_home()
    world.control_on = True
    for hand in range(4):
        world.engagement = hand
        stream(world, 1.5, NEAR)
        assert reached(world, NEAR)
        world.run(0.8)
        assert world.mode == "home"
    for _ in range(4):
        stream(world, 1.5, NEAR)
        went = reached(world, NEAR)
        world.run(0.8)
    assert not went and "it waits" in " ".join(world.events)


@both
def test_a_near_stream_that_runs_already_is_announced_and_picked_up_slowly(schema):
    world = World(schema).at_home()
    world.foreign = True
    stream(world, 0.5, NEAR)
    world.control_on, begin = True, world.now
    while not world.arm.commands:
        stream(world, DT, NEAR, DT)
    assert world.now - begin == pytest.approx(ANNOUNCED_S, abs=3 * DT)
    kind, _, velocity = world.arm.commands[0]
    assert (kind, velocity) == ("ptp", SLOW) and TAKEN_OVER in world.events
    assert any(TAKEN_OVER in step.reason for step in world.steps)
    stream(world, 3.0, NEAR)
    assert reached(world, NEAR)


@pytest.mark.hazard(1)
@both
def test_a_far_stream_that_runs_already_is_refused_with_both_figures(schema):
    world = World(schema).at_home()
    world.foreign = True
    far = shifted(0.0, 0.25, 0.2)
    stream(world, 0.5, far)
    world.control_on = True
    stream(world, 3.0, far)
    assert world.arm.commands == [] and "320 mm and 0 deg" in world.steps[-1].reason
    assert "within 300 mm and 45 deg" in world.steps[-1].reason
    stream(world, 3.0, NEAR)
    assert world.arm.commands == [], "the arm does not start because a frame comes nearer by itself"
    world.control_on = False
    stream(world, 0.1, NEAR)
    world.control_on = True
    stream(world, 3.0, NEAR)
    assert reached(world, NEAR)


FAR = shifted(0.0, 0.25, 0.2)
PAUSES = st.sampled_from([0.0, 0.25, 0.29, 0.35, 0.8, 1.9])


@settings(max_examples=15, deadline=None)
@given(
    schemas,
    st.sampled_from([NEAR, FAR]),
    st.lists(st.tuples(PAUSES, st.floats(0.05, 0.9)), min_size=1, max_size=3),
    PAUSES,
)
def test_a_publisher_that_lags_does_not_become_a_new_stream(schema, tool, runs, silence):
    """Whatever pauses of less than 2 s a foreign stream has that was there when control was switched on: a far one is
    never followed, a near one only slowly, and announced 1 s before; the same where two publishers are in conflict.
    """
    world = World(schema).at_home()
    world.foreign = True
    stream(world, 0.5, tool)
    for pause, seconds in runs:  # control is switched on in the midst of the first pause
        world.run(min(pause, 1.0)) if world.enable_count == 0 and pause else None
        pause -= min(pause, 1.0) if world.enable_count == 0 else 0.0
        world.control_on = True
        world.run(pause) if pause else None
        stream(world, seconds, tool)
    motions = [command for command in world.arm.commands if command[0] == "ptp"]
    if motions:
        assert tool is NEAR and motions[0][2] == SLOW and TAKEN_OVER in world.events
    else:
        world.conflict = "Both /a and /b publish it."
        stream(world, 0.1, tool)
        world.conflict = None
        world.run(silence) if silence else None
        stream(world, 3.0, tool)
        assert world.arm.commands == [] and "Both /a and /b" in world.steps[-1].reason
        world.run(2.1)
        stream(world, 3.0, tool)
        assert reached(world, tool), "after a longer pause it is a new one"


def test_a_stream_that_pauses_when_control_goes_on_was_there_and_is_announced_again_after_each_pause():
    world = World().at_home()
    world.foreign = True
    stream(world, 0.5, NEAR)
    world.run(1.0)
    world.control_on = True
    stream(world, 0.2, NEAR)
    assert world.arm.commands == [] and TAKEN_OVER in world.steps[-1].reason
    world.run(0.4)
    assert TAKEN_OVER not in world.steps[-1].reason
    begin = world.now
    while not world.arm.commands:
        stream(world, DT, NEAR, DT)
    assert world.arm.commands[0][2] == SLOW
    assert world.now - begin == pytest.approx(ANNOUNCED_S, abs=4 * DT), "it is announced again after the pause"


@given(st.floats(0.0, 1.0), st.floats(0.0, 3.0))
def test_near_is_near_in_position_and_orientation(distance, turn):
    assert (too_far(distance, turn) is None) == (distance <= NEAR_M and turn <= NEAR_RAD)


@settings(max_examples=30, deadline=None)
@given(
    schemas,
    st.booleans(),
    st.sampled_from([None, NEAR, shifted(0.0, 0.1, 0.0), shifted(0.0, 0.3, 0.2)]),
    st.sampled_from([PERIOD, PERIOD, 0.1, 0.25]),
    st.sampled_from([0.0, 0.0, -1.0]),
)
def test_what_is_said_when_control_goes_on_is_what_happens(schema, foreign, tool, period, skew):
    world = World(schema).at_home()
    world.foreign, world.skew = foreign, skew
    stream(world, 1.0, tool, period)
    outlook = world.loop.when_enabled
    assert (outlook is None) == (tool is None)
    world.control_on = True
    stream(world, 2.0, tool, period)
    assert bool(world.arm.commands) == bool(outlook and outlook.startswith(TAKEN_OVER))
    if outlook is not None:
        assert outlook.split(";")[0][:60] in world.steps[-1].reason or world.arm.commands


positions = st.tuples(*[st.floats(-0.3, 0.3)] * 3).map(lambda p: HOME.T_base_tool[:3, 3] + p)
factors = st.lists(st.floats(0.1, 1.5), min_size=1, max_size=8)


@given(positions, positions, factors)
def test_a_new_factor_keeps_the_tool_where_it_is_and_scales_what_the_hand_does_from_there(position, step, changes):
    chain = rig(RealTimeConfig)[1].chain
    T, scaling = pose(p=position), MotionScaling()
    before = chain.desired(T, scaling)
    for factor in changes:
        scaling = chain.rescaled(scaling, factor, before[:3, 3])
        np.testing.assert_allclose(chain.desired(T, scaling)[:3, 3], before[:3, 3], atol=1e-9)
    moved = chain.desired(pose(p=step), scaling)[:3, 3] - before[:3, 3]
    np.testing.assert_allclose(moved, (step - position) / changes[-1], atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(st.sampled_from([0.0, 0.1, 0.5]), st.floats(0.1, 1.5)), min_size=1, max_size=6))
def test_no_target_jumps_when_the_factor_changes_while_the_arm_follows(changes):
    world = World().following(NEAR)
    begin = world.now

    def hand(_):
        t = world.now - begin
        return shifted(0.05 + 0.03 * np.sin(2.0 * t), 0.04 * np.sin(3.0 * t), 0.05)

    world.run(PERIOD, hand)
    n, goals = len(world.steps), len(world.arm.goals)
    for seconds, factor in changes:
        world.scale = factor
        world.run(max(seconds, PERIOD), hand)
    assert world.mode == "servo" and world.steps[-1].scaling.factor == changes[-1][1]
    tools = [step.target.T_base_tool[:3, 3] for step in world.steps[n - 1 :]]
    steps = np.linalg.norm(np.diff(tools, axis=0), axis=1)
    assert np.max(steps) <= 1.5 * PERIOD * np.hypot(0.06, 0.12) + 1e-6
    speed = np.abs(np.diff(world.arm.goals[goals - 1 :], axis=0)) / DT
    assert np.all(speed <= 0.9 * world.rig.model.max_speed + 1e-9)


@pytest.mark.hazard(1)
@both
def test_a_new_factor_alone_moves_nothing_and_counts_from_the_centre_again_at_home(schema):
    world = World(schema).at_home()
    world.control_on = True
    stream(world, 3.0, NEAR)
    assert reached(world, NEAR)
    world.arm.commands.clear()
    for factor in (0.5, 1.5, 0.1, 1.0, 0.7):
        world.scale = factor
        stream(world, 0.5, NEAR)
    assert reached(world, NEAR) and world.arm.commands == []
    assert np.linalg.norm(world.steps[-1].scaling.offset) > 0.01
    world.run(3.0)
    assert world.mode == "home" and np.all(world.steps[-1].scaling.offset == 0.0)
    stream(world, 4.0, NEAR)
    scaled_to = HOME.centre + 0.7 * (NEAR[:3, 3] - HOME.centre)
    assert reached(world, pose(NEAR[:3, :3], scaled_to))


def test_orientation_counts_for_near_too():
    world = World().at_home()
    world.foreign = True
    turned = NEAR.copy()
    turned[:3, :3] = rotation_about(2, np.radians(50.0)) @ turned[:3, :3]
    stream(world, 0.5, turned)
    world.control_on = True
    stream(world, 3.0, turned)
    assert world.arm.commands == [] and "50 deg" in world.steps[-1].reason
    assert not any(isinstance(step.command, Servo) for step in world.steps[-100:])
