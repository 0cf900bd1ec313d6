"""What can go wrong between a program and the hand."""

from __future__ import annotations


class ReflexError(Exception):
    """Base of the errors of this package."""


class WireFault(ReflexError):
    """The network interface is missing or down, or the port is taken."""


class HandSilent(ReflexError):
    """No packet came from the hand for `seconds`; `foreign`: a sentence about what came instead, or empty."""

    def __init__(self, interface: str, seconds: float, foreign: str = "") -> None:
        silent = f"No packet from the hand on {interface} for {seconds:.1f} s"
        cure = f". {foreign}" if foreign else "; check its power, its cable and the interface."
        super().__init__(silent + cure)
        self.interface = interface
        self.seconds = seconds


class CommandRefused(ReflexError):
    """The hand would not follow the command, so nothing was sent; the message is the `reason`."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class CalibrationFileError(ReflexError):
    """A calibration file cannot be read or written, or holds something else; `faults` has one sentence per fault."""

    def __init__(self, *faults: str) -> None:
        super().__init__(" ".join(faults))
        self.faults = faults
