"""Reconnects after a lost link to the robot. Nothing moves until the operator switches control on again.

The supervisor replaces the control loop. While the link is down it says when the next attempt to connect is due, with
growing pauses. Once the link is back the arm stays where it is. When control is switched on, or an exit is requested, a
fresh control loop takes over and starts with the motion home.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

from kst import ConnectionLost, KstError, ReplyTimeout
from kuka_control.loop.commands import Event, Observation, Step, Wait
from kuka_control.loop.control_loop import ControlLoop
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.mode import Mode

FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 5.0
"""The pause between attempts doubles up to this [s]."""

REMIND_S = 30.0
"""Period of the warnings that the robot is still out of reach [s]."""

BACK = (
    "The robot is connected again. The arm stays where it is until control is switched on; then it goes home first "
    "and follows the desired tool frame."
)


class ReconnectSupervisor:
    """Waits for the robot, then for the operator.

    Attributes:
        counts: the counters of the previous control loop, which continue.
        reason: the published reason.
        next_try: time of the next attempt to connect, monotonic [s].
    """

    def __init__(self, error: KstError, counts: Counter[str], make_loop: Callable[[], ControlLoop], now: float) -> None:
        silent = isinstance(error, (ConnectionLost, ReplyTimeout))
        what = "The robot is out of reach" if silent else "The link to the robot was given up"
        self.counts = counts
        self._lost = (
            f"{what}: {error}. Control is off, and this controller tries to connect again. A server that lost its "
            "client may be deaf: then end MatlabToolboxServer on the smartPad and start it again."
        )
        self.reason = self._lost
        self.next_try = now + FIRST_PAUSE_S
        self._pause = FIRST_PAUSE_S
        self._tries = 0
        self._remind_at = now
        self._make_loop = make_loop
        self._loop: ControlLoop | None = None
        self._old_frame: DesiredFrame | None = None

    @property
    def stopped_because(self) -> str | None:
        """Why the arm cannot move, a sentence; None if nothing inhibits it."""
        return self.reason if self._loop is None else self._loop.stopped_because

    def failed(self, error: KstError, now: float) -> tuple[Event, ...]:
        """Records an attempt that failed at the time `now` [s]; returns what to log."""
        self._tries += 1
        self._pause = min(2.0 * self._pause, LONGEST_PAUSE_S)
        self.next_try = now + self._pause
        failure = f"Try {self._tries} failed: {error}."
        self.reason = f"{self._lost} {failure}"
        if now < self._remind_at:
            return ()
        self._remind_at = now + REMIND_S
        return (Event("warn", f"The robot is still gone. {failure}"),)

    def connected(self) -> tuple[Event, ...]:
        """Records that the link is back; returns what to log."""
        self.reason = BACK
        return (Event("info", BACK),)

    def waiting(self) -> Step:
        """Returns the step while nothing moves."""
        return Step(Wait(), Mode.STOPPED, self.reason, ())

    def step(self, observation: Observation, now: float) -> Step:
        """Returns the step of the fresh control loop; before it exists, `waiting()`."""
        inputs = observation.inputs
        if self._loop is None:
            self._old_frame = inputs.desired
            if not (inputs.switches.control_on or inputs.switches.exit_requested):
                return self.waiting()
            self._loop = self._make_loop()
            self._loop.counts = self.counts
        if inputs.desired is self._old_frame:
            observation = replace(observation, inputs=replace(inputs, desired=None))
        return self._loop.step(observation, now)
