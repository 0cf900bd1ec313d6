"""The state machine of the control loops: its table, a walk along every transition, and laws in any order of events."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule
from loop_world import DT, HOME, Q_ASIDE, World, block, out_of_reach_and_back, rig, shifted

from common.modes import Mode
from common.poses import pose, translation
from kst import ReplyTimeout
from kuka_control.limits.line_plan import MoveRefused
from kuka_control.limits.motion_limits import LimitedGoal
from kuka_control.limits.moving_arm import GuardError
from kuka_control.loop.commands import End, Servo, StartGuiding, StartPtp, StartServo, StopServo, Wait
from kuka_control.loop.moves import MoveState, ProgramMotion
from kuka_control.loop.transitions import (
    PTP_STATES,
    REAL_TIME_STATES,
    TRANSITIONS,
    Action,
    IfBlocked,
    State,
    Trait,
    Trigger,
    transitions_among,
)
from kuka_control.model.config import PtpConfig, RealTimeConfig

STATES = {RealTimeConfig: REAL_TIME_STATES, PtpConfig: PTP_STATES}
INFEASIBLE = pose(HOME.T_base_tool[:3, :3], (-0.3, 0.3, 0.4))
FAR, FARTHER = shifted(0.1, 0.0, 0.0), shifted(0.1, 0.1, 0.0)
COMMANDS = {
    Action.NONE: Wait,
    Action.GUIDE: StartGuiding,
    Action.PTP: StartPtp,
    Action.START_SERVO: StartServo,
    Action.STOP_SERVO: StopServo,
    Action.END: End,
    Action.DECIDE: object,
}
both = pytest.mark.parametrize("schema", [RealTimeConfig, PtpConfig])


@pytest.mark.ros
def test_the_message_has_the_modes():
    from rig_msgs.msg import KukaStatus

    constants = {name: value for name, value in vars(KukaStatus).items() if name.isupper() and isinstance(value, str)}
    assert constants == {mode.name: mode.value for mode in Mode}


@both
def test_every_state_reaches_the_end_and_is_reached_and_a_trigger_is_clear(schema):
    states, edges = STATES[schema], {}
    rows = transitions_among(states)
    assert len(rows) == sum(row.target in states for row in TRANSITIONS for s in row.sources if s in states)
    for (source, _), row in rows.items():
        edges.setdefault(source, set()).add(row.target)
    assert reachable(State.STARTING, edges) == states
    assert all(State.ENDED in reachable(state, edges) for state in states)
    assert State.ENDED not in edges


def reachable(start, edges):
    found, new = set(), {start}
    while new:
        found |= new
        new = {target for state in new for target in edges.get(state, ())} - found
    return found


TRAITS = {
    Trait.MOVES: "HOMING PICK_UP RETURNING TO_GOAL ZERO",
    Trait.STREAMS: "SERVO BRAKING LINE LINE_BRAKING",
    Trait.BRAKES: "BRAKING LINE_BRAKING",
    Trait.PROGRAM: "TO_GOAL LINE LINE_BRAKING GUIDING",
    Trait.FOLLOWS: "PICK_UP SERVO",
    Trait.RESTS: "HOME AT_POSE SERVO_LEFT AT_GOAL",
    Trait.FORGETS: "HOMING RETURNING TO_GOAL LINE GUIDING STOPPED ZERO",
    Trait.SCALES_HERE: "PICK_UP AT_POSE SERVO BRAKING SERVO_LEFT",
    Trait.LATCHES: "STOPPED",
}


@pytest.mark.parametrize("trait", Trait, ids=lambda trait: trait.name.lower())
def test_a_trait_holds_in_its_states_only(trait):
    """Not each of them shows in a motion: a target that is not forgotten, for instance, only in the status."""
    assert " ".join(state.name for state in State if trait in state.traits) == TRAITS[trait]


def test_after_the_arm_has_braked_it_goes_home_or_stays_only_for_what_asks_for_that():
    after = {row.trigger: row.at_rest for row in TRANSITIONS if row.target is State.BRAKING}
    assert {t for t, rest in after.items() if rest is Trigger.AT_REST_TO_RETURN} == {
        *(Trigger.CONTROL_OFF, Trigger.CONTROL_WAS_OFF, Trigger.TIME_OUT)
    }
    assert {t for t, rest in after.items() if rest is Trigger.AT_REST_TO_STOP} == {
        *(Trigger.CONFLICT, Trigger.GUARD_FAILED)
    }


def test_a_body_in_the_way_ends_the_controller_on_exit_stops_the_arm_and_keeps_it_from_what_it_need_not_do():
    found = {}
    for row in TRANSITIONS:
        if row.action is Action.PTP or row.trigger is Trigger.LINE:
            found.setdefault(row.if_blocked, set()).add(row.target.name)
    assert found == {
        IfBlocked.STOPS: {"HOMING", "RETURNING"},
        IfBlocked.EXITS: {"ZERO"},
        IfBlocked.WAITS: {"PICK_UP"},
        IfBlocked.REFUSES: {"TO_GOAL", "LINE"},
    }
    for (source, _), row in transitions_among(frozenset(State)).items():
        if row.action is Action.PTP and row.if_blocked.trigger is not None:
            assert (source, row.if_blocked.trigger) in transitions_among(frozenset(State))


def enable(world):
    world.control_on = True


def disable(world):
    world.control_on = False


def enable_again(world):
    world.control_on = False
    world.control_on = True


def leave(world):
    world.exit_requested = True


def hold(world):
    world.arm.held = True


def measure_wrongly(world):
    world.arm.shift = 0.1


def hold_for_a_while(world):
    hold(world)
    world.run(2.5)
    world.arm.held = False


def leave_while_held(world):
    hold(world)
    leave(world)


def refuse(what):
    return lambda world: setattr(world.arm, "refuse", what)


def touch(world):
    """Something pushes on joint 1 of an arm on its way."""
    world.run(0.1)
    world.arm.touches = (np.array([-31.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),)


def leave_while_blocked(world):
    block(world)
    leave(world)


def block_and_disable(world):
    block(world)
    disable(world)


def block_and_enable_again(world):
    block(world)
    enable_again(world)


def fail(world):
    def slowed(q, v):
        raise GuardError("The collision guard failed: it was asked about joints.")

    world.loop._settings.guard.slowed = slowed


def fail_while_moving(world):
    move(world)
    fail(world)


def nothing(world):
    pass


def wait(world):
    world.run(0.21)


def move(world):
    """The hand moves, so that the goals have a speed at what comes next."""
    start = world.now
    world.run(0.15, lambda _: shifted(0.1, 0.3 * (world.now - start), 0.0))


def stop_while_moving(world):
    move(world)
    disable(world)


def leave_while_moving(world):
    move(world)
    leave(world)


def ask_for(target, **goal):
    def ask(world):
        enable(world)
        world.ask(target, **goal)

    return ask


def cancel(world):
    world.cancel()


def hold_then_cancel(world):
    world.run(0.4)
    hold(world)
    world.run(0.316)
    cancel(world)


def hold_the_goals(world):
    """The limits let no goal go on, as where a guard stops the tool."""
    world.run(0.4)
    world.loop._limits.step = lambda *_: LimitedGoal(world.loop.goal, np.zeros(7), "workspace")


def after_a_while(event):
    def later(world):
        world.run(0.4)
        event(world)

    return later


def cancel_what_can_stop(world):
    world.arm.abilities = frozenset({"stop"})
    cancel(world)


def guide(world):
    world.control_on = True
    world.number += 1
    world.move = ProgramMotion(world.number, "there", world.arm.q, 0.0, guided=True)


def let_go(world):
    world.arm.goal = world.arm.q


def release(world):
    world.stop_count += 1


LINE = shifted(0.1, 0.0, 0.05)

# How a state is reached: the state before, what happens there, and the desired tool frame from then on.
PATHS = {
    State.HOMING: (State.STARTING, nothing, None),
    State.IDENTIFYING: (State.HOMING, nothing, None),
    State.IDENTIFIED: (State.IDENTIFYING, nothing, None),
    State.HOME: (State.HOMING, nothing, None),
    State.PICK_UP: (State.HOME, enable, FAR),
    State.AT_POSE: (State.PICK_UP, nothing, FAR),
    State.SERVO: (State.PICK_UP, nothing, FAR),
    State.BRAKING: (State.SERVO, stop_while_moving, None),
    State.SERVO_LEFT: (State.SERVO, lambda world: world.run(0.1, FAR), FARTHER),
    State.RETURN_PENDING: (State.SERVO, disable, None),
    State.RETURNING: (State.PICK_UP, disable, None),
    State.STOPPED: (State.HOMING, refuse("end"), None),
    State.ZERO: (State.HOME, leave, None),
    State.TO_GOAL: (State.HOME, ask_for("aside"), None),
    State.AT_GOAL: (State.TO_GOAL, nothing, None),
    State.GUIDING: (State.HOME, guide, None),
    State.LINE: (State.HOME, ask_for(LINE, straight=True), None),
    State.LINE_BRAKING: (State.LINE, after_a_while(cancel), None),
}
# What makes a trigger fire in a state, and the desired tool frame from then on.
EVENTS = {
    Trigger.ARRIVED: (nothing, FAR),
    Trigger.ARRIVED_AFTER_HOLD: (hold_for_a_while, FAR),
    Trigger.EXIT: (leave, None),
    Trigger.EXIT_WHILE_HELD: (leave_while_held, None),
    Trigger.INFEASIBLE: (enable, INFEASIBLE),
    Trigger.CONTROL_OFF: (disable, FAR),
    Trigger.CONTROL_WAS_OFF: (enable_again, FAR),
    Trigger.ENABLED_AGAIN: (enable_again, None),
    Trigger.TIME_OUT: (wait, None),
    Trigger.FAR_TARGET: (enable, FARTHER),
    Trigger.NEAR_TARGET: (enable, FAR),
    Trigger.JUMPED: (lambda world: world.run(0.1, FAR), FARTHER),
    Trigger.JOINTS_JUMPED: (nothing, out_of_reach_and_back(turn=-1.2)),
    Trigger.LAG: (hold, lambda t: shifted(0.1, 0.05 * t, 0.0)),
    Trigger.DISBELIEVED: (measure_wrongly, None),
    Trigger.STOPPED: (lambda world: setattr(world.arm, "stopped", "a safety stop, STOP1"), None),
    Trigger.STOP_ASKED: (after_a_while(release), None),
    Trigger.CONTACT: (touch, None),
    Trigger.BLOCKED: (block_and_disable, None),
    Trigger.EXIT_BLOCKED: (leave_while_blocked, None),
    Trigger.GUARD_FAILED: (fail_while_moving, None),
    Trigger.CONFLICT: (lambda world: setattr(world, "conflict", "Two nodes publish it."), FAR),
    Trigger.MOVE: (ask_for("zero"), None),
    Trigger.LINE: (ask_for(LINE, straight=True), None),
    Trigger.GUIDE: (guide, None),
    Trigger.CANCELLED: (after_a_while(cancel), None),
    Trigger.NO_PROGRESS: (hold_the_goals, None),
}
# Where they differ.
NEAR_HOME = shifted(0.003, 0.0, 0.0)


def aside(x):
    """The tool frame of the position "aside", shifted along the base's x axis."""
    return translation(x, 0.0, 0.0) @ rig(RealTimeConfig)[1].kinematics.forward(Q_ASIDE)


EVENTS_IN = {
    (State.HOMING, Trigger.ARRIVED): (leave, None),
    (State.HOME, Trigger.NEAR_TARGET): (enable, NEAR_HOME),
    **{
        (state, Trigger.REFUSED): (refuse("end"), None)
        for state in (State.HOMING, State.PICK_UP, State.RETURNING, State.TO_GOAL)
    },
    (State.ZERO, Trigger.REFUSED): (refuse("end"), None),
    **{(state, Trigger.REFUSED): (refuse("read"), None) for state in (State.HOME, State.AT_POSE, State.AT_GOAL)},
    **{(state, Trigger.REFUSED): (refuse("servo"), FAR) for state in (State.IDENTIFYING, State.SERVO, State.BRAKING)},
    **{(state, Trigger.REFUSED): (refuse("servo"), None) for state in (State.LINE, State.LINE_BRAKING)},
    **{(state, Trigger.CANCELLED): (cancel_what_can_stop, None) for state in (State.TO_GOAL, State.GUIDING)},
    (State.GUIDING, Trigger.ARRIVED): (let_go, None),
    (State.GUIDING, Trigger.REFUSED): (refuse("end"), None),
    (State.AT_GOAL, Trigger.NEAR_TARGET): (enable, aside(0.003)),
    (State.AT_GOAL, Trigger.FAR_TARGET): (enable, aside(0.1)),
    (State.LINE, Trigger.LAG): (after_a_while(hold), None),
    (State.LINE_BRAKING, Trigger.LAG): (nothing, None),
    (State.LINE, Trigger.GUARD_FAILED): (after_a_while(fail), None),
    (State.SERVO, Trigger.MOVED_ON): (nothing, shifted(0.0, 0.0, 0.15)),
    (State.STOPPED, Trigger.BLOCKED): (block_and_enable_again, None),
    (State.SERVO_LEFT, Trigger.INFEASIBLE): (nothing, None),
}
PATH_FOR = {
    (State.SERVO_LEFT, Trigger.INFEASIBLE): (State.SERVO, move, INFEASIBLE),
    (State.BRAKING, Trigger.AT_REST): (State.SERVO, leave_while_moving, None),
    (State.LINE_BRAKING, Trigger.LAG): (State.LINE, hold_then_cancel, None),
    (State.BRAKING, Trigger.AT_REST_TO_STOP): (State.SERVO, fail_while_moving, None),
    (State.LINE_BRAKING, Trigger.AT_REST_TO_STOP): (State.LINE, after_a_while(release), None),
}
"""How a state is reached for one trigger."""
BEFORE = {
    **{(s, Trigger.REFUSED): "stop_servo" for s in (State.IDENTIFIED, State.SERVO_LEFT, State.RETURN_PENDING)},
}
"""What the arm refuses on the way into a state."""
GUARDED = {"collision_guard": True}
CHANGES = {
    Trigger.WRONG_LAW: {"servo_law": "lts"},
    Trigger.MOVED_ON: {"shaping": "none"},
    **dict.fromkeys((Trigger.BLOCKED, Trigger.EXIT_BLOCKED, Trigger.GUARD_FAILED, Trigger.AT_REST_TO_STOP), GUARDED),
}
"""Parameters that a trigger needs."""


def reach(world, state, refused=None, path=None):
    if state is not State.STARTING:
        before, event, tool = path or PATHS[state]
        reach(world, before)
        event(world)
        world.arm.refuse = refused or world.arm.refuse
        world.until_state(state, tool)
        world.arm.refuse = None


@pytest.mark.parametrize(
    "schema, source, trigger",
    [(schema, *pair) for schema, states in STATES.items() for pair in transitions_among(states)],
    ids=lambda part: part.name.lower() if isinstance(part, (State, Trigger)) else part.__name__,
)
def test_every_transition_is_taken(schema, source, trigger):
    world = World(schema, **CHANGES.get(trigger, {}))
    if trigger is Trigger.JOINTS_JUMPED:
        world.following()
    else:
        reach(world, source, BEFORE.get((source, trigger)), PATH_FOR.get((source, trigger)))
    assert world.state is source
    event, tool = EVENTS_IN.get((source, trigger)) or EVENTS.get(trigger, (nothing, None))
    event(world)
    row = world.table[source, trigger]
    start = world.now
    while (source, trigger) not in world.taken:
        world.run(3 * DT if callable(tool) else DT, tool(world.now - start) if callable(tool) else tool)
        assert world.now < start + 12.0, world.steps[-1].reason
    step = next(step for step in world.steps if (source, trigger) in step.transitions)
    assert isinstance(step.command, COMMANDS[row.action])
    assert step.mode == world.table[step.transitions[-1]].target.mode


class AnyOrder(RuleBasedStateMachine):
    """Laws that hold in whatever order the events come. The fake arm asserts that a command comes in its mode only."""

    @initialize(
        schema=st.sampled_from([RealTimeConfig, RealTimeConfig, PtpConfig]),
        begin=st.sampled_from([State.SERVO, State.SERVO, State.PICK_UP, State.HOME, State.STARTING]),
        speed=st.sampled_from([0.3, 1.0]),
    )
    def start(self, schema, begin, speed):
        self.world = World(schema)
        self.stopped_under = None
        self.last_goal = None
        self.barred = set()  # the streams of frames that ran while a program moved the arm
        self.tool = None if begin is State.STARTING else FAR
        reach(self.world, begin if begin in STATES[schema] else State.AT_POSE)
        self.world.arm.speed = speed

    @rule()
    def switch_off(self):
        disable(self.world)
        self.live(0.1)

    @rule()
    def switch_on(self):
        enable(self.world)
        self.live(0.1)

    @rule()
    def switch_off_and_on_at_once(self):
        enable_again(self.world)

    @rule(shift=st.tuples(*[st.sampled_from([0.0, 0.003, 0.1, -0.1])] * 3), skew=st.sampled_from([0.0, 0.0, -1.0]))
    def show(self, shift, skew):
        self.tool, self.world.skew = shifted(*shift), skew

    @rule(tool=st.sampled_from([None, shifted(0.0, 0.0, 0.3), INFEASIBLE]))
    def show_nothing_that_can_be_followed(self, tool):
        self.tool, self.world.skew = tool, 0.0

    @rule(held=st.booleans())
    def safety_stop(self, held):
        self.world.arm.held = held

    @rule(what=st.sampled_from(["start", "end", "start_servo", "servo", "stop_servo"]))
    def refuse_one(self, what):
        self.world.arm.refuse = what
        self.live(0.5)
        self.world.arm.refuse = None

    @rule()
    def miss_an_answer(self):
        self.world.arm.fail = ReplyTimeout("late")
        self.live(DT)
        self.world.arm.fail = None
        self.live(DT)

    @rule(
        goal=st.sampled_from([("aside", {}), ("home", {}), (LINE, {}), (LINE, {"straight": True})]),
        hidden=st.sampled_from([True, True, False]),
        seconds=st.sampled_from([0.1, 0.5, 3.0]),
    )
    def ask(self, goal, hidden, seconds):
        """A program asks, mostly when no hand is there, and not while its motion runs."""
        if hidden:
            self.tool = None
            self.live(0.4)
        if self.world.steps and (self.world.progress is None or self.world.progress.state is not MoveState.RUNNING):
            with contextlib.suppress(MoveRefused):
                self.world.ask(goal[0], **goal[1])
        self.live(seconds)

    @rule()
    def cancel(self):
        self.world.cancel()

    @rule()
    def leave(self):
        leave(self.world)

    @rule(seconds=st.sampled_from([DT, 0.1, 0.3, 2.5]))
    def live(self, seconds):
        world = self.world
        for _ in range(round(seconds / DT)):
            if world.state is State.ENDED:
                break
            world.run(DT, self.tool)
            self.check(world.steps[-1])

    def check(self, step):
        world, command = self.world, step.command
        moves = isinstance(command, (StartPtp, StartServo, Servo))
        if isinstance(command, StartPtp):
            away = min(float(np.max(np.abs(command.q - q))) for q in (HOME.q, np.zeros(7)))
            assert world.control_on or away == 0.0, "with control off the arm moves to home or zero only"
        elif moves:
            why = "with control off the arm only brakes, and its servo law is identified"
            assert world.control_on or step.mode == Mode.HOMING or Trait.BRAKES in world.state.traits, why
        by_program = Trait.PROGRAM in world.state.traits
        if by_program:
            assert step.move.state is MoveState.RUNNING
            if world.loop._stream.runs:
                self.barred.add(world.loop._stream.number)
        elif world.state in (State.PICK_UP, State.SERVO):
            assert world.loop._stream.number not in self.barred, "a hand waits for the end of a program's motion"
        if step.move is not None:
            assert (step.move.state is MoveState.RUNNING) == by_program
            assert step.move.state in (MoveState.RUNNING, MoveState.DONE) or step.move.sentence
        leaving = world.exit_requested or (step.mode in (Mode.ZERO, Mode.STOPPED) and isinstance(command, StartPtp))
        if world.state is State.STOPPED:
            if self.stopped_under is None:
                self.stopped_under = world.enable_count
            assert not moves, "no motion after a fault"
        elif self.stopped_under is not None:
            assert leaving or world.enable_count > self.stopped_under, "a fault holds until control is enabled again"
            self.stopped_under = None
        if isinstance(command, Servo):
            assert np.all(np.abs(command.q) <= world.rig.model.upper + 1e-9)
            if self.last_goal is not None:
                assert np.all(np.abs(command.q - self.last_goal) <= 0.9 * world.rig.model.max_speed * DT + 1e-9)
        self.last_goal = command.q if isinstance(command, Servo) else None

    def teardown(self):
        """Every state reaches the end, also with an arm that is held."""
        if hasattr(self, "world"):
            leave(self.world)
            self.live(30.0)
            assert self.world.state is State.ENDED


AnyOrder.TestCase.settings = settings(max_examples=25, stateful_step_count=12)
TestAnyOrder = AnyOrder.TestCase
