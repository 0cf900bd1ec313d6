"""Client of the ReFlex TakkTile hand on its UDP wire; needs numpy and pyyaml only. `client` is the interface: a
thread over `hand` (the state machine), `transport` (sockets) and `calibration_files`."""

from __future__ import annotations

from reflex.client import ReflexHand
from reflex.errors import CalibrationFileError, CommandRefused, HandSilent, ReflexError, WireFault
from reflex.hand import HandStatus
from reflex.reading import HandReading
from reflex.settings import HandSettings

__all__ = [
    "CalibrationFileError", "CommandRefused", "HandReading", "HandSettings", "HandSilent", "HandStatus", "ReflexError",
    "ReflexHand", "WireFault",
]  # fmt: skip
