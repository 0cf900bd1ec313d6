"""From a lost link to the robot until a person switches control on again: nothing moves by itself.

Stands where the control loop stood. While the link is gone it says when the next try to connect is due, ever more
rarely. When it is back the arm stays where it is; once control is switched on, or the controller is asked to end, a
fresh control loop takes over, whose first motion is that of every start.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

from kst import ConnectionLost, KstError, ReplyTimeout
from kuka_control.loop.commands import Event, Observation, Step, Wait
from kuka_control.loop.control_loop import ControlLoop
from kuka_control.loop.stream import Desired
from kuka_control.loop.transitions import Mode

FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 5.0
"""The pause before a try to connect doubles up to this [s]."""

REMIND_S = 30.0
"""That the robot is still out of reach is said so often [s]."""

BACK = (
    "The robot is connected again. The arm stays where it is until control is switched on; then it goes home first "
    "and follows the desired tool frame."
)


class Standby:
    """Waits for the robot, then for a person.

    Attributes:
        counts: those of the control loop before, which go on.
        reason: how things stand.
        next_try: when to try to connect, monotonic time [s].
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
        self._old: Desired | None = None

    @property
    def stopped_because(self) -> str | None:
        """Why nothing moves; None if nothing hinders it."""
        return self.reason if self._loop is None else self._loop.stopped_because

    def failed(self, error: KstError, now: float) -> tuple[Event, ...]:
        """Takes in that a try failed at the time `now` [s]; returns what is to be said."""
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
        """Takes in that the robot is back; returns what is to be said."""
        self.reason = BACK
        return (Event("info", BACK),)

    def waiting(self) -> Step:
        """Returns the step of one who waits."""
        return Step(Wait(), Mode.STOPPED, self.reason, ())

    def step(self, seen: Observation, now: float) -> Step:
        """As the step of a control loop, for which it stands."""
        if self._loop is None:
            self._old = seen.desired
            if not (seen.control_on or seen.exit_requested):
                return self.waiting()
            self._loop = self._make_loop()
            self._loop.counts = self.counts
        if seen.desired is self._old:
            seen = replace(seen, desired=None)
        return self._loop.step(seen, now)
