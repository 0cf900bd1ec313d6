"""The states of a control loop and the one table of their transitions: for the trigger that a state's handler names,
the next state, the command to the arm, and the reason. A pair of state and trigger that has no row is an error.
docs/reference/control-loop.md is made from this table."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from common.modes import Mode
from kuka_control.numbers import EXIT_PATIENCE_S, NO_PROGRESS_S

_MOVES = "{because} The arm moves to {name} at {velocity:g} of the full joint speed."
_LEAVES = "{because} The arm leaves servo mode."
_FOLLOWS = "The arm follows the desired tool frame in servo mode."
_STOPPED = "{because} The arm stays where it is until control is switched off and on again."
_AT_POSE = "The arm is at the desired pose; it goes to the next one once that is farther than joints_thresh."


class Trait(Enum):
    """What holds in a state; a column of the table of states in docs/reference/control-loop.md."""

    MOVES = "a PTP motion runs"
    STREAMS = "goals are streamed"
    BRAKES = "keeps the stream that ended, and why it did"
    PROGRAM = "moves for a program"
    FOLLOWS = "goes to the desired tool frame"
    RESTS = "rests, and can begin to follow from here"
    FORGETS = "forgets the target"
    SCALES_HERE = "a new scaling factor counts from the present pose on"
    LATCHES = "waits after a fault until control is switched off and on again"


_IS = Trait


class State(Enum):
    """A state: the mode that is published in it, the reason, and its traits; an empty reason keeps the one before."""

    STARTING = Mode.STARTING, "The controller has started."
    HOMING = Mode.HOMING, _MOVES, _IS.MOVES, _IS.FORGETS
    IDENTIFYING = Mode.HOMING, "The arm is at home; a small motion of joint 7 shows its servo law."
    IDENTIFIED = Mode.HOMING, ""
    HOME = Mode.HOME, "The arm is at home.", _IS.RESTS
    PICK_UP = Mode.PICK_UP, _MOVES, _IS.MOVES, _IS.FOLLOWS, _IS.SCALES_HERE
    AT_POSE = Mode.PICK_UP, _AT_POSE, _IS.RESTS, _IS.SCALES_HERE
    SERVO = Mode.SERVO, _FOLLOWS, _IS.STREAMS, _IS.FOLLOWS, _IS.SCALES_HERE
    BRAKING = Mode.SERVO, "{because} The arm brakes.", _IS.STREAMS, _IS.BRAKES, _IS.SCALES_HERE
    SERVO_LEFT = Mode.PICK_UP, _LEAVES, _IS.RESTS, _IS.SCALES_HERE
    RETURN_PENDING = Mode.RETURNING, _LEAVES
    RETURNING = Mode.RETURNING, _MOVES, _IS.MOVES, _IS.FORGETS
    TO_GOAL = Mode.MOVING, _MOVES, _IS.MOVES, _IS.PROGRAM, _IS.FORGETS
    LINE = Mode.MOVING, "{because} The tool moves along a straight line.", _IS.STREAMS, _IS.PROGRAM, _IS.FORGETS
    LINE_BRAKING = Mode.MOVING, "{because} The arm brakes.", _IS.STREAMS, _IS.BRAKES, _IS.PROGRAM
    GUIDING = Mode.MOVING, "A hand may move the arm while it holds the enabling switch.", _IS.PROGRAM, _IS.FORGETS
    AT_GOAL = Mode.HOLDING, "{because} The arm stays until the next motion, a hand, or control off.", _IS.RESTS
    STOPPED = Mode.STOPPED, _STOPPED, _IS.FORGETS, _IS.LATCHES
    ZERO = Mode.ZERO, _MOVES, _IS.MOVES, _IS.FORGETS
    ENDED = Mode.STOPPED, "{because}"

    def __init__(self, mode: Mode, text: str, *traits: Trait) -> None:
        self.mode = mode
        self.text = text
        self.traits = frozenset(traits)


class Trigger(Enum):
    START = "at once"
    ARRIVED = "arrived"
    ARRIVED_UNIDENTIFIED = "arrived for the first time"
    ARRIVED_AFTER_HOLD = "arrived after something held the arm"
    EXIT = "exit_app"
    INFEASIBLE = "an infeasible position"
    EXIT_WHILE_HELD = f"exit_app while the arm is held for {EXIT_PATIENCE_S:g} s"
    CONTROL_OFF = "control off"
    CONTROL_WAS_OFF = "control off and on again at once"
    ENABLED_AGAIN = "control off and on again"
    TIME_OUT = "no new frame for time_out"
    FAR_TARGET = "control on and a new frame with some joint far off"
    NEAR_TARGET = "control on and a new frame with all joints near"
    JUMPED = "the frame jumped"
    JOINTS_JUMPED = "its joints are too far off to catch up"
    MOVED_ON = "the frame moved on meanwhile (stream not shaped)"
    AT_REST = "the goals are at rest"
    AT_REST_TO_RETURN = "the goals are at rest, and the arm is to go home"
    SERVO_ENDED = "servo mode has ended"
    LAW_IDENTIFIED = "test motion done"
    WRONG_LAW = "servo_law is lts but the robot has another law"
    LAG = "the arm does not follow"
    DISBELIEVED = "the measured joints cannot be true"
    REFUSED = "refused by the robot"
    STOPPED = "the robot has stopped the arm"
    STOP_ASKED = "the enabling device is released"
    CONTACT = "a joint torque has ended the motion"
    BLOCKED = "a body is in the way of the motion"
    EXIT_BLOCKED = "exit_app, and the arm stays: a body is in the way, it touched one, or its joints are not believed"
    GUARD_FAILED = "the collision guard failed"
    CONFLICT = "the frame has two publishers, or its chain or clock jumped"
    AT_REST_TO_STOP = "the goals are at rest, and the arm is to stay"
    MOVE = "a program asks for a PTP motion"
    LINE = "a program asks for a straight line"
    GUIDE = "a program asks for hand guiding"
    CANCELLED = "the program cancels"
    NO_PROGRESS = f"no progress for {NO_PROGRESS_S:g} s"


class Action(Enum):
    NONE = "nothing"
    PTP = "PTP motion"
    START_SERVO = "start servo mode"
    STOP_SERVO = "stop servo mode"
    GUIDE = "start hand guiding"
    END = "end"
    DECIDE = "what the next state decides, in the same cycle"


class IfBlocked(Enum):
    """What follows instead of a motion that a body is in the way of, and the trigger of that."""

    STOPS = "the arm stops", Trigger.BLOCKED
    EXITS = "the controller exits, and the arm stays", Trigger.EXIT_BLOCKED
    WAITS = "the arm waits, and looks again", None
    REFUSES = "the program's motion is refused", None

    def __init__(self, text: str, trigger: Trigger | None) -> None:
        self.text = text
        self.trigger = trigger


@dataclass(frozen=True)
class Transition:
    """One row."""

    sources: tuple[State, ...]
    trigger: Trigger
    target: State
    action: Action
    because: str = ""  # goes into the reason of the target; {because} in it is that of the transition before
    counted: str = ""  # the counter that counts it; besides, entering a state that latches is a fault
    at_rest: Trigger = Trigger.AT_REST  # of a transition to BRAKING: the trigger once the goals are at rest
    if_blocked: IfBlocked = IfBlocked.STOPS  # of one that begins a motion


_S = State
_T = Trigger
_A = Action
_B = IfBlocked
_TO_HOME = (_S.HOMING, _S.RETURNING)
_TO_REST = (*_TO_HOME, _S.PICK_UP, _S.TO_GOAL)
_AWAY = (_S.PICK_UP, _S.AT_POSE, _S.SERVO_LEFT)
_LEFT = (_S.AT_POSE, _S.SERVO_LEFT, _S.RETURN_PENDING, _S.AT_GOAL)
_BLOCKED = (_S.RETURN_PENDING, _S.AT_GOAL, *_AWAY)
_STREAMS = tuple(state for state in State if Trait.STREAMS in state.traits)
_RESTS = tuple(state for state in State if Trait.RESTS in state.traits)
_OTHERS = (_S.HOME, *_LEFT, _S.IDENTIFYING, _S.IDENTIFIED, *_STREAMS)
_JOINTS_FAR = "The desired tool frame did not jump, but asks for joints far from those before."
_MOVED_ON = "The desired tool frame moved on while the arm was on its way."
_LAG = "The arm does not follow, perhaps because of a safety stop: {detail}."
_HELD = "The arm cannot go to zero because its motion to {name} does not end."
_SILENCE = "No new desired tool frame came for {detail} s."
_PROGRAM = "A program moves the arm."
_DISBELIEVED = "The measured joints are not believed: {detail}."
_CONTACT = "The arm touched something on its way to {name}: {detail}."
_STOPPED_MOTION = "The robot stopped the motion to {name}: {detail}."
_STOPPED_ARM = "The robot stopped the arm: {detail}."
_REFUSED = "The robot's controller refused the motion to {name}: {detail}."

TRANSITIONS = (
    Transition((_S.STARTING,), _T.START, _S.HOMING, _A.PTP),
    Transition((_S.STARTING, _S.HOME, _S.PICK_UP, _S.STOPPED), _T.EXIT, _S.ZERO, _A.PTP, if_blocked=_B.EXITS),
    # The servo law is identified once, at the first home position.
    Transition((_S.HOMING,), _T.ARRIVED_UNIDENTIFIED, _S.IDENTIFYING, _A.START_SERVO),
    Transition((_S.IDENTIFYING,), _T.LAW_IDENTIFIED, _S.IDENTIFIED, _A.STOP_SERVO),
    Transition((_S.IDENTIFIED,), _T.WRONG_LAW, _S.ENDED, _A.END, "{detail}"),
    Transition((_S.IDENTIFIED,), _T.SERVO_ENDED, _S.HOME, _A.DECIDE),
    Transition((_S.HOMING,), _T.ARRIVED, _S.HOME, _A.DECIDE),
    Transition((_S.RETURNING,), _T.ARRIVED, _S.HOME, _A.DECIDE, counted="returns"),
    # Following the desired tool frame.
    Transition(_RESTS, _T.FAR_TARGET, _S.PICK_UP, _A.PTP, "{because}", "pickups", if_blocked=_B.WAITS),
    Transition((_S.HOME, _S.SERVO_LEFT, _S.AT_GOAL), _T.NEAR_TARGET, _S.SERVO, _A.START_SERVO),
    Transition((_S.PICK_UP,), _T.ARRIVED, _S.SERVO, _A.START_SERVO),
    Transition((_S.PICK_UP,), _T.ARRIVED, _S.AT_POSE, _A.NONE),
    # Every end of the stream of goals, but for faults, is a stop within their limits.
    Transition((_S.SERVO,), _T.JUMPED, _S.BRAKING, _A.DECIDE, "The desired tool frame jumped.", "jumps"),
    Transition((_S.SERVO,), _T.JOINTS_JUMPED, _S.BRAKING, _A.DECIDE, _JOINTS_FAR, "flips"),
    Transition((_S.SERVO,), _T.MOVED_ON, _S.BRAKING, _A.DECIDE, _MOVED_ON),
    Transition((_S.SERVO,), _T.CONTROL_OFF, _S.BRAKING, _A.DECIDE, "Control is off.", at_rest=_T.AT_REST_TO_RETURN),
    Transition(
        (_S.SERVO,), _T.CONTROL_WAS_OFF, _S.BRAKING, _A.DECIDE, "Control was off.", at_rest=_T.AT_REST_TO_RETURN
    ),
    Transition((_S.SERVO,), _T.TIME_OUT, _S.BRAKING, _A.DECIDE, _SILENCE, at_rest=_T.AT_REST_TO_RETURN),
    Transition((_S.SERVO,), _T.EXIT, _S.BRAKING, _A.DECIDE),
    Transition((_S.BRAKING,), _T.AT_REST, _S.SERVO_LEFT, _A.STOP_SERVO, "{because}"),
    Transition((_S.BRAKING,), _T.AT_REST_TO_RETURN, _S.RETURN_PENDING, _A.STOP_SERVO, "{because}"),
    # Motions for programs. The toolbox cannot stop a PTP motion; a straight line is a stream, which can stop.
    Transition((_S.HOME, _S.AT_GOAL), _T.MOVE, _S.TO_GOAL, _A.PTP, _PROGRAM, "moves", if_blocked=_B.REFUSES),
    Transition((_S.HOME, _S.AT_GOAL), _T.LINE, _S.LINE, _A.START_SERVO, _PROGRAM, "moves", if_blocked=_B.REFUSES),
    Transition((_S.HOME, _S.AT_GOAL), _T.GUIDE, _S.GUIDING, _A.GUIDE, _PROGRAM, "moves"),
    Transition((_S.TO_GOAL, _S.GUIDING), _T.ARRIVED, _S.AT_GOAL, _A.NONE, "The motion has ended."),
    Transition((_S.TO_GOAL, _S.GUIDING), _T.CANCELLED, _S.AT_GOAL, _A.NONE, "The program cancelled the motion."),
    Transition((_S.LINE,), _T.ARRIVED, _S.LINE_BRAKING, _A.DECIDE, "The line has ended."),
    Transition((_S.LINE,), _T.CANCELLED, _S.LINE_BRAKING, _A.DECIDE, "The program cancelled the line."),
    Transition((_S.LINE,), _T.NO_PROGRESS, _S.LINE_BRAKING, _A.DECIDE, "The line does not continue: {detail}."),
    Transition((_S.LINE,), _T.CONTROL_OFF, _S.LINE_BRAKING, _A.DECIDE, "Control is off."),
    Transition((_S.LINE,), _T.CONTROL_WAS_OFF, _S.LINE_BRAKING, _A.DECIDE, "Control was off."),
    Transition((_S.LINE,), _T.EXIT, _S.LINE_BRAKING, _A.DECIDE, "The controller is to exit."),
    Transition((_S.LINE_BRAKING,), _T.AT_REST, _S.AT_GOAL, _A.STOP_SERVO, "{because}"),
    Transition(
        (_S.LINE,), _T.STOP_ASKED, _S.LINE_BRAKING, _A.DECIDE, "The line ends: {detail}.", at_rest=_T.AT_REST_TO_STOP
    ),
    Transition((_S.LINE_BRAKING,), _T.AT_REST_TO_STOP, _S.STOPPED, _A.STOP_SERVO, "{because}"),
    # Back home, or to the zero position and the end.
    Transition((_S.RETURN_PENDING,), _T.SERVO_ENDED, _S.RETURNING, _A.PTP, "{because}"),
    Transition((*_AWAY, _S.AT_GOAL), _T.CONTROL_OFF, _S.RETURNING, _A.PTP, "Control is off."),
    Transition((*_AWAY, _S.AT_GOAL), _T.CONTROL_WAS_OFF, _S.RETURNING, _A.PTP, "Control was off."),
    Transition(_AWAY, _T.TIME_OUT, _S.RETURNING, _A.PTP, _SILENCE),
    Transition(_LEFT, _T.EXIT, _S.ZERO, _A.PTP, "{because}", if_blocked=_B.EXITS),
    Transition((_S.ZERO,), _T.ARRIVED, _S.ENDED, _A.END, "The controller has ended as it was asked to."),
    # Faults. None of them starts a motion.
    Transition((_S.SERVO,), _T.INFEASIBLE, _S.BRAKING, _A.DECIDE, "{detail}"),
    Transition(_RESTS, _T.INFEASIBLE, _S.ENDED, _A.END, "{detail}"),
    # The measured joints of an arm that does not follow may be wrong or frozen, so the arm is not sent there.
    Transition((_S.SERVO, _S.LINE, _S.LINE_BRAKING), _T.LAG, _S.STOPPED, _A.STOP_SERVO, _LAG),
    Transition((*_STREAMS, _S.IDENTIFYING), _T.DISBELIEVED, _S.STOPPED, _A.STOP_SERVO, _DISBELIEVED),
    Transition((*_TO_REST, *_RESTS), _T.DISBELIEVED, _S.STOPPED, _A.NONE, _DISBELIEVED),
    Transition(_TO_REST, _T.ARRIVED_AFTER_HOLD, _S.STOPPED, _A.NONE, "Something held the arm on its way to {name}."),
    Transition(_TO_REST, _T.REFUSED, _S.STOPPED, _A.NONE, _REFUSED),
    Transition((_S.GUIDING,), _T.REFUSED, _S.STOPPED, _A.NONE, "The robot refused the hand guiding: {detail}."),
    Transition(_TO_REST, _T.STOPPED, _S.STOPPED, _A.NONE, _STOPPED_MOTION),
    Transition((_S.IDENTIFYING, _S.GUIDING, *_STREAMS), _T.STOPPED, _S.STOPPED, _A.NONE, _STOPPED_ARM),
    Transition(_TO_REST, _T.CONTACT, _S.STOPPED, _A.NONE, _CONTACT),
    Transition(_OTHERS, _T.REFUSED, _S.STOPPED, _A.NONE, "The robot's controller has ended servo mode: {detail}."),
    Transition((_S.STARTING, _S.STOPPED, *_BLOCKED), _T.BLOCKED, _S.STOPPED, _A.NONE, "{detail}"),
    Transition((_S.STARTING, _S.HOME, _S.PICK_UP, _S.STOPPED, *_LEFT), _T.EXIT_BLOCKED, _S.ENDED, _A.END, "{detail}"),
    Transition((_S.SERVO,), _T.CONFLICT, _S.BRAKING, _A.DECIDE, "{detail}", at_rest=_T.AT_REST_TO_STOP),
    Transition((_S.SERVO, _S.LINE), _T.GUARD_FAILED, _S.BRAKING, _A.DECIDE, "{detail}", at_rest=_T.AT_REST_TO_STOP),
    Transition((_S.BRAKING,), _T.AT_REST_TO_STOP, _S.STOPPED, _A.STOP_SERVO, "{because}"),
    Transition((_S.STOPPED,), _T.ENABLED_AGAIN, _S.HOMING, _A.PTP, "Control was switched off and on again."),
    Transition((_S.ZERO,), _T.REFUSED, _S.ENDED, _A.END, _REFUSED),
    Transition((_S.ZERO,), _T.STOPPED, _S.ENDED, _A.END, _STOPPED_MOTION),
    Transition((_S.ZERO,), _T.CONTACT, _S.ENDED, _A.END, _CONTACT),
    Transition((*_TO_REST, _S.ZERO), _T.EXIT_WHILE_HELD, _S.ENDED, _A.END, _HELD),
)
"""All transitions of both control loops."""

PTP_STATES = frozenset(_S) - {*_STREAMS, _S.IDENTIFYING, _S.IDENTIFIED, _S.SERVO_LEFT, _S.RETURN_PENDING}
REAL_TIME_STATES = frozenset(_S) - {_S.AT_POSE}


def transitions_among(states: frozenset[State]) -> dict[tuple[State, Trigger], Transition]:
    """Returns the rows of the table whose states an algorithm has, by state and trigger."""
    return {
        (source, row.trigger): row
        for row in TRANSITIONS
        for source in row.sources
        if source in states and row.target in states
    }
