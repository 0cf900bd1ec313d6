"""Which of the hands in view is the operator's: the one that has been visible longest.

The reported visible time cannot be trusted (early Leap services put the service's uptime there), so the order of
appearance is kept here. A hand is its id together with its side: ids are never reused for another hand, and a hand
whose side changes was mistaken for another one.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, TypeVar


class Identified(Protocol):
    """What a hand must tell of itself."""

    @property
    def id(self) -> int:
        """Of the hand as the tracker counts them."""

    @property
    def is_left(self) -> bool:
        """Whether it is a left hand."""


Hand = TypeVar("Hand", bound=Identified)


class HandChoice:
    """Keeps the order in which hands appeared; a hand that is away for one frame starts anew."""

    def __init__(self) -> None:
        self._seen: list[tuple[int, bool]] = []

    def choose(self, hands: Iterable[Hand]) -> Hand | None:
        """Returns the hand that has been visible longest, or None without a hand.

        Args:
            hands: the hands of one frame, with `id` and `is_left`. Of hands that appear in the same frame the lower
                id counts as the older one, because the tracker counts its ids upwards.
        """
        visible = {(hand.id, hand.is_left): hand for hand in hands}
        staying = [key for key in self._seen if key in visible]
        self._seen = staying + sorted(key for key in visible if key not in staying)
        return visible[self._seen[0]] if self._seen else None

    def reset(self) -> None:
        """Forgets all hands."""
        self._seen = []
