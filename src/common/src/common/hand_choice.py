"""Which of the hands in view is the operator's: the one that has been visible longest.

The reported visible time is unreliable (early Leap services put the service's uptime there), so the order of appearance
is kept here. A hand is its id together with its side: a hand whose side changes was mistaken for another one.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, TypeVar


class Identified(Protocol):
    """What a hand must have."""

    @property
    def id(self) -> int:
        """The tracker's number of the hand."""

    @property
    def is_left(self) -> bool:
        """Whether it is a left hand."""


Hand = TypeVar("Hand", bound=Identified)


class HandChoice:
    """Keeps the order in which hands appeared; a hand that is missing in one frame counts as new afterwards."""

    def __init__(self) -> None:
        self._visible: list[tuple[int, bool]] = []

    def choose(self, hands: Iterable[Hand]) -> Hand | None:
        """Returns the hand that has been visible longest, or None without a hand.

        Args:
            hands: the hands of one frame. Of hands that appear in the same frame, the lower id counts as the older
                one, because the tracker counts its ids upwards.
        """
        visible = {(hand.id, hand.is_left): hand for hand in hands}
        staying = [key for key in self._visible if key in visible]
        self._visible = staying + sorted(key for key in visible if key not in staying)
        return visible[self._visible[0]] if self._visible else None

    def reset(self) -> None:
        """Forgets all hands."""
        self._visible = []
