"""The desired tool frame: whether a pose can be one, which nodes publish it, and which of its stamps counts as new.
Times are of two clocks: stamps and `clock` are ROS time; `now` is monotonic, so that setting the wall clock does not
look like a time-out."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from common.frame_rate import FrameRate
from common.poses import check_pose, inverse
from common.rotations import UNIT_TOLERANCE, rotation_angle
from common.sentences import without_numbers
from common.stream_pause import NEW_STREAM_PAUSE_S
from kuka_control.numbers import (
    FOREIGN_PAUSE_S,
    HANDOVER_S,
    MAX_DISTANCE_M,
    MAX_SKEW_S,
    PAUSE_PERIODS,
    REFUSING_S,
    STALLED_S,
)

LONGEST_PERIOD_S = 2.0  # of them that counts [s]
LOOK_S = 0.03  # a cycle counts for at most this long as a pause: in a stall of the control loop frames came unseen [s]
RATE_WINDOW_S = 0.3  # time over which frames are counted [s]
CHAIN_STEP_M = 0.02  # a frame in the chain that moves farther at once, or turns by CHAIN_STEP_RAD, was set anew
CHAIN_STEP_RAD = math.radians(2.0)
AT_ONCE_S = 0.1  # between two stamps that are not farther apart [s]
ABSENT_S = 1.0  # a frame that has not come for this long is missed [s]
LIKE = 0.6  # how much another frame's name resembles the missing one, 0 to 1


@dataclass(frozen=True)
class DesiredFrame:
    T_base_tool: np.ndarray  # shape (4, 4) [m]
    stamp: float  # ROS time [s]; of one that is refused on arrival any other number than of the one before
    conflict: str | None = None  # why the controller must not follow it, a sentence, if that is known on arrival
    refused: str | None = None  # why this frame alone does not count, a sentence, if that is known on arrival
    clock: int = 0  # number of the measurement by which its stamp is of this machine's clock (clock_offset.py)
    foreign: bool = False  # whether it does not stand in the virtual Leap, so that no operator's hand brings it
    engagement: int | None = None  # of a hand, another one after each time that its publisher went on without one


def rejection_reason(T_base_tool: np.ndarray) -> str | None:
    """Returns why a matrix cannot be the pose of the tool in the base, the end of a sentence; None if it can."""
    try:
        T_base_tool = check_pose(T_base_tool)
    except ValueError as error:
        return f"{error}."
    distance = math.hypot(*T_base_tool[:3, 3].tolist())
    return f"it is {distance:.4g} m from the base; is it in metres?" if distance > MAX_DISTANCE_M else None


def transform_fault(numbers: Sequence[float]) -> str | None:
    """Returns why x, y, z and the quaternion x, y, z, w cannot be a transform, the end of a sentence; None if they
    can. tf2 leaves some of these out without a word to ROS."""
    if not all(map(math.isfinite, numbers)):
        return "it is not finite"
    norm = math.hypot(*numbers[3:])
    return f"its quaternion has norm {norm:.6g} instead of 1" if abs(norm - 1.0) > UNIT_TOLERANCE else None


def skew_fault(
    stamp: float, clock: float, finding: str = "it is old, or the clocks of the machines differ"
) -> str | None:
    """Returns why a desired tool frame with this stamp is refused at the ROS time `clock` [s], a sentence, or None;
    `finding`: what is known about the clock that stamps it."""
    skew = stamp - clock
    if abs(skew) <= MAX_SKEW_S:
        return None
    if stamp == 0.0:
        return "The desired tool frame is refused: its stamp is 0; give each message the present time as its stamp."
    side = "ahead of" if skew > 0.0 else "behind"
    return (
        f"The desired tool frame is refused: its stamp is {abs(skew):.3f} s {side} this machine's clock, more than "
        f"{MAX_SKEW_S:g} s; {finding}."
    )


CLOCK_SET = "The desired tool frame is refused: the clock that stamps it was set while it came."
HAND_IN_AGAIN = "take the hand out of the box and bring it in again."


def until_anew(foreign: bool) -> str:
    """Returns when a stream counts again that does not count, a sentence; `foreign`: no hand brings it."""
    if not foreign:
        return f"The desired tool frame does not count until it begins anew: {HAND_IN_AGAIN}"
    return f"The desired tool frame counts again after a pause of {FOREIGN_PAUSE_S:g} s."


@dataclass(frozen=True)
class Conflict:
    """A frame that several nodes published, the last time at `when`."""

    frame: str
    nodes: tuple[str, ...]
    when: float

    def __str__(self) -> str:
        return f"{' and '.join(self.nodes)} both publish {self.frame}; end one of them"


class ChainWatch:
    """Notices that the desired tool frame jumps with a frame that it stands in: one that was calibrated anew."""

    def __init__(self) -> None:
        self._last: tuple[float, str, np.ndarray, np.ndarray] | None = None

    def step(self, stamp: float, parent: str, T_base_parent: np.ndarray, T_base_tool: np.ndarray) -> str | None:
        """Returns what jumped, a sentence, or None. `stamp` of the desired tool frame [s], the frame `parent` that
        it stands in, and the poses of both in the base, shape (4, 4) [m]."""
        last, self._last = self._last, (stamp, parent, T_base_parent, T_base_tool)
        if last is None or parent != last[1] or not 0.0 < stamp - last[0] <= AT_ONCE_S:
            return None
        if not (_far(last[2], T_base_parent) and _far(last[3], T_base_tool)):
            return None
        if _far(inverse(last[2]) @ last[3], inverse(T_base_parent) @ T_base_tool):
            return None
        step = 1e3 * float(np.linalg.norm((T_base_parent - last[2])[:3, 3]))
        turn = math.degrees(rotation_angle(last[2][:3, :3].T @ T_base_parent[:3, :3]))
        by = f"{step:.0f} mm and {turn:.0f} deg"
        return f"The frame {parent}, in which the desired tool frame stands, jumped by {by}."


def _far(T_before: np.ndarray, T_now: np.ndarray) -> bool:
    step = float(np.linalg.norm((T_now - T_before)[:3, 3]))
    return step > CHAIN_STEP_M or rotation_angle(T_before[:3, :3].T @ T_now[:3, :3]) > CHAIN_STEP_RAD


class FrameSources:
    """Knows who published which frame lately, and in which other frame it stands."""

    def __init__(self) -> None:
        self._heard: dict[str, dict[str, float]] = {}
        self._parents: dict[str, str] = {}
        self._conflicts: dict[str, Conflict] = {}

    def heard(self, frame: str, parent: str, node: str, now: float) -> bool:
        """Takes note of who published a frame; returns whether nobody else did lately."""
        self._parents[frame] = parent
        lately = self._heard.get(frame, {})
        if len(lately) == 1 and node in lately:
            lately[node] = now
            return True
        times = {name: then for name, then in lately.items() if now - then < HANDOVER_S}
        times[node] = now
        self._heard[frame] = times
        if len(times) > 1:
            self._conflicts[frame] = Conflict(frame, tuple(sorted(times)), now)
        return len(times) == 1

    def like(self, frame: str, now: float, known: tuple[str, ...]) -> tuple[str, str] | None:
        """Returns a frame that comes and whose name is like that of `frame`, and the nodes that publish it; None if
        all such names end like those in `known`."""
        names = [name for name, nodes in self._heard.items() if now - max(nodes.values()) < ABSENT_S]
        found = difflib.get_close_matches(frame, [name for name in names if not name.endswith(known)], 1, LIKE)
        return (found[0], " and ".join(self._heard[found[0]])) if found else None

    def conflict(self, frame: str, now: float) -> Conflict | None:
        """Returns the conflict about `frame` or about one of those that it stands in, directly or not; else None."""
        passed = set()
        while frame not in passed:
            found = self._conflicts.get(frame)
            if found is not None and now - found.when < HANDOVER_S:
                return found
            passed.add(frame)
            frame = self._parents.get(frame, frame)
        return None


class SteadyStamps:
    """Takes the steps out of stamps whose clock is set meanwhile: back, or forwards by more than MAX_SKEW_S, which
    no delay on the way explains."""

    def __init__(self) -> None:
        self._last: tuple[float, float] | None = None
        self._offset = 0.0

    def take(self, stamp: float, now: float) -> float:
        """Returns the stamp of a new frame [s], less all steps so far; `now` is monotonic [s]."""
        if self._last is not None:
            step = (stamp - self._last[0]) - (now - self._last[1])
            if stamp <= self._last[0] or step > MAX_SKEW_S:
                self._offset -= step
        self._last = stamp, now
        return stamp + self._offset


@dataclass(frozen=True)
class StreamUpdate:
    """The verdict on the newest desired tool frame."""

    fresh: DesiredFrame | None = None  # the frame, if it is new and accepted; its stamp is one of SteadyStamps
    refused: str | None = None  # why it is refused, a sentence, once for each reason among those refused in a row
    conflict: str | None = None  # why the whole stream must not be followed any longer, a sentence


class DesiredStream:
    """Watches the newest desired tool frame. `number` counts the streams: runs of frames without a pause, refused
    ones included. Number 0 may have begun before this object. A foreign frame continues a stream also after a pause
    of less than FOREIGN_PAUSE_S: its publisher lags, or nothing came since two were in conflict. Once frames of a
    run were accepted, only those whose clock is measured as theirs was count in it."""

    def __init__(self) -> None:
        self.number = 0
        self._last_stamp: float | None = None
        self._looked: float | None = None
        self._pause = 0.0  # since the last frame of either kind [s]
        self._period = 0.0  # between the last two frames [s]
        self._silence = math.inf  # since the last accepted frame [s]
        self._gaps = (math.inf, math.inf)  # between the last three accepted frames [s]
        self._stalled = 0.0  # since then, in stalls of the control loop [s]
        self._reported: set[str] = set()  # what the frames refused in a row were refused for, without the numbers
        self._refusal: tuple[str, float] | None = None
        self._stamps = SteadyStamps()
        self._clock: int | None = None  # of the accepted frames since the last pause
        self._rate = FrameRate(RATE_WINDOW_S)  # of the accepted frames
        self.foreign = False  # whether the last frame was, accepted or refused

    def take(self, newest: DesiredFrame | None, clock: float, now: float, in_servo: bool = False) -> StreamUpdate:
        """Checks the newest frame; `clock` is ROS time, `now` monotonic [s]. New is one with another stamp."""
        elapsed = 0.0 if self._looked is None else max(now - self._looked, 0.0)
        self._looked = now
        self._pause += min(elapsed, LOOK_S)
        stalled = max(elapsed - LOOK_S, 0.0)
        if in_servo and self._stalled + stalled <= STALLED_S:
            self._stalled += stalled
            self._silence += elapsed - stalled
        else:
            self._silence += elapsed
        if newest is None or newest.stamp == self._last_stamp:
            return StreamUpdate()
        if not self.runs:
            self.number += not (newest.foreign and self.lasts)
            self._clock = None
        self._last_stamp, self.foreign = newest.stamp, newest.foreign
        self._period = min(self._pause, LONGEST_PERIOD_S)
        self._pause = 0.0
        fault = _fault(newest, clock)
        if fault is None and self._clock not in (None, newest.clock):
            fault = f"{CLOCK_SET} {until_anew(newest.foreign)}"
        if fault is None:
            self._clock = newest.clock
            self._reported.clear()
            self._refusal = None
            self._gaps = (self._gaps[1], self._silence)
            self._silence = self._stalled = 0.0
            steady = self._stamps.take(newest.stamp, now)
            self._rate.take(steady)
            return StreamUpdate(replace(newest, stamp=steady))
        kind = without_numbers(fault)
        reported = kind in self._reported
        self._reported.add(kind)
        self._refusal = (fault, now)
        return StreamUpdate(refused=None if reported else fault, conflict=newest.conflict)

    @property
    def runs(self) -> bool:
        """Whether frames come, accepted or refused."""
        return self._pause <= max(NEW_STREAM_PAUSE_S, PAUSE_PERIODS * self._period)

    @property
    def lasts(self) -> bool:
        """Whether a foreign frame that came now would continue the stream."""
        return self.runs or (self._last_stamp is not None and self._pause < FOREIGN_PAUSE_S)

    @property
    def silence(self) -> float:
        """Time since the last accepted frame, in servo mode without stalls of the loop [s]; infinite before it."""
        return self._silence

    @property
    def rate(self) -> float | None:
        """Rate of the accepted frames by their stamps [Hz]; None while too few came."""
        return self._rate.value if self._rate.span >= RATE_WINDOW_S else None

    def steady(self, time_out: float) -> bool:
        """Whether the last two accepted frames came within the time-out [s] of each other."""
        return self._gaps[1] <= time_out

    def too_slow(self, time_out: float) -> str | None:
        """Returns that the frames are farther apart than the time-out [s], a sentence, or None."""
        gap = min(self._gaps)
        if not time_out < gap < math.inf or self._silence > PAUSE_PERIODS * gap:
            return None
        return (
            f"The desired tool frame comes only every {gap:.2f} s, but time_out is {time_out:g} s, so it is not "
            "followed: publish it more often, or start the controller with a longer time_out."
        )

    def refusal(self, now: float) -> str | None:
        """Returns why incoming frames are refused, a sentence; None if they are accepted, or none come."""
        return self._refusal[0] if self._refusal and now - self._refusal[1] <= REFUSING_S else None


def _fault(desired: DesiredFrame, clock: float) -> str | None:
    fault = desired.conflict or desired.refused or skew_fault(desired.stamp, clock)
    if fault is not None:
        return fault
    reason = rejection_reason(desired.T_base_tool)
    return None if reason is None else f"The desired tool frame is refused: {reason}"
