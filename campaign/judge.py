"""Judges what the arm did after a fault: the reaction, its time, speeds and accelerations, what was said, who died.

Pure: the evidence comes in, the findings go out. Times are monotonic seconds, of the arm and of the messages alike.

Times and the stream's own limits are judged in virtual time alone, where they are exact and no other program takes the
processor. Of a rig of real processes a pause of the machine may change each of them, by any amount; an allowance for
that would be one for the rig's faults, too. So there the order of what came, limits that the drives keep by themselves,
messages and deaths are judged, and the reaction time is only told.

The reactions, as the arm shows them from the fault until the operator acts:

- H: the arm decelerates within its limits and stays until the fault has ended.
- D: the controller leaves servo mode and does not come back by itself; the arm stays where it is, or goes home by a
  planned motion: it does not turn back on its way, and stands at the end.
- S: servo mode is left by its command.
- L: the mode is `stopped` and the arm stays, until the operator acts.
- R: the input is refused with its reason, and moves nothing."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace

import numpy as np

from common.modes import TO_DESIRED_TOOL

FULL_SPEED = np.radians([98, 98, 100, 130, 140, 180, 180])
"""Joint speeds of the 7 R800 [rad/s]."""
STEP_S = 1e-3
DRIVES = 17.2  # what the drives of joint 1 do by themselves [rad/s^2]
WINDOW_STEPS = 20  # accelerations are means over so many steps
SUSTAINED_STEPS = 80  # sustained ones over so many: a late goal makes the drives hurry for less
REST = 0.01  # below this speed of its fastest joint the arm rests [rad/s]: the law of joint servo creeps for seconds
RESTS_S = 0.12  # an arm that follows a swaying hand is at rest for less where it turns back [s]
MOVED_S = 1.0  # an arm that holds has moved at most so long before the fault [s]
STAYS = 5e-3  # and it stays if no joint moves farther than this [rad]
MOVED_BY_INPUT = 2e-3  # what a refused input may move a joint [rad]
LEAVES_S = 1.0  # an arm that leaves a hand has come to rest after this time, and then goes home if it does [s]
LATCHES_S = 0.5  # an arm whose controller is latched has come to rest after this time [s]
SEEN_S = 0.5  # an arm that was seen for less after it came to rest is not judged: nothing is known of it [s]
TURNS_BACK = 0.03  # a planned motion turns no joint back by more; a controller that starts tries its servo mode [rad]
STANDS = 0.05  # at the end no joint is faster than this [rad/s]
AT_THE_END_S = 0.25  # what was seen no longer before it than this [s]
WATCHED_S = 2.0  # the arm was last heard at most so long before the end [s]


@dataclass(frozen=True)
class Limits:
    """What the arm may do after a fault."""

    joint_speed: float = 0.95  # fraction of the full joint speeds; the drives overshoot the stream's 0.9 a little
    joint_acceleration: float = 12.0  # of the slowest joint [rad/s^2], in proportion for the faster ones
    tool_speed: float = 0.71  # [m/s]; the drives exceed the stream's 0.65 by 9 % at most
    sustained_acceleration: float = 14.5
    """As `joint_acceleration`, over SUSTAINED_STEPS. It sees what the drives' own limit hides: goals within 12 rad/s^2,
    on time or late, make the arm reach 13.9 behind a hand that dashes to and fro, goals of twice as much over 15."""

    @classmethod
    def of_the_drives(cls) -> Limits:
        """Returns the limits of an arm that its own controller brakes: those of its drives."""
        return cls(joint_acceleration=DRIVES)

    def on_a_busy_machine(self) -> Limits:
        """Returns those that hold there, too: where goals come late, the drives brake and hurry by themselves."""
        return replace(self, joint_acceleration=DRIVES)


@dataclass(frozen=True)
class Expected:
    """What the catalogue expects of a row."""

    reactions: str  # of H, D, S, L and R
    within: float  # from the fault to the reaction [s]
    named_by: str = ""  # regular expression of a message that names the fault; empty: none is asked for
    operator: bool = False  # whether only the operator brings the rig back
    still: bool = False  # whether the arm must not move at all, as after a refused input at home
    limits: Limits = field(default_factory=Limits)


@dataclass
class Evidence:
    """What was seen. `steps`: rows of time [s], joints [rad], their speeds [rad/s], shape (n, 16), last the tool's
    speed [m/s]; the arm stood still in between. `fault`, `mended`, `operator`, `end`: when the fault began and ended,
    when the operator acted, and when the watch ended. `heard`: when the arm last answered, as without steps it stands,
    or nobody looks. `statuses`: mode of the controller and whether control was on; `entered`: each mode that it
    entered. `failed`: what the row found wrong. `exact`: whether the times are virtual."""

    steps: np.ndarray
    fault: float
    end: float
    heard: float
    mended: float | None = None
    operator: float | None = None
    said: list[tuple[float, str, str]] = field(default_factory=list)
    statuses: list[tuple[float, str, bool]] = field(default_factory=list)
    entered: list[tuple[float, str]] = field(default_factory=list)
    events: list[tuple[float, str]] = field(default_factory=list)
    died: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    exact: bool = True


@dataclass
class Verdict:
    """What came of a row: "passed" or "failed"."""

    result: str
    faults: list[str]
    reaction_s: float | None = None
    joint_speed: float = 0.0  # fraction of full speed
    joint_acceleration: float = 0.0  # of the slowest joint's, in proportion for the others [rad/s^2]
    sustained_acceleration: float = 0.0  # likewise, over a longer time
    tool_speed: float = 0.0  # [m/s]
    named: str = ""  # the message that named the fault


def judge(expected: Expected, seen: Evidence) -> Verdict:
    """Returns the verdict on a row."""
    verdict = Verdict("passed", [])
    limits = expected.limits if seen.exact else expected.limits.on_a_busy_machine()
    after = seen.steps[seen.steps[:, 0] >= seen.fault] if len(seen.steps) else np.zeros((0, 16))
    if len(after):
        verdict.joint_speed = float(np.max(np.abs(after[:, 8:15]) / FULL_SPEED))
        verdict.tool_speed = float(np.max(after[:, 15]))
        verdict.joint_acceleration = _acceleration(seen, WINDOW_STEPS)
        verdict.sustained_acceleration = _acceleration(seen, SUSTAINED_STEPS)
    for what, value, limit in (
        ("largest joint speed as a fraction", verdict.joint_speed, limits.joint_speed),
        ("largest joint acceleration [rad/s^2]", verdict.joint_acceleration, limits.joint_acceleration),
        (
            f"acceleration over {1e3 * SUSTAINED_STEPS * STEP_S:.0f} ms [rad/s^2]",
            verdict.sustained_acceleration,
            limits.sustained_acceleration,
        ),
        ("largest tool speed [m/s]", verdict.tool_speed, limits.tool_speed),
    ):
        if value > limit:
            verdict.faults.append(f"{what} {value:.3f} is above {limit:g}")
    for reaction in expected.reactions:
        when, fault = _REACTIONS[reaction](expected, seen, after)
        if fault:
            verdict.faults.append(f"{reaction}: {fault}")
        elif when is not None:
            verdict.reaction_s = max(verdict.reaction_s or 0.0, when - seen.fault)
            if seen.exact and when - seen.fault > expected.within:
                verdict.faults.append(
                    f"{reaction}: only after {when - seen.fault:.2f} s, expected within {expected.within:g} s"
                )
    moved = _moved(after, seen)
    if expected.still and moved > MOVED_BY_INPUT:
        verdict.faults.append(f"the arm moved by {moved:.4f} rad")
    if expected.named_by:
        verdict.named = next((f"{who}: {text}" for _, who, text in _naming(expected, seen)), "")
        if not verdict.named:
            verdict.faults.append(f"no message named it (/{expected.named_by}/)")
    if expected.operator:
        until = seen.operator if seen.operator is not None else seen.end
        by_itself = [mode for when, mode, _ in seen.statuses if seen.fault + expected.within < when < until]
        if set(by_itself) & set(TO_DESIRED_TOOL):
            verdict.faults.append("it followed again without the operator")
    if seen.end - seen.heard > WATCHED_S:
        verdict.faults.append(f"the arm was not seen for the last {seen.end - seen.heard:.1f} s")
    verdict.faults += [f"died: {name}" for name in seen.died]
    verdict.faults += seen.failed
    verdict.result = "failed" if verdict.faults else "passed"
    return verdict


def _acceleration(seen: Evidence, n: int) -> float:
    """Returns the largest mean acceleration over n steps [rad/s^2], of joint 1 or in proportion to it."""
    steps = seen.steps[seen.steps[:, 0] >= seen.fault - n * STEP_S]
    if len(steps) <= n:
        return 0.0
    took = steps[n:, 0] - steps[:-n, 0]
    whole = took < (n + 0.5 * WINDOW_STEPS) * STEP_S  # no rest and no pause within the window
    change = np.abs(steps[n:, 8:15] - steps[:-n, 8:15]) / took[:, None]
    return float(np.max((change / (FULL_SPEED / FULL_SPEED[0]))[whole], initial=0.0))


def _moved(after: np.ndarray, seen: Evidence) -> float:
    q = after[after[:, 0] < _until(seen), 1:8]
    return float(np.max(np.abs(q - q[0]))) if len(q) else 0.0


def _until(seen: Evidence) -> float:
    return seen.operator if seen.operator is not None else seen.end


def _rest(after: np.ndarray, until: float) -> float | None:
    """Returns since when the arm rests, up to the time `until`; None if it does not rest then."""
    before = after[after[:, 0] < until]
    moving = np.flatnonzero(np.max(np.abs(before[:, 8:15]), axis=1, initial=0.0) > REST)
    if not len(moving):
        return float(before[0, 0]) if len(before) else 0.0
    last = before[moving[-1], 0]
    return float(last) if until - last > RESTS_S else None


def _hold(expected: Expected, seen: Evidence, after: np.ndarray) -> tuple[float | None, str]:
    until = min(filter(None, (seen.mended, seen.operator, seen.end)))
    if until <= seen.fault:
        return None, "the fault ended before a hold could be seen"
    around = seen.steps[(seen.steps[:, 0] > seen.fault - MOVED_S) & (seen.steps[:, 0] < until)]
    if not np.any(np.abs(around[:, 8:15]) > REST):
        return None, "the arm did not move before it held"
    rests = _rest(after, until)
    if rests is None:
        return None, "the arm did not come to rest before the fault ended"
    return max(rests, seen.fault), ""


def _disengage(expected: Expected, seen: Evidence, after: np.ndarray) -> tuple[float | None, str]:
    later = [(when, mode) for when, mode, _ in seen.statuses if seen.fault <= when < _until(seen)]
    if not any(mode in TO_DESIRED_TOOL for when, mode, _ in seen.statuses if when <= seen.fault):
        return None, "the arm did not follow before the fault"
    out = next((when for when, mode in later if mode not in TO_DESIRED_TOOL), None)
    if out is None:
        return None, "the controller never left servo mode"
    if any(mode in TO_DESIRED_TOOL for when, mode in later if when > out):
        return None, "the arm followed again without the operator"
    # So far the controller's word; the arm's own is where it went, and the hand goes on to sway.
    if short := _too_short(seen, out + LEAVES_S, "it had left"):
        return None, short
    left = after[(after[:, 0] > out + LEAVES_S) & (after[:, 0] < _until(seen))]
    back = _turned_back(left[:, 1:8])
    if back > TURNS_BACK:
        return None, f"the arm turned back by {back:.3f} rad after the controller had left servo mode"
    if np.any(np.abs(left[left[:, 0] > _until(seen) - AT_THE_END_S, 8:15][-1:]) > STANDS):
        return None, "the arm still moved at the end"
    return out, ""


def _too_short(seen: Evidence, rests: float, after: str) -> str:
    """Returns what is wrong where an arm that `rests` from a time on [s] was hardly watched; a pause may do so, too."""
    watched = _until(seen) - rests
    if watched >= SEEN_S or not seen.exact:
        return ""
    return f"the arm was watched for {max(watched, 0.0):.1f} s only after {after}, too short to judge"


def _turned_back(q: np.ndarray) -> float:
    """Returns by how much a joint went back on the way it came, at most, with q of shape (n, 7) [rad]."""
    if not len(q):
        return 0.0
    down, up = np.maximum.accumulate(q) - q, q - np.minimum.accumulate(q)
    return float(np.max(np.minimum(np.max(down, axis=0), np.max(up, axis=0))))


def _leave_servo(expected: Expected, seen: Evidence, after: np.ndarray) -> tuple[float | None, str]:
    when = next((t for t, text in seen.events if t >= seen.fault and "stopDirectServoJoints" in text), None)
    return when, "" if when is not None else "the robot got no stopDirectServoJoints"


def _latch(expected: Expected, seen: Evidence, after: np.ndarray) -> tuple[float | None, str]:
    later = [(when, mode) for when, mode, _ in seen.statuses if seen.fault <= when < _until(seen)]
    latched = next((when for when, mode in later if mode == "stopped"), None)
    if latched is None:
        return None, "the mode was never `stopped`"
    if any(mode != "stopped" for when, mode in later if when > latched):
        return None, "the latch opened without the operator"
    if short := _too_short(seen, latched + LATCHES_S, "it had been latched"):
        return None, short
    q = after[(after[:, 0] > latched + LATCHES_S) & (after[:, 0] < _until(seen)), 1:8]
    if len(q) and np.max(np.abs(q - q[0])) > STAYS:
        return None, f"the arm moved by {np.max(np.abs(q - q[0])):.3f} rad while it was latched"
    return latched, ""


def _refuse(expected: Expected, seen: Evidence, after: np.ndarray) -> tuple[float | None, str]:
    when = next((t for t, _, _ in _naming(expected, seen)), None)
    return when, "" if when is not None else "nothing was refused"


def _naming(expected: Expected, seen: Evidence) -> list[tuple[float, str, str]]:
    return [said for said in seen.said if said[0] >= seen.fault and re.search(expected.named_by, said[2])]


_REACTIONS = {"H": _hold, "D": _disengage, "S": _leave_servo, "L": _latch, "R": _refuse}
