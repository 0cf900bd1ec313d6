"""All faults of all simulated devices, and their table in docs/faults.md."""

from __future__ import annotations

from types import MappingProxyType

from rig_simulation.faults.arm import ARM_FAULTS
from rig_simulation.faults.camera import CAMERA_FAULTS
from rig_simulation.faults.hand import HAND_FAULTS
from rig_simulation.faults.injection import Fault
from rig_simulation.faults.leap import LEAP_FAULTS

FAULTS = MappingProxyType({"arm": ARM_FAULTS, "leap": LEAP_FAULTS, "hand": HAND_FAULTS, "camera": CAMERA_FAULTS})
"""The faults by device, as the service simulation/fault names them."""


def table() -> str:
    """Returns the table in Markdown."""
    rows = ["| device | fault | what happens | value (default; range) |", "| --- | --- | --- | --- |"]
    rows += [
        f"| {device} | `{fault.name}` | {fault.doc} | {_value(fault)} |"
        for device, faults in FAULTS.items()
        for fault in faults
    ]
    return "\n".join(rows) + "\n"


def _value(fault: Fault) -> str:
    value = fault.value
    return f"{value.doc} ({value.default:g}; {value.low:g} to {value.high:g})" if value else ""
