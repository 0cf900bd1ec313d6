"""A fist of the second hand as a sign: closed for a second, and open again before the next."""

from __future__ import annotations

CLOSED, OPEN = 0.9, 0.4  # grab strengths
HELD_S = 1.0


class FistSign:
    """Recognises the sign; the hand must be seen open first."""

    def __init__(self) -> None:
        self._armed = False
        self._since: float | None = None

    def step(self, grab: float, now: float) -> bool:
        """Returns whether the sign is given at `now` [s]; `grab`: 0 open to 1 fist, NaN where the hand is not seen."""
        if not grab >= CLOSED:  # nor NaN
            self._since = None
            self._armed = grab <= OPEN or (self._armed and grab == grab)
            return False
        if not self._armed:
            return False
        self._since = now if self._since is None else self._since
        if now - self._since < HELD_S:
            return False
        self._armed, self._since = False, None
        return True
