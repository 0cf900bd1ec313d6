"""Private parameters of the driver."""

from __future__ import annotations

from dataclasses import dataclass

from common.config import choice, integer, text

COMPATIBLE, CORRECT = "compatible", "correct"


@dataclass(frozen=True)
class DriverConfig:
    """Of the node leap_driver."""

    host: str = text(doc="address of the Leap service", absent="127.0.0.1")
    port: int = integer(low=1, high=65535, doc="its plain WebSocket port", absent=6437)
    orientation: str = choice(
        COMPATIBLE, CORRECT, doc="bone orientations as the C++ driver fills them, or true ones", absent=COMPATIBLE
    )
