"""The summary of a run of several arms: one for each arm, and what they share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from leap_rig.report import report
from leap_rig.report.recorder import Recorder

SHARED = ("duration_s", "frames_received", "objects", "grasps", "real_time_factor", "processor")


def summarise(
    recorders: Mapping[str, Recorder], now: float, deaths: Iterable[str] = (), remarks: Iterable[str] = ()
) -> dict:
    """Returns the summary of a run until `now` [s] as a mapping that JSON can hold. `recorders`: of each arm by its
    name; an only arm has none, and its summary is that of `report.summarise`. Several arms stand under `arms`, each
    with the keys that it does not share. `faults` and `warnings` begin with the name of the arm that they are of."""
    if len(recorders) == 1:
        return report.summarise(next(iter(recorders.values())), now, deaths, remarks)
    deaths, parts = list(deaths), {arm: report.summarise(recorder, now) for arm, recorder in recorders.items()}
    first, recorder = next(iter(parts.values())), next(iter(recorders.values()))
    shared = {key: first[key] for key in SHARED}
    own = {arm: {key: part[key] for key in part if key not in SHARED} for arm, part in parts.items()}
    faults = [f"A node died: {death}." for death in deaths]
    warnings = [*remarks, *report.slow_world(recorder, first["real_time_factor"])]
    for arm, part in parts.items():
        own[arm]["faults"] = report.follow_faults(part) + report.scenario_faults(part) + report.hand_faults(part)
        began = recorders[arm].started
        own[arm]["warnings"] = report.lost_streams(recorders[arm], now if began is None else began)
        faults += [f"{arm}: {fault}" for fault in own[arm]["faults"]]
        warnings += [f"{arm}: {warning}" for warning in own[arm]["warnings"]]
        del own[arm]["nodes_died"]
    return {**shared, "arms": own, "nodes_died": deaths, "faults": faults, "warnings": warnings}


def as_text(summary: dict) -> str:
    if "arms" not in summary:
        return report.as_text(summary)
    lines = [f"Leap Rig: {summary['duration_s']:.1f} s, arms {' and '.join(summary['arms'])}", ""]
    lines.append(f"  frames received        {summary['frames_received']}")
    lines += report.machine_lines(summary) + report.object_lines(summary)
    for arm, part in summary["arms"].items():
        lines += ["", f"{arm.capitalize()} arm", ""]
        lines += report.count_lines(part) + report.travel_lines(part)
        lines += report.scenario_lines(part) + report.tracking_lines(part)
    lines += ["", *(f"  WARNING: {warning}" for warning in summary["warnings"])]
    lines += [f"  FAULT: {fault}" for fault in summary["faults"]]
    if not summary["faults"]:
        lines.append("  All arms followed and all hands moved, no node died.")
    return "\n".join(lines)
