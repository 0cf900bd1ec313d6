"""The collision guard's check of the path of a motion that is to begin, a part of it in each cycle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kuka_control.limits.moving_arm import GuardError

if TYPE_CHECKING:
    from kuka_control.limits.collision import CollisionGuard, PathCheck

FINGER_IN_THE_WAY = (
    "A finger that opens or closes meanwhile could come that near; what the fingers may touch, name in allow_contact. "
)

CHECKED_AT_ONCE = 100  # so many distances are measured in one cycle: a few ms


class PathVerdict(NamedTuple):
    decided: bool  # whether the whole path is checked, or refused
    refusal: str | None = None  # why the motion may not begin, a sentence


ALLOWED = PathVerdict(True)


class PendingCheck:
    """Checks one path over several cycles; a cycle that does not ask for it drops it.

    Attributes:
        continues: whether this cycle asked for it."""

    def __init__(self, guard: CollisionGuard | None) -> None:
        """Without a guard every motion may begin."""
        self.continues = False
        self._guard = guard
        self._path: Sequence[np.ndarray] = ()
        self._check: PathCheck | None = None  # of that path; None: no motion is to begin

    def begin_cycle(self) -> None:
        self.continues = False

    def end_cycle(self, moves: bool) -> None:
        """`moves`: the state has changed in this cycle, so the motion began or is no longer wanted."""
        if moves or not self.continues:
            self._check = None

    def goes_to(self, q: np.ndarray | None) -> bool:
        """Returns whether the path of a motion to the joints `q` is being checked."""
        return self._check is not None and q is not None and self._path[-1] is q

    def ask(self, what: str, path: Sequence[np.ndarray], softly: bool) -> PathVerdict:
        """Checks the next part of a path, joints of shape (7,) each [rad], of a motion that is called `what`. What
        ends the check does so in the cycle after. `softly`: as for the guard."""
        guard = self._guard
        if guard is None:
            return ALLOWED
        self.continues = True
        check = self._check
        try:
            if check is None or not _same(self._path, path):
                self._path = path
                self._check = check = guard.check(path, softly)
            elif check.done:
                return ALLOWED
            check.go_on(CHECKED_AT_ONCE)
        except GuardError as error:
            self._check = None
            return PathVerdict(True, f"The {what} is refused. {error}")
        if check.fault is None:
            return PathVerdict(False)
        self._check = None
        refuses = f"The collision guard refuses the {what}: on the way {check.fault}"
        finger = FINGER_IN_THE_WAY if check.fault.finger else ""
        return PathVerdict(True, f"{refuses}; it keeps {1e3 * guard.margin:.0f} mm. {finger}Clear the way.")


def _same(before: Sequence[np.ndarray], path: Sequence[np.ndarray]) -> bool:
    """Returns whether a path, joints of shape (7,) each [rad], is one before, from where the arm still stands."""
    stands = 5e-4  # an arm whose joints are no further off still is where the check began [rad]
    starts = float(np.max(np.abs(before[0] - path[0]))) <= stands
    return starts and len(before) == len(path) and all(map(np.array_equal, before[1:], path[1:]))
