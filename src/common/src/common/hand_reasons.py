"""What arm and robot hand both say of the operator's hand: the same words for the same case."""

from __future__ import annotations

from common.hand_tracking import ANY, LEFT, RIGHT

NO_HAND = {ANY: "no hand is seen", LEFT: "no left hand is seen", RIGHT: "no right hand is seen"}
FOLLOWED = "{hand} is followed"
NOT_SEEN = "{hand} is not seen"
IN_VIEW = "{hand} was in view already; take it away and bring it back"
