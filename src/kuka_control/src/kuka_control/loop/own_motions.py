"""What the arm does of its own accord, which is little: no motion that nobody asked for is repeated at once."""

from __future__ import annotations

import math
from collections import deque

from kuka_control.loop.transitions import State, Trigger
from kuka_control.numbers import AGAIN_S

WAITS = (
    f"The arm repeats a motion that nobody asked for only after {AGAIN_S:g} s: it waits {{left}} s more, or until "
    "control is switched off and on."
)


class OwnMotions:
    """Counts the pick-up motions and the returns home that follow from the desired tool frame alone; with PTP motions
    alone, each of a stream is asked for. Each of both is repeated at the earliest after AGAIN_S, unless the operator
    has acted meanwhile: has switched control on, moved the arm by a program, or brought a hand in, before which its
    publisher told of none; with an interrupted link it tells nothing. Where the publisher does not show that, a hand's
    frames have one repetition free."""

    def __init__(self) -> None:
        self._times: dict[State, deque[float]] = {}
        self.forget()

    def forget(self) -> None:
        """The operator acted: all motions up to now were asked for."""
        self._times = {state: deque((-math.inf,) * 2, maxlen=2) for state in (State.PICK_UP, State.RETURNING)}

    def note(self, source: State, target: State, causes: tuple[Trigger | None, Trigger], now: float) -> None:
        """Counts a PTP motion that begins, from state to state, if nobody asked for it; `now` is monotonic [s]."""
        picks_up = target is State.PICK_UP and source is not State.AT_POSE
        if picks_up or (target is State.RETURNING and Trigger.TIME_OUT in causes):
            self._times[target].append(now)

    def waits(self, source: State, trigger: Trigger, foreign: bool, now: float) -> str | None:
        """Returns why the arm is not to begin what `trigger` begins, a sentence, or None; `foreign`: no hand brings
        the frame. An arm that leaves home returns there some time."""
        if source is State.AT_POSE:
            return None
        kinds = [State.RETURNING] if source in (State.HOME, State.AT_GOAL) else []
        if trigger is Trigger.FAR_TARGET:
            kinds.append(State.PICK_UP)
        left = max((self._times[kind][1 if foreign else 0] for kind in kinds), default=-math.inf) + AGAIN_S - now
        return WAITS.format(left=math.ceil(left)) if left > 0.0 else None
