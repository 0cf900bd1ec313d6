"""Real or simulated devices: what a calibration says of them, and which rig may use it. A calibration keeps for ever,
under `simulated`, whether a simulated device took part in it: the simulated camera's serial number is SIMULATED, the
simulated arm and hand listen on this machine alone, the simulated Leap service says what it is. Files from before this
key do not say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from common.config import flag, parse

SIMULATED = "simulated"
"""The key in files, and the simulated camera's serial number."""
WITHOUT_HARDWARE = (
    "Without hardware, launch this and leap_rig.launch, which starts the simulated devices, with sim:=true."
)


def simulated_field() -> Any:
    """The key of a calibration's schema; None where the file does not say."""
    return flag(doc="whether a simulated device took part in the measurement", absent=None)


@dataclass(frozen=True)
class MeasuredWith:
    """The key beside those of others, whose schemas do not have it."""

    simulated: bool | None = simulated_field()


def said_by(values: Mapping[str, Any], prefix: str) -> bool | None:
    """Returns what a file's values say; None: nothing. `prefix` as of `parse`; raises ConfigError for another value."""
    return parse(MeasuredWith, values, prefix, others=values).simulated


def any_simulated(*devices: bool | None) -> bool | None:
    """Returns whether one of the devices that measured is simulated; None if nobody says so and one is unknown."""
    if any(devices):
        return True
    return None if None in devices else False


def refusal(what: str, simulated: bool | None, rig_simulated: bool | None, cure: str) -> str:
    """Returns why a calibration may not be used, in a sentence, or "": a real rig, and one that does not say what it
    is, takes none that was simulated; the simulated rig takes any. `what` begins the sentence, `cure` is one itself."""
    if not simulated or rig_simulated:
        return ""
    return f"{what} was measured with simulated devices, which says nothing of real ones: it is not used. {cure}"


def doubt(what: str, simulated: bool | None, rig_simulated: bool | None) -> str:
    """Returns a warning about a calibration that does not say how it was measured, or ""."""
    if simulated is not None or rig_simulated:
        return ""
    return f"{what} does not say whether it was measured with real devices; if you do not know, measure again."


def origin(simulated: bool | None) -> str:
    """Returns how a calibration was measured, as a part of a sentence."""
    if simulated is None:
        return "with devices that are not known"
    return "with simulated devices" if simulated else "with real devices"
