"""Motions for programs: what is refused, and laws of straight lines in the control loop in simulated time."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from loop_world import DT, HOME, SLOW, World, block, planner, rig, shifted

from common import clock
from common.modes import Mode
from common.poses import pose
from common.rotations import rotation_about, rotation_angle
from kuka_control.limits import line_plan
from kuka_control.limits.line_plan import MoveRefused, plan_line
from kuka_control.loop import assembly
from kuka_control.loop.commands import Servo
from kuka_control.loop.line_stream import LineStream
from kuka_control.loop.moves import MoveGoal, MoveProgress, MoveState, ProgramMotion
from kuka_control.loop.transitions import State
from kuka_control.model.config import PtpConfig, RealTimeConfig

CONFIGURATION, RIG = rig(RealTimeConfig)
PLANNER = planner(RealTimeConfig)
small = st.floats(-0.4, 0.4)
ends = st.tuples(*[st.floats(-0.12, 0.12)] * 3, small, small, small)
NAN = float("nan")


def frame(x, y, z, a, b, c):
    T = shifted(x, y, z)
    return pose(T[:3, :3] @ rotation_about(2, a) @ rotation_about(1, b) @ rotation_about(0, c), T[:3, 3])


def planned(target, **goal):
    return PLANNER.plan(1, MoveGoal(target, **goal), HOME.q)


def at_home():
    world = World().at_home()
    world.control_on = True
    return world


def within_limits(goals):
    """Checks the goals of every cycle, shape (n, 7)."""
    pace = RIG.model.max_speed / np.min(RIG.model.max_speed)
    for order, most in enumerate((0.9 * RIG.model.max_speed, 12.0 * pace, 1000.0 * pace), 1):
        derivatives = np.diff(goals, order, axis=0) / DT**order
        assert np.all(np.abs(derivatives) <= 1.02 * most + 1e-3), order
    tool = np.array([RIG.kinematics.forward(q)[:3, 3] for q in goals])
    assert np.all(np.linalg.norm(np.diff(tool, axis=0), axis=1) <= 0.65 * DT + 1e-6)


def run(world, cancel_at=None):
    """Returns the goals of the motion that was asked for, until it ends."""
    goals, start = [], world.now
    world.run(2 * DT)
    while world.progress.state is MoveState.RUNNING:
        if isinstance(world.steps[-1].command, Servo):
            goals.append(world.loop.goal)
        if cancel_at is not None and world.now - start >= cancel_at:
            world.cancel()
        world.run(DT)
        assert world.now < start + 60.0
    return np.array(goals)


def drive(plan, stop_at=None, start=None):
    """Returns the goals along a line for an arm without lag, and how many came before `stop_at` [s]."""
    start = plan.q_start if start is None else start
    limits = assembly.motion_limits(CONFIGURATION, RIG)
    loop = assembly.real_time_loop(CONFIGURATION, RIG)
    stream, now = LineStream(loop._settings.goals, limits, False, start, 0.0, plan), 0.0
    goals, on_line = [start] * 4, 4
    while not stream.arrived and (stop_at is None or now < stop_at):
        now += DT
        goals.append(stream.goal(limits.goal, now).q)
        on_line = len(goals)
        assert stream.blocked(now) is None and now < plan.duration + 1.0
    while True:
        now += DT
        goal = stream.brake(limits.goal, now)
        if goal is None:
            break
        goals.append(goal.q)
    assert limits.at_rest
    return np.array(goals), on_line


@settings(max_examples=20)
@given(ends, st.sampled_from([0.15, 0.3, 0.6]), st.none() | st.floats(0.0, 1.0))
@example((0.0, 0.0, 0.0, 0.0, 0.0, 0.25), 0.3, 0.5)
def test_the_tool_keeps_to_the_line_within_the_limits_and_rests_at_its_end(end, velocity, stop_after):
    T = frame(*end)
    try:
        plan = planned(T, straight=True, velocity=velocity).line
    except MoveRefused as refusal:
        assert str(refusal)
        return
    goals, on_line = drive(plan, None if stop_after is None else stop_after * plan.duration)
    within_limits(goals)
    A, B = HOME.T_base_tool, T
    frames = [RIG.kinematics.forward(q) for q in goals]
    way, total = B[:3, 3] - A[:3, 3], rotation_angle(A[:3, :3].T @ B[:3, :3])
    for i in range(0, len(frames), max(1, len(frames) // 100)):
        F = frames[i]
        s = np.clip((F[:3, 3] - A[:3, 3]) @ way / max(way @ way, 1e-12), 0.0, 1.0)
        # A stop on the way is the earliest one of each joint.
        assert np.linalg.norm(A[:3, 3] + s * way - F[:3, 3]) < (1e-3 if i < on_line else 5e-3)
        turned, left = rotation_angle(A[:3, :3].T @ F[:3, :3]), rotation_angle(F[:3, :3].T @ B[:3, :3])
        assert i >= on_line or turned + left <= total + 0.005, "one turn about one axis"
    if stop_after is None:
        np.testing.assert_allclose(frames[-1], T, atol=1e-6)
        np.testing.assert_array_equal(goals[-1], plan.q_goal)


@pytest.mark.parametrize(
    ("target", "goal", "words"),
    [
        (shifted(NAN, 0.0, 0.0), {}, "not finite|numbers"),
        (shifted(0.0, 0.0, 8.0), {}, "metres"),
        (shifted(0.0, 0.0, -0.3), {}, "lower z limit"),
        (HOME.T_base_tool, {"straight": True}, "0.00 mm long"),
        (shifted(0.0, 0.0, -0.3), {"straight": True}, "At .* of the line, .* outside the workspace: lower z limit"),
        (shifted(0.0, 0.05, 0.0), {"straight": True, "velocity": 0.7}, "at most 0.6305 m/s"),
        (shifted(0.0, 0.05, 0.0), {"straight": True, "velocity": NAN}, "velocity is nan"),
        (frame(0.0, 0.0, 0.0, 0.0, 0.0, np.pi), {"straight": True}, "At .* of the line"),
        (frame(0.12, 0.11, 0.22, -0.4, 0.2, 0.4), {"straight": True}, "joint 6 would be at the end of its range"),
        (frame(-0.01, -0.04, 0.19, -2.1, 1.0, 1.4), {"straight": True}, "joint 5 would have to turn at once"),
        (shifted(NAN, 0.0, 0.0), {"straight": True}, "not finite|numbers"),
        (shifted(0.0, 0.0, 8.0), {"straight": True}, "metres"),
        (HOME.q, {"straight": True}, "to a pose"),
        ("home", {"straight": True}, "to a pose"),
        (HOME.q + NAN, {}, "seven finite"),
        (HOME.q + 3.0, {}, "out of its range"),
        (HOME.q + np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]), {}, "below z_lower_limit"),
        (np.array([1.6, -1.8, 0.7, 0.3, -0.5, 1.3, 0.0]), {}, "of the motion the wrist .* below z_lower_limit"),
        (HOME.q, {"velocity": 0.3}, "at most 0.25 of the full joint speed"),
        (HOME.q, {"velocity": -1.0}, "at least 0.01 and at most 0.25"),
        (HOME.q, {"velocity": 0.009}, "at least 0.01 and at most 0.25"),
        (shifted(0.0, 0.05, 0.0), {"straight": True, "velocity": 1e-300}, "at least 0.005 and at most 0.6305 m/s"),
        ("nowhere", {}, "known are aside, home, zero"),
    ],
)
def test_what_cannot_be_done_is_refused_by_a_sentence(target, goal, words):
    with pytest.raises(MoveRefused, match=words):
        planned(target, **goal)


def test_a_motion_that_is_too_low_only_on_its_way_is_refused():
    start, goal = np.array([2.6, -0.9, 0.6, 1.4, 0.4, -1.7, 0.0]), np.array([-0.8, -0.8, -0.7, 1.4, 0.3, 0.9, 0.0])
    for q in (start, goal):
        PLANNER.plan(1, MoveGoal(q), q)
    with pytest.raises(MoveRefused, match="the tool point would be at a height of .* below z_lower_limit"):
        PLANNER.plan(1, MoveGoal(goal), start)


def test_in_a_gap_the_way_waits():
    plan = planned(shifted(0.0, 0.05, 0.05), straight=True).line
    limits = assembly.motion_limits(CONFIGURATION, RIG)
    goals = assembly.real_time_loop(CONFIGURATION, RIG)._settings.goals
    stream, now = LineStream(goals, limits, False, plan.q_start, 0.0, plan), 0.0
    while stream.fraction < 0.3:
        now += DT
        stream.goal(limits.goal, now)
    before, now = stream.fraction, now + 0.2
    stream.goal(limits.goal, now)
    assert stream.fraction == before
    stream.goal(limits.goal, now + DT)
    assert before < stream.fraction < before + 0.001, "and it begins slowly"


def test_a_short_line_beside_a_singular_pose_is_refused_with_the_speed_that_a_joint_allows():
    """No joint jumps from pose to pose, but joint 5 at full speed moves the tool by 1.3 mm/s."""
    q = np.array([-1.77644, 1.02725, 1.19345, -1.86983, 1.73120, -0.00454, -2.12928])
    limits = assembly.line_limits(CONFIGURATION, RIG)
    T = RIG.kinematics.forward(q)
    with pytest.raises(MoveRefused, match="joint 5 allows the tool only 1.3 mm/s"):
        plan_line(limits, q, pose(T[:3, :3], T[:3, 3] + [-0.000895, 0.001009, 0.000633]), 0.1)


def test_joints_that_turn_so_abruptly_that_their_curve_leaves_the_line_are_refused(monkeypatch):
    """On its own: where joints jump less, curves were at most 0.2 mm off."""
    monkeypatch.setattr(line_plan, "JUMP_RAD", 1.0)
    q = np.array([-2.0415, 0.7476, -1.5988, 1.9011, -1.9312, -0.0031, 0.0039])
    T = RIG.kinematics.forward(q)
    with pytest.raises(MoveRefused, match="too abruptly"):
        plan_line(
            assembly.line_limits(CONFIGURATION, RIG),
            q,
            pose(T[:3, :3], T[:3, 3] + [0.0017, -0.0052, 0.0007]),
            0.1,
        )


def test_the_ptp_controller_makes_no_lines():
    with pytest.raises(MoveRefused, match="real-time controller"):
        planner(PtpConfig).plan(1, MoveGoal(shifted(0.0, 0.05, 0.0), straight=True), HOME.q)


def test_velocities_have_defaults():
    assert planned("zero").velocity == SLOW
    assert planned(shifted(0.0, 0.05, 0.0), straight=True).velocity == 0.1


def refused(world, words):
    world.run(2 * DT)
    assert world.progress.state is MoveState.REFUSED
    assert words in world.progress.sentence


@pytest.mark.hazard(12)
def test_the_operator_must_have_switched_control_on():
    world = at_home()
    world.control_on = False
    refused(world.ask("aside"), "Control is off")
    assert world.state is State.HOME


@pytest.mark.hazard(12)
def test_a_program_waits_while_frames_come():
    world = at_home()
    world.ask("aside")
    world.run(2 * DT, shifted(0.1, 0.0, 0.0))
    assert world.progress.state is MoveState.REFUSED and "hand" in world.progress.sentence
    world.until("servo", 12.0, shifted(0.1, 0.0, 0.0))
    world.ask("aside").run(2 * DT, shifted(0.1, 0.0, 0.0))
    assert world.progress.state is MoveState.REFUSED and "the mode is servo" in world.progress.sentence


def test_a_line_planned_from_elsewhere_is_refused():
    world = at_home().ask(shifted(0.0, 0.05, 0.0), straight=True)
    line = world.move
    world.ask("aside")
    run(world)
    world.move = line.__class__(9, line.name, line.q, line.velocity, line.line)
    refused(world, "no longer where the line begins")


def test_a_released_enabling_device_brakes_a_line_and_control_off_and_on_brings_the_arm_home():
    world = World().at_home()
    world.control_on = True
    world.ask(shifted(0.1, 0.05, 0.05), straight=True).until_state(State.LINE).run(0.4)
    before = len(world.arm.goals)
    world.stop_count += 1
    world.run(0.5)
    assert world.state is State.STOPPED and world.progress.state is MoveState.ABORTED
    assert "The line ends: the enabling device was released." in world.progress.sentence
    speeds = np.linalg.norm(np.diff(world.arm.goals[before - 1 :], axis=0), axis=1) / DT
    assert len(speeds) > 4 and speeds[0] > 0.1 and np.all(np.diff(speeds) < 1e-3) and speeds[-1] < 0.01, "it brakes"
    goals, world.move = len(world.arm.goals), None
    world.ask(shifted(0.0, 0.0, 0.0), straight=True).run(1.0)
    assert len(world.arm.goals) == goals and world.progress.state is MoveState.REFUSED, "nothing moves"
    world.control_on = False
    world.run(0.1).control_on = True
    world.until("home", 5.0)


def test_a_line_whose_goals_wait_in_a_stall_continues_and_stays_on_the_line():
    world = at_home().ask(shifted(0.0, 0.05, 0.1), straight=True, velocity=0.3)
    world.run(0.3)
    for _ in range(3):
        world.now += 0.2
        world.run(0.1)
    goals = run(world)
    assert world.progress.state is MoveState.DONE
    way = np.array([0.0, 0.05, 0.1]) / np.hypot(0.05, 0.1)
    for q in goals:
        off = RIG.kinematics.forward(q)[:3, 3] - HOME.T_base_tool[:3, 3]
        assert np.linalg.norm(off - off @ way * way) < 1e-3


def test_the_collision_guard_refuses_a_motion_and_a_line_before_they_start():
    world = World(collision_guard=True).at_home()
    world.control_on = True
    block(world)
    for ask in (lambda: world.ask("aside"), lambda: world.ask(shifted(0.0, 0.05, 0.05), straight=True)):
        ask()
        refused(world, "3 mm from the post; it keeps 30 mm. Clear the way")
        assert world.state is State.HOME


def test_the_collision_guard_holds_a_line_which_then_ends():
    world = World(collision_guard=True).at_home()
    world.control_on = True
    # The way is free when the line starts; later something is in it.
    guard, start = world.loop._settings.guard, world.now
    free = guard.slowed
    guard.slowed = lambda q, v: free(q, v) if world.now < start + 0.5 else ([0.0] * 7, True)
    goals = run(world.ask(shifted(0.0, 0.03, 0.08), straight=True))
    assert world.progress.state is MoveState.ABORTED
    assert "collision guard" in world.progress.sentence
    assert 0.0 < world.progress.fraction < 0.9, "the way waits for the goals"
    within_limits(goals)


@pytest.mark.parametrize("before", [0.3, 0.15, 0.1])
def test_a_safety_stop_shortly_before_the_end_of_a_line_is_no_success(before):
    world = at_home().ask(shifted(0.0, 0.1, 0.15), straight=True, velocity=0.3)
    world.run(3 * DT + world.move.line.duration - before)
    world.arm.held = True
    run(world)
    assert world.progress.state is MoveState.ABORTED and world.progress.fraction > 0.5


def test_a_motion_that_is_done_is_done_as_a_whole():
    for goal in ({"target": "aside"}, {"target": shifted(0.0, 0.02, 0.03), "straight": True}):
        world = at_home().ask(**goal)
        run(world)
        assert (world.progress.state, world.progress.fraction, world.progress.left) == (MoveState.DONE, 1.0, 0.0)


def test_a_line_begins_where_the_arm_is_measured():
    plan = planned(shifted(0.0, 0.05, 0.1), straight=True).line
    start = plan.q_start + 1.9e-3 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
    goals, _ = drive(plan, start=start)
    np.testing.assert_array_equal(goals[0], start)
    within_limits(goals)
    np.testing.assert_array_equal(goals[-1], plan.q_goal)


@pytest.mark.ros
def test_of_two_motions_that_are_asked_for_at_once_one_is_refused(monkeypatch):
    from kuka_control.ros import moves

    class Handle:
        said = ""

        def get_goal(self):
            return moves.MoveGoalMessage(kind=moves.MoveGoalMessage.NAMED, name="aside")

        def set_accepted(self):
            self.said = "accepted"

        def set_rejected(self, result, sentence):
            self.said = sentence

    class Planner:
        def plan(self, number, goal, q):
            server._ask(server._guided(*server._begin(True)))  # while the path of the other is planned
            return ProgramMotion(number, "aside", q, 0.1)

    monkeypatch.setattr(moves.actionlib, "ActionServer", lambda *_, **__: SimpleNamespace(start=lambda: None))
    step = SimpleNamespace(mode=Mode.HOME, reason="", move=None)
    server, handle = moves.MoveServer(Planner(), lambda: (step, HOME.q), stops=True, unguided=None), Handle()
    server._goal(handle)
    assert server.move.guided and not server.guided, "the hand guides as soon as the control loop has begun that"
    assert "has not ended" in handle.said, "the refusal reaches the program"


@pytest.fixture
def asked_to_guide(monkeypatch):
    """A server of kuka/move, at home, that a service has asked for hand guiding; with the queue that it waits at."""
    from kuka_control.ros import moves

    monkeypatch.setattr(moves.actionlib, "ActionServer", lambda *_, **__: SimpleNamespace(start=lambda: None))
    step = SimpleNamespace(mode=Mode.HOME, reason="", move=None)
    server, verdict = moves.MoveServer(None, lambda: (step, HOME.q), stops=True, unguided=None), clock.SimpleQueue()
    server._ask(server._guided(*server._begin(True)), verdict=verdict)
    return server, verdict


def shown(server, number, state, sentence=""):
    progress = MoveProgress(number, state, sentence)
    server.show(SimpleNamespace(move=progress, transitions=(), reason=""), HOME.q)


@pytest.mark.ros
def test_the_end_of_a_hand_guiding_reaches_nobody_who_asks_at_that_moment(asked_to_guide):
    server, first = asked_to_guide
    second, lock = clock.SimpleQueue(), server._lock

    class Lock:
        """Lets another one ask as soon as the motion has ended."""

        def __enter__(self):
            lock.acquire()

        def __exit__(self, *_):
            lock.release()
            if server.move is None:
                server._ask(server._guided(2, HOME.q), verdict=second)

    server._lock = Lock()
    shown(server, 1, MoveState.ABORTED, "The robot refused it.")
    assert first.get_nowait() == "The robot refused it." and second.empty()
    shown(server, 2, MoveState.RUNNING)
    assert second.get_nowait() is None


@pytest.mark.ros
def test_who_waits_too_long_cancels_no_motion_of_another(asked_to_guide, monkeypatch):
    from kuka_control.ros import moves

    server, _ = asked_to_guide

    class Late(clock.SimpleQueue):
        def get(self, timeout):
            shown(server, server.move.number, MoveState.DONE)
            server._ask(ProgramMotion(9, "aside", HOME.q, 0.1))
            raise clock.Empty

    shown(server, 1, MoveState.DONE)
    monkeypatch.setattr(moves.clock, "SimpleQueue", Late)
    assert not server.guide(True).success
    assert server.move.number == 9 and not server.move.cancelled


@pytest.mark.ros
def test_a_goal_whose_planning_fails_is_rejected_by_a_sentence(monkeypatch):
    from kuka_control.ros import moves

    class Handle:
        rejected = None

        def get_goal(self):
            return moves.MoveGoalMessage(kind=moves.MoveGoalMessage.NAMED, name="aside")

        def set_rejected(self, result, sentence):
            self.rejected = sentence

    class Planner:
        def plan(self, number, goal, q):
            raise ZeroDivisionError("by nothing")

    monkeypatch.setattr(moves.actionlib, "ActionServer", lambda *_, **__: SimpleNamespace(start=lambda: None))
    step = SimpleNamespace(mode=Mode.HOME, reason="")
    server, handle = moves.MoveServer(Planner(), lambda: (step, HOME.q)), Handle()
    server._goal(handle)
    assert "cannot be planned" in handle.rejected and "by nothing" in handle.rejected and server.move is None
