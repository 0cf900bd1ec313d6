"""Which of several arms the operator's hand steers, by request or by the region of the Leap's view that the hand is
in. An arm that is not chosen holds its tool, or waits at home. Positions in the Leap frame [m]."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from common.errors import ConfigError
from leap_kuka.config import REGION, SERVICE
from leap_kuka.numbers import CLEARLY_M
from leap_motion.frames import TrackedHand

BOTH = "both"
NOBODY = ""  # no hand has chosen yet


class ChoiceAnswer(NamedTuple):
    """The answer to a request: success, and one sentence about it."""

    success: bool
    sentence: str


class ArmChoice:
    """The choice, `chosen`: an arm, BOTH, or NOBODY, `how` by SERVICE or REGION. The region of an arm is where its
    interaction box, at `boxes` along the Leap's x axis [m], is nearer than the others'. The hand that chooses is the
    one that is in view longest."""

    def __init__(self, how: str, boxes: Mapping[str, float]) -> None:
        self._how = how
        self._boxes = dict(boxes)
        places = sorted(self._boxes.values())
        if how == REGION and any(b - a <= 2.0 * CLEARLY_M for a, b in zip(places, places[1:])):
            listed = ", ".join(f"{arm} {x:g} m" for arm, x in self._boxes.items())
            raise ConfigError([f"leap/arm_choice is {REGION}, but the boxes are too near to each other: {listed}."])
        self.chosen = BOTH if how == SERVICE else NOBODY
        self._hand: tuple[int, bool] | None = None

    def request(self, arm: str) -> ChoiceAnswer:
        """Chooses an arm, or BOTH."""
        if self._how != SERVICE:
            return ChoiceAnswer(False, "Nothing changed: the region that the hand is in chooses the arm.")
        if arm not in (*self._boxes, BOTH):
            return ChoiceAnswer(False, f"Nothing changed: the arm is {arm!r}, but must be {self._names}.")
        self.chosen = arm
        return ChoiceAnswer(True, meaning(arm))

    def see(self, hands: Iterable[TrackedHand]) -> bool:
        """Takes the hands of a frame; returns whether the choice has changed."""
        if self._how != REGION:
            return False
        visible = {(hand.id, hand.is_left): hand for hand in hands}
        if self._hand not in visible:
            self._hand = next(iter(visible), None)
        if self._hand is None:
            return False
        x = float(visible[self._hand].palm[0])
        if not abs(x) < float("inf"):
            return False
        nearest = min(self._boxes, key=lambda arm: abs(x - self._boxes[arm]))
        before = self.chosen
        if before == NOBODY or abs(x - self._boxes[before]) - abs(x - self._boxes[nearest]) > 2.0 * CLEARLY_M:
            self.chosen = nearest
        return self.chosen != before

    @property
    def _names(self) -> str:
        return ", ".join(self._boxes) + f" or {BOTH}"


def meaning(chosen: str) -> str:
    """Returns what a choice means, a sentence."""
    if chosen == NOBODY:
        return "No arm is chosen yet."
    if chosen == BOTH:
        return "Each arm is steered by the hand of its side."
    return f"The hand steers the {chosen} arm; the others hold their tools."


def elsewhere(chosen: str, own: str) -> str | None:
    """Returns why the arm `own` is not steered, a part of a sentence, or None."""
    if chosen in (own, BOTH):
        return None
    return "no arm is chosen yet" if chosen == NOBODY else f"the hand steers the {chosen} arm"
