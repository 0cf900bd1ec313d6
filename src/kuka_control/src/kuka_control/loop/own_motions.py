"""What the arm does of its own accord, which is little: no motion that nobody asked for is repeated at once, and a
stream of desired tool frames from before control was switched on is taken over only where it is near. Times `now` are
monotonic [s]."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from kuka_control.loop.transitions import State
from kuka_control.numbers import ANNOUNCED_S, FOREIGN_PAUSE_S

AGAIN_S = 10.0  # a PTP motion that nobody asked for is not repeated within this time [s]
NEAR_M, NEAR_RAD = 0.3, math.radians(45.0)  # and only if it is not farther from the tool at home

WAITS = (
    f"The arm repeats a motion that nobody asked for only after {AGAIN_S:g} s: it waits {{left}} s more, or until "
    "control is switched off and on."
)
TAKEN_OVER = (
    f"The desired tool frame came before control was switched on; {ANNOUNCED_S:g} s after it is announced the arm "
    "goes there slowly and follows it."
)


class OwnMotions:
    """Counts the pick-up motions and the returns home that follow from the desired tool frame alone. Each of both is
    repeated at the earliest after AGAIN_S, unless the operator has acted meanwhile: has switched control on, moved
    the arm by a program, or brought a hand in, before which its publisher told of none; with an interrupted link it
    tells nothing. Where the publisher does not show that, a hand's frames have one repetition free."""

    def __init__(self) -> None:
        self._times: dict[State, deque[float]] = {}
        self.forget()

    def forget(self) -> None:
        """The operator acted: all motions up to now were asked for."""
        self._times = {state: deque((-math.inf,) * 2, maxlen=2) for state in (State.PICK_UP, State.RETURNING)}

    def note(self, state: State, now: float) -> None:
        """A motion of the kind `state` begins that nobody asked for."""
        self._times[state].append(now)

    def waits(self, foreign: bool, kinds: Sequence[State], now: float) -> str | None:
        """Returns why the arm is not to begin what ends in motions of these kinds, a sentence, or None; `foreign`:
        no hand brings the frame."""
        left = max(self._times[kind][1 if foreign else 0] for kind in kinds) + AGAIN_S - now
        return WAITS.format(left=math.ceil(left)) if left > 0.0 else None


def too_far(distance: float, turn: float) -> str | None:
    """Returns why the arm does not take a stream over that is so far from the tool at home [m], [rad], or None."""
    if distance <= NEAR_M and turn <= NEAR_RAD:
        return None
    return (
        f"The desired tool frame came before control was switched on and is {1e3 * distance:.0f} mm and "
        f"{math.degrees(turn):.0f} deg from the tool at home, but the arm takes it over only within "
        f"{1e3 * NEAR_M:.0f} mm and {math.degrees(NEAR_RAD):.0f} deg: bring it nearer and switch control off and on, "
        f"or let it pause for {FOREIGN_PAUSE_S:g} s."
    )
