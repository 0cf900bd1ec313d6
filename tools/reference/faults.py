"""The page of the faults that the simulated devices can be made to have."""

from __future__ import annotations

from tools.reference import markdown, sources


def page() -> str:
    """Returns the page."""
    sources.on_path()
    from rig_simulation.faults.arm import ARM_FAULTS
    from rig_simulation.faults.camera import CAMERA_FAULTS
    from rig_simulation.faults.hand import HAND_FAULTS
    from rig_simulation.faults.leap import LEAP_FAULTS

    rows = []
    for device, faults in (
        ("arm", ARM_FAULTS),
        ("hand", HAND_FAULTS),
        ("leap", LEAP_FAULTS),
        ("camera", CAMERA_FAULTS),
    ):
        for fault in faults:
            v = fault.value
            value = f"{v.doc} ({v.default:g}; {v.low:g} to {v.high:g})" if v else ""
            rows.append([device, markdown.code(fault.name), fault.doc, value])
    head = markdown.generated(
        "Faults of the simulated devices",
        "rig_simulation.faults",
        "How to switch them: [Make a device fail](../faults.md).",
    )
    return f"{head}\n{markdown.table(['device', 'fault', 'what happens', 'value (default; range)'], rows)}"
