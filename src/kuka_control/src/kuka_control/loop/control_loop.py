"""What both control loops share: the life from the first way home to the last way to zero, as a state machine.

    observation, now -> step: one command for the arm, and what there is to say

A step looks at everything that came since the one before and answers with one command; it waits for nothing. While a
motion runs, desired tool frames are disregarded; afterwards only new ones count.

After a fault (refused motion, arm that was held on its way or does not follow) the loop is latched: it leaves the arm
where it is, says why, and goes on, with a motion home, only after control was switched off and on again.
real_time_loop.py and ptp_loop.py hold the two algorithms.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass
from typing import Callable, Generic, TypeVar

import numpy as np

from common.poses import read_only
from kuka_control.loop.commands import Command, End, Event, Observation, StartPtp, Step, Wait
from kuka_control.loop.stream import Desired, DesiredStream
from kuka_control.loop.tracking import MotionMonitor
from kuka_control.model.target import Target, TargetChain
from kuka_control.model.workspace import Infeasible

Q_ZERO = read_only(np.zeros(7))
"""The joints in which the arm is left behind [rad]."""

UNENDING_S = 2.0
"""Who wants to exit waits so long for an arm that is held on its way [s]."""

COUNTED = (
    *("goals_sent", "limited_goals", "workspace_clips", "ik_failures", "refused_frames"),
    *("pickups", "homes", "ptp_motions", "jumps", "flips", "faults"),
)
"""What is counted; all are there from the start."""


@dataclass(frozen=True)
class LoopSettings:
    """What both loops need to know.

    Attributes:
        q_home: home position, shape (7,) [rad].
        time_out: go home after so long without a new desired tool frame [s].
        velocity_home: share of the full joint speed to home at the start and when control goes off, and to zero.
        velocity_return: share of the full joint speed to home after a time-out.
    """

    q_home: np.ndarray
    time_out: float
    velocity_home: float
    velocity_return: float


@dataclass(frozen=True)
class _Motion:
    """A PTP motion that runs: where to, in words and joints, the state after it, and whether it goes on."""

    name: str
    q: np.ndarray
    then: Callable[..., Command]
    monitor: MotionMonitor


Settings = TypeVar("Settings", bound=LoopSettings)
State = Callable[..., Command]


class ControlLoop(ABC, Generic[Settings]):
    """The shared half; a subclass says how a new target is followed."""

    def __init__(self, settings: Settings, chain: TargetChain) -> None:
        self.counts: Counter[str] = Counter(dict.fromkeys(COUNTED, 0))
        self.stopped_because: str | None = None
        self._settings = settings
        self._chain = chain
        self._stream = DesiredStream()
        self._state: Callable[[Observation, Desired | None, float], Command] = self._starting
        self._mode = "starting"
        self._reason = "The controller has started."
        self._limited_by: tuple[str, ...] = ()
        self._events: list[Event] = []
        self._motion: _Motion | None = None
        self._held = self._was_held = False
        self._at_home = False
        self._home_at: float | None = None
        self._because = ""
        self._leaving_because: str | None = None
        self._engagements = self._engagement = 0
        self._aim: Target | None = None
        self._failing = False
        self._kept: str | None = None

    def step(self, seen: Observation, now: float) -> Step:
        """Returns what is to be done now.

        Args:
            seen: what is known.
            now: monotonic time [s].
        """
        self._events = []
        self._limited_by = ()
        self._engagements = seen.engagements
        taken = self._stream.take(seen.desired, seen.clock, now)
        if taken.refused:
            self.counts["refused_frames"] += 1
            self._say("warn", taken.refused)
        if seen.refused is not None:
            command = self._give_up(seen.refused)
        else:
            command = self._state(seen, taken.fresh, now)
        bounds = self._aim.bounds if self._aim else ()
        reason = " ".join(filter(None, (self._reason, self._hindrance(seen, now))))
        return Step(command, self._mode, reason, tuple(self._events), self._aim, bounds + self._limited_by)

    @abstractmethod
    def _follow(self, seen: Observation, target: Target, now: float) -> Command:
        """Answers a new target at rest, while control is on."""

    def _starting(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        if self._leaving(seen):
            return self._go_to_zero(seen, now)
        return self._ptp(seen, "home", self._settings.q_home, self._settings.velocity_home, "homing", self._home, now)

    def _home(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        self._at_home = True
        self._enter("home", self._at_rest, "The arm is at home.")
        self.counts["homes"] += 1
        return self._at_rest(seen, fresh, now)

    def _at_rest(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        """No motion and no servo: at home, or where a motion ended."""
        if self._leaving(seen):
            return self._go_to_zero(seen, now)
        if self._must_return(seen, now) and self._home_at is not None:
            velocity, self._home_at = self._home_at, None
            return self._ptp(seen, "home", self._settings.q_home, velocity, "returning", self._home, now)
        if self._at_home:
            self._engagement = seen.engagements
        if not seen.control_on or fresh is None:
            return Wait()
        target = self._resolve(seen, fresh, seen.joints)
        return Wait() if target is None else self._follow(seen, target, now)

    def _moving(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        """A PTP motion runs, which nothing can stop; transforms are disregarded."""
        motion = self._motion
        assert motion is not None, "this state begins with a motion"
        if seen.arrived:
            if self._was_held and motion.then != self._zero:
                return self._latch(f"Something held the arm on its way to {motion.name}.")
            self._state = motion.then
            return motion.then(seen, None, now)
        held = motion.monitor.step(seen.joints, now)
        if held and motion.monitor.still > UNENDING_S and self._leaving(seen):
            return self._end(f"The arm cannot go to zero because its motion to {motion.name} does not end.")
        if held and not self._held:
            left = np.degrees(np.max(np.abs(motion.q - seen.joints)))
            self._reason = self.stopped_because = (
                f"The motion to {motion.name} does not go on, {left:.1f} deg are left; if a safety stop holds the arm, "
                "free the arm and press run on the smartPad."
            )
            self._say("error", self._reason)
        elif self._held and not held:
            self._reason = f"The arm moves on to {motion.name} and stays there until control goes off and on again."
            self._say("info", self._reason)
        self._held = held
        self._was_held |= held
        return Wait()

    def _latched(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        """A fault holds the loop until control goes off and on again."""
        if self._leaving(seen):
            return self._go_to_zero(seen, now)
        if seen.control_on and seen.engagements != self._engagement:
            self._because = "Control was switched off and on again."
            self.stopped_because = None
            return self._starting(seen, fresh, now)
        return Wait()

    def _zero(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        return self._end(self._leaving_because)

    def _ended(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        return End(self._leaving_because)

    def _ptp(
        self, seen: Observation, name: str, q: np.ndarray, velocity: float, mode: str, then: State, now: float
    ) -> Command:
        self._motion = _Motion(name, q, then, MotionMonitor(q))
        self._held = self._was_held = self._at_home = False
        why = f"{self._because} " if self._because else ""
        self._because = ""
        self._enter(mode, self._moving, f"{why}The arm moves to {name} at {velocity:g} of the full joint speed.")
        if then in (self._home, self._zero):
            self._aim = None
        self.counts["ptp_motions"] += 1
        return StartPtp(read_only(q), velocity)

    def _go_to_zero(self, seen: Observation, now: float) -> Command:
        velocity = self._settings.velocity_home
        return self._ptp(seen, "the zero position", Q_ZERO, velocity, "zero", self._zero, now)

    def _give_up(self, refused: str) -> Command:
        """The robot's controller refused the last command, or ended servo mode by itself."""
        if self._state == self._latched:
            return Wait()
        if self._state != self._moving:
            return self._latch(f"The robot's controller has ended servo mode: {refused}.")
        motion = self._motion
        assert motion is not None, "this state begins with a motion"
        fault = f"The robot's controller refused the motion to {motion.name}: {refused}."
        return self._end(fault) if motion.then == self._zero else self._latch(fault)

    def _latch(self, fault: str) -> Command:
        self._enter("stopped", self._latched, f"{fault} The arm stays where it is until control goes off and on again.")
        self._aim = self._home_at = None
        self._at_home = False
        self._engagement = self._engagements
        self.stopped_because = fault
        self.counts["faults"] += 1
        return Wait()

    def _end(self, fault: str | None) -> Command:
        self._leaving_because = fault
        self._enter("stopped", self._ended, fault or "The controller has ended as it was asked to.")
        return End(fault)

    def _leaving(self, seen: Observation) -> bool:
        return seen.exit_requested or self._leaving_because is not None

    def _must_return(self, seen: Observation, now: float) -> bool:
        """Whether the arm has to go home now, or to be stopped for that; at which velocity, stands in _home_at then."""
        if self._home_at is None and not self._at_home:
            if not seen.control_on or seen.engagements != self._engagement:
                self._because = f"Control {'was' if seen.control_on else 'is'} off."
                self._home_at = self._settings.velocity_home
            elif self._stream.silent_for(now) > self._settings.time_out:
                self._because = f"No new desired tool frame came for {self._settings.time_out:g} s."
                self._home_at = self._settings.velocity_return
        return self._home_at is not None

    def _resolve(self, seen: Observation, fresh: Desired, near: np.ndarray) -> Target | None:
        """Returns the joint target of a desired tool frame; without one the arm keeps its joints."""
        target = self._chain.resolve(fresh.T_base_tool, seen.scale, near)
        if isinstance(target, Infeasible):
            self._leaving_because = f"The controller shuts down because of the desired tool frame: {target}."
            self._say("error", self._leaving_because)
            return None
        if target.q is None:
            self.counts["ik_failures"] += 1
            self._kept = f"The arm keeps its joints: {target.failure}"
            if not self._failing:
                self._say("warn", self._kept)
            self._failing = True
            return None
        self._failing, self._kept = False, None
        if target.bounds and not (self._aim and self._aim.bounds):
            self.counts["workspace_clips"] += 1
        self._aim = target
        return target

    def _hindrance(self, seen: Observation, now: float) -> str | None:
        """Returns why the frames that come in are not followed although control is on, a sentence; else None."""
        if not seen.control_on:
            return None
        kept = self._kept if self._stream.silent_for(now) <= self._settings.time_out else None
        return self._stream.refusal(now) or kept

    def _enter(self, mode: str, state: State, reason: str) -> None:
        """Changes the state; what it does and why is said once."""
        self._state, self._mode, self._reason, self._kept = state, mode, reason, None
        self._say("error" if mode == "stopped" and state == self._latched else "info", reason)

    def _say(self, level: str, sentence: str) -> None:
        self._events.append(Event(level, sentence))
