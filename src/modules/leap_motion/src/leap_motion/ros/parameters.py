"""Private parameters of the node leap_driver; apart from it, as the reference page is made without built messages."""

from __future__ import annotations

from dataclasses import dataclass

from common.config import choice, integer, text

COMPATIBLE, CORRECT = "compatible", "correct"


@dataclass(frozen=True)
class DriverConfig:
    """The private parameters."""

    host: str = text(doc="address of the Leap service", absent="127.0.0.1")
    port: int = integer(low=1, high=65535, doc="its plain WebSocket port", absent=6437)
    orientation: str = choice(
        COMPATIBLE, CORRECT, doc="bone orientations as the C++ driver fills them, or true ones", absent=COMPATIBLE
    )
