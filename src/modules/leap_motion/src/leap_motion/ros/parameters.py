"""Private parameters of the nodes; apart from them, as the reference page is made without built messages."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from common.config import choice, flag, integer, number, text
from common.frames import frame_name
from leap_motion.client import wire_fault
from leap_motion.plausibility import HandBounds

COMPATIBLE, CORRECT = "compatible", "correct"
BOUNDS = {bound.name: bound for bound in fields(HandBounds)}


def _bound(name: str) -> Any:
    return number(**BOUNDS[name].metadata, absent=BOUNDS[name].default)


@dataclass(frozen=True)
class DriverConfig:
    """The private parameters of the driver."""

    host: str = text(doc="address of the Leap service", absent="127.0.0.1")
    port: int = integer(
        low=1, high=65535, doc="its WebSocket port; with a fingerprint its secure one, as a rule 6436", absent=6437
    )
    code: str = text(doc="code that a service on another machine asks for; empty: none", absent="", empty=True)
    fingerprint: str = text(
        doc="fingerprint of that service's certificate, 64 hexadecimal digits; empty: no TLS", absent="", empty=True
    )
    trust_network: bool = flag(
        doc="take hands from another machine without proof or encryption, as of a tracker's own service", absent=False
    )
    orientation: str = choice(
        COMPATIBLE, CORRECT, doc="bone orientations as the C++ driver fills them, or true ones", absent=COMPATIBLE
    )
    registration: str = text(
        doc="name of a registration by register_tracker.py, whose axes the messages have; empty: the tracker's own",
        absent="",
        empty=True,
    )
    longest_bone: float = _bound("longest_bone")
    bone_change: float = _bound("bone_change")
    knuckle_shift: float = _bound("knuckle_shift")
    joint_speed: float = _bound("joint_speed")
    turn_speed: float = _bound("turn_speed")
    hold: float = _bound("hold")

    @property
    def bounds(self) -> HandBounds:
        """What a hand can be and do; one that is not so is left out."""
        return HandBounds(**{name: getattr(self, name) for name in BOUNDS})

    def faults(self) -> list[str]:
        fault = wire_fault(self.host, self.code, self.fingerprint, self.trust_network)
        return [] if fault is None else [fault]


@dataclass(frozen=True)
class VisualizerConfig:
    """The private parameters of the visualizer."""

    frame: str = text(
        doc="tf frame of the markers: the driver's own, or in a running rig leap_motion/virtual_frame",
        absent="leap_hands",
        taken_as=frame_name,
    )
