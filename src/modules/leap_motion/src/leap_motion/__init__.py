"""Client of the Leap Motion service: tracking frames as records; needs numpy and websockets only. `client` keeps the
newest frame, `codec` reads the text of the service, `frames` holds the records. The names load on first use, because
programs that need only the messages import this package too."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from leap_motion.client import LeapClient, LeapCounts, LeapLink, LeapStatus, StampedFrame
    from leap_motion.codec import LeapProtocolError
    from leap_motion.frames import LeapBone, LeapFinger, LeapFrame, LeapHand

__all__ = [
    "LeapBone", "LeapClient", "LeapCounts", "LeapFinger", "LeapFrame", "LeapHand", "LeapLink", "LeapProtocolError",
    "LeapStatus", "StampedFrame",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    for module in ("frames", "codec", "client") if name in __all__ else ():
        found = getattr(importlib.import_module(f"leap_motion.{module}"), name, None)
        if found is not None:
            return found
    raise AttributeError(f"leap_motion has no {name!r}")
