"""Private parameters of the nodes; apart from them, as the reference page is made without built messages."""

from __future__ import annotations

from dataclasses import dataclass

from common.config import choice, integer, text

COMPATIBLE, CORRECT = "compatible", "correct"


@dataclass(frozen=True)
class DriverConfig:
    """The private parameters of the driver."""

    host: str = text(doc="address of the Leap service", absent="127.0.0.1")
    port: int = integer(low=1, high=65535, doc="its plain WebSocket port", absent=6437)
    code: str = text(doc="code that a service on another machine asks for; empty: none", absent="", empty=True)
    orientation: str = choice(
        COMPATIBLE, CORRECT, doc="bone orientations as the C++ driver fills them, or true ones", absent=COMPATIBLE
    )
    registration: str = text(
        doc="name of a registration by register_tracker.py, whose axes the messages have; empty: the tracker's own",
        absent="",
        empty=True,
    )


@dataclass(frozen=True)
class VisualizerConfig:
    """The private parameters of the visualizer."""

    frame: str = text(
        doc="tf frame of the markers: the driver's own, or in a running rig leap_motion/virtual_frame",
        absent="leap_hands",
    )
