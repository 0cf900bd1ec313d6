"""The summary of a run: plain numbers for a JSON file, one screen of text, and the faults."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from common.hand_delay import hand_delay
from common.reasons import ReasonCode
from leap_rig.report.recorder import ObjectTrack, Recorder, TrackingErrors

SLOW_WORLD = 0.95
"""Below this fraction of the requested speed of the world, the machine is too slow."""
FULL = 0.95
"""Above this fraction in use the processors are full, and programs wait for each other."""
TUTORIAL = "tutorial"  # a scenario that lifts nothing
HAND_OVER = "hand_over"
LEAST_LIFT_MM = {"pick_cup": 195.0, "two_cups": 195.0, HAND_OVER: 100.0}
"""The scenario lifts an object by 20 cm, a long box at one end by 15 cm, of which the other end hangs lower; the
simulated operator tolerates an error of 4 mm.
"""
SCENARIO_KEYS = (
    "scenario", "step", "failure", "thing", "giver", "taker", "smallest_mm", "held_s", "way_back",
    "clutched", "travel_mm", "engagement_step_mm", "rounds", "good", "taken",
)  # fmt: skip
COUNTERS = {
    "servo_goals_sent": ("kuka_control", "goals_sent"),
    "pickups": ("kuka_control", "pickups"),
    "returns_home": ("kuka_control", "returns"),
    "workspace_clips": ("kuka_control", "workspace_clips"),
    "ik_failures": ("kuka_control", "ik_failures"),
    "safety_stops": ("simulation", "stops"),
    "hand_commands": ("leap_hand", "commands_sent"),
}
"""Counters in the summary: their source and its name for them."""


def summarise(recorder: Recorder, now: float, deaths: Iterable[str] = (), remarks: Iterable[str] = ()) -> dict:
    """Returns the summary of a run until `now` [s] as a mapping that JSON can hold. `faults` lists why the run failed,
    with a clause for each node that died; `warnings`, with the remarks, do not make it fail."""
    began = recorder.started if recorder.started is not None else now
    # The seconds of the simulated world in a second of the run; None without a world.
    world, wall = (recorder.count("simulated_world", name) for name in ("world_s", "wall_s"))
    factor = round(world / wall, 3) if world is not None and wall else None
    counts = {name: recorder.count(*counter) for name, counter in COUNTERS.items()}

    def since(time: float | None) -> float | None:
        return None if time is None else round(time - began, 2)

    summary: dict[str, Any] = {
        "duration_s": since(now),
        "teleoperated": recorder.teleoperated,
        "frames_received": recorder.frames,
        "streams": [
            {"started_s": since(s.started), "stopped_s": since(s.stopped), "reason": s.reason} for s in recorder.streams
        ],
        **{name: None if count is None else round(count) for name, count in counts.items()},
        "largest_tcp_speed_mm_s": recorder.largest_tcp_speed and round(1e3 * recorder.largest_tcp_speed, 1),
        "tool_path_m": round(recorder.tool_path, 3),
        "tracking_error": {"desired": _errors(recorder.desired), "commanded": _errors(recorder.commanded)},
        "hand_travel_rad": recorder.hand_travel,
        "delay_ms": _delays(recorder.stamps, recorder.stage_times),
        "hand_to_arm_ms": _hand_to_arm(recorder),
        "objects": {name: _object(track, since) for name, track in recorder.objects.items()},
        "scenario": recorder.scenario
        and {key: value for key, value in recorder.scenario.items() if key in SCENARIO_KEYS},
        "grasps": [_grasp(values) for values in recorder.grasps.values()],
        "real_time_factor": factor,
        "processor": _processor(recorder.loads),
        "nodes_died": list(deaths),
    }
    summary["faults"] = _faults(summary)
    summary["warnings"] = [*remarks, *slow_world(recorder, factor), *lost_streams(recorder, began)]
    return summary


def slow_world(recorder: Recorder, factor: float | None) -> list[str]:
    wanted = float(recorder.counters.get("simulated_world", {}).get("speed") or "nan")
    if factor is None or not factor < SLOW_WORLD * wanted:
        return []
    return [
        f"The machine is too slow for the simulated world: {factor:.2f} s of it passed in a second instead of "
        f"{wanted:g}; arm and objects moved in slow motion, and delays and tracking errors are the machine's."
    ]


def _processor(loads: list[tuple[float, float]]) -> dict | None:
    """Returns how much of all processors was in use [%], and for how many of the seconds they were full."""
    if not loads:
        return None
    used = 100.0 * np.array([load for _, load in loads])
    return {
        "median_percent": round(float(np.median(used)), 1),
        "max_percent": round(float(used.max()), 1),
        "full_s": int(np.sum(used > 100.0 * FULL)),
    }


def lost_streams(recorder: Recorder, began: float) -> list[str]:
    # What the processors did so long before and after the loss of a stream can be its cause [s].
    around_s = 2.0
    lost = []
    for stream in recorder.streams:
        if stream.stopped is not None and ReasonCode.TRACKER_SILENT in stream.codes:
            around = [load for time, load in recorder.loads if abs(time - stream.stopped) <= around_s]
            lost += [(stream.stopped - began, max(around))] if around and max(around) > FULL else []
    if not lost:
        return []
    times = ", ".join(f"{time:.1f} s" for time, _ in lost)
    return [
        f"The stream was lost at {times} while {100.0 * min(load for _, load in lost):.0f} % of the processors were in "
        "use: frames came too late. End other programs, or leave out the camera (ARGS=camera:=false) or the screen "
        "(HEADLESS=1)."
    ]


def _clutch_faults(scenario: dict[str, str]) -> list[str]:
    least_travel_mm = 200.0  # of the scenarios with a clutch, whose hand reaches 80 mm
    most_engagement_step_mm = 5.0
    name, travel, step = scenario["scenario"], float(scenario["travel_mm"]), float(scenario["engagement_step_mm"])
    faults = []
    if travel < least_travel_mm:
        faults.append(f"The scenario {name} moved the tool by only {travel:.0f} mm instead of {least_travel_mm:g} mm.")
    if step > most_engagement_step_mm:
        faults.append(f"The tool moved by {step:.1f} mm at an engagement of the scenario {name}.")
    return faults


def _faults(summary: dict) -> list[str]:
    faults = [f"A node died: {death}." for death in summary["nodes_died"]]
    return faults + follow_faults(summary) + scenario_faults(summary) + hand_faults(summary)


def _held_back(scenario: dict[str, str] | None) -> bool:
    """Returns whether the collision guard holds the arm back, on purpose."""
    return scenario is not None and scenario["scenario"] == "wall"


def _followed(summary: dict) -> bool:
    # Least path of the tool while a hand steers it.
    arm_followed_m = 0.005
    return bool(summary["servo_goals_sent"]) and summary["tool_path_m"] >= arm_followed_m


def follow_faults(summary: dict) -> list[str]:
    # Largest median distance to the commanded tool.
    following_error_m = 0.05
    error = summary["tracking_error"]["commanded"]
    if not _followed(summary):
        return ["The arm never followed a hand."] if summary["teleoperated"] else []
    held_back, median = _held_back(summary["scenario"]), error["median_mm"]
    if not held_back and median is not None and median > 1e3 * following_error_m:
        return [f"The arm did not follow: its median distance was {median:.0f} mm."]
    return []


def scenario_faults(summary: dict) -> list[str]:
    faults, scenario = [], summary["scenario"]
    if scenario is not None and scenario["step"] != "done":
        why = scenario["failure"] or f"it ended at step {scenario['step']!r}"
        faults.append(f"The scenario {scenario['scenario']} was not finished: {why}.")
    elif scenario is not None and "clutched" in scenario:
        faults += _clutch_faults(scenario)
    elif scenario is not None and "good" in scenario:
        if scenario["good"] != scenario["rounds"]:
            faults.append("The scenario {scenario} lifted the cup in {good} of {rounds} rounds.".format(**scenario))
    elif scenario is not None and not _held_back(scenario) and scenario["scenario"] != TUTORIAL:
        seen = summary["objects"]
        meant = [seen[name] for name in ([scenario["thing"]] if "thing" in scenario else seen) if name in seen]
        lifts = [thing["lifted_mm"] for thing in meant if thing["picked_and_placed"]]
        name, least = scenario["scenario"], LEAST_LIFT_MM.get(scenario["scenario"], 0.0)
        if not lifts:
            faults.append(f"The scenario {name} picked up and put down nothing.")
        elif max(lifts) < least:
            faults.append(f"The scenario {name} lifted by only {max(lifts):.0f} mm instead of {least:.0f} mm.")
        if name == HAND_OVER:
            faults += _hand_over_faults(scenario, meant)
    for grasp in summary["grasps"]:
        seen = summary["objects"].get(grasp["object"])
        if grasp["held"] and not (seen and seen["picked_and_placed"]):
            faults.append(f"The {grasp['object']} of grasp {grasp['round']} does not stand on the table again.")
    return faults


def _hand_over_faults(scenario: dict[str, str], meant: list[dict]) -> list[str]:
    """Returns whether the object was not held by the giver, then by both, and last by the taker."""
    giver, taker = scenario["giver"], scenario["taker"]
    held = [held["hands"] for thing in meant for held in thing.get("held_by", [])]
    if held and held[0] == [giver] and held[-1] == [taker] and sorted((giver, taker)) in held:
        return []
    by = ", then ".join(" and ".join(hands) for hands in held) or "nobody"
    return [f"The {scenario['thing']} was not handed over from {giver} to {taker}: it was held by {by}."]


def hand_faults(summary: dict) -> list[str]:
    scenario = summary["scenario"]
    arm_only = scenario is not None and (_held_back(scenario) or "clutched" in scenario)
    if summary["teleoperated"] and not arm_only and (not summary["hand_commands"] or not _hand_moved(summary)):
        return ["The robot hand never moved."]
    return []


def _hand_moved(summary: dict) -> bool:
    # Least travel of some finger.
    hand_moved_rad = 0.1
    return max(summary["hand_travel_rad"], default=0.0) >= hand_moved_rad


def _grasp(values: dict[str, str]) -> dict:
    def number(key: str, factor: float) -> float | None:
        return round(factor * float(values[key]), 1) if values[key] else None

    return {
        "round": int(values["round"]),
        "object": values["object"],
        "proposals_seen": int(values["proposals"]),
        "executed": int(values["executed"]),
        "refused": values["refused"],
        "failed": values["failed"],
        "correction_mm": number("correction_m", 1e3),
        "correction_deg": number("correction_rad", np.degrees(1.0)),
        "lifted_mm": number("lifted_m", 1e3),
        "held": {"true": True, "false": False}.get(values["held"]),
        "outcome": values["outcome"],
    }


def _grasp_lines(grasp: dict) -> list[str]:
    what = grasp["object"] or "nothing"
    lines = [f"    {grasp['round']}: {what}; proposals seen: {grasp['proposals_seen']}, executed: {grasp['executed']}"]
    lines += [f"       {kind}: {grasp[kind]}" for kind in ("refused", "failed") if grasp[kind]]
    if grasp["correction_mm"] is not None:
        lines.append(
            f"       corrected by hand by {grasp['correction_mm']:.0f} mm and {grasp['correction_deg']:.0f} deg, "
            f"lifted {grasp['lifted_mm']:.0f} mm"
        )
    if grasp["held"] is not None:
        lines.append(f"       {'held' if grasp['held'] else 'not held'}: {grasp['outcome']}")
    return lines


def _object(track: ObjectTrack, since: Callable[[float | None], float | None]) -> dict:
    held: dict[str, Any] = {}
    if track.held_by:
        held["held_by"] = [{"from_s": since(time), "hands": list(hands)} for time, hands in track.held_by]
        held["at_m"] = [round(value, 3) for value in track.at or ()]
    return {
        **held,
        "picked_and_placed": track.picked_and_placed,
        "left_the_table_s": since(track.lifted),
        "lifted_mm": round(1e3 * track.highest, 1),
        "put_down_s": since(track.put_down),
        "moved_mm": round(1e3 * track.moved, 1),
        "tilt_deg": round(float(np.degrees(track.tilt)), 1),
        "fell": track.fell,
    }


def _object_line(name: str, seen: dict) -> str:
    if seen["fell"]:
        return f"    {name}: fell off the table"
    if seen["left_the_table_s"] is None:
        return f"    {name}: stayed on the table, moved by {seen['moved_mm']:.0f} mm"
    lifted = f"    {name}: left the table at {seen['left_the_table_s']:.1f} s, was lifted {seen['lifted_mm']:.0f} mm"
    for held in seen.get("held_by", []):
        lifted += f", held by {' and '.join(held['hands'])} from {held['from_s']:.1f} s"
    if seen["put_down_s"] is None:
        return f"{lifted}, was not put down"
    at = "at x {:.2f}, y {:.2f} m, ".format(*seen["at_m"]) if "at_m" in seen else ""
    return (
        f"{lifted}, put down at {seen['put_down_s']:.1f} s, {at}{seen['moved_mm']:.0f} mm from where it stood, "
        f"tilted by {seen['tilt_deg']:.0f} deg"
    )


def _errors(errors: TrackingErrors) -> dict:
    if not errors.distance:
        return {**dict.fromkeys(("rms_mm", "median_mm", "max_mm", "rms_deg", "max_deg")), "samples": 0}
    distance, angle = 1e3 * np.array(errors.distance), np.degrees(errors.angle)
    return {
        "rms_mm": round(float(np.sqrt(np.mean(distance**2))), 2),
        "median_mm": round(float(np.median(distance)), 2),
        "max_mm": round(float(distance.max()), 2),
        "rms_deg": round(float(np.sqrt(np.mean(angle**2))), 3),
        "max_deg": round(float(angle.max()), 3),
        "samples": len(distance),
    }


def _delays(stamps: dict[float, float], times: dict[str, dict[float, float]]) -> dict:
    """Returns percentiles of the delay of each stage, and of the two wires after the received frame. What the tracker's
    service kept a frame is not ours: it is the first line, and no part of the last two."""
    received = times["received"]
    spans = {
        "Leap service: frame sent late": (stamps, received),
        "leap_motion: received to published": (received, times["leap_motion"]),
        "leap_kuka: published to desired tool": (times["leap_motion"], times["leap_kuka"]),
        "kuka_control: desired tool to goal sent": (times["leap_kuka"], times["kuka_control"]),
        "frame received to goal on the arm's wire": (received, times["kuka_control"]),
        "frame received to command of the hand": (received, times["leap_hand"]),
    }
    return {name: _percentiles([end[s] - begin[s] for s in end if s in begin]) for name, (begin, end) in spans.items()}


def _hand_to_arm(recorder: Recorder) -> dict | None:
    """Returns the delay of the tool behind the palm over windows of four seconds, None where too little moved."""
    delay = hand_delay(recorder.palms, recorder.tools)
    if delay is None:
        return None
    low, p50, high = np.round(1e3 * np.array([delay.low, delay.median, delay.high]), 1).tolist()
    return {"p50": p50, "p10": low, "p90": high, "windows": delay.windows}


def _percentiles(seconds: list[float]) -> dict:
    if not seconds:
        return {"p50": None, "p95": None, "p99": None, "samples": 0}
    p50, p95, p99 = np.round(1e3 * np.percentile(seconds, (50, 95, 99)), 2).tolist()
    return {"p50": p50, "p95": p95, "p99": p99, "samples": len(seconds)}


def as_text(summary: dict) -> str:
    lines = [f"Leap Rig: {summary['duration_s']:.1f} s", "", f"  frames received        {summary['frames_received']}"]
    lines += count_lines(summary) + machine_lines(summary) + travel_lines(summary) + scenario_lines(summary)
    lines += (
        object_lines(summary)
        + tracking_lines(summary)
        + ["", *(f"  WARNING: {warning}" for warning in summary["warnings"])]
    )
    lines += [f"  FAULT: {fault}" for fault in summary["faults"]]
    if not summary["faults"]:
        hand = "the hand moved, " if _hand_moved(summary) else ""
        what = "The arm followed" if _followed(summary) else "No node moved the arm by the desired tool frame"
        lines.append(f"  {what}, {hand}no node died.")
    return "\n".join(lines)


def count_lines(summary: dict) -> list[str]:
    lines = [f"  streams                {len(summary['streams'])}"]
    for stream in summary["streams"][-6:]:
        stopped = "end" if stream["stopped_s"] is None else f"{stream['stopped_s']:.1f} s"
        lines.append(f"    {stream['started_s']:6.1f} s to {stopped:>7}: {stream['reason']}"[:100])
    rows = (
        ("servo goals sent", "servo_goals_sent"), ("pick-ups by PTP", "pickups"), ("returns home", "returns_home"),
        ("workspace clips", "workspace_clips"), ("unreachable goals", "ik_failures"), ("safety stops", "safety_stops"),
        ("largest TCP speed", "largest_tcp_speed_mm_s"), ("hand commands", "hand_commands"),
    )  # fmt: skip
    for label, key in rows:
        value = summary[key]
        unit = " mm/s" if key.endswith("mm_s") and value is not None else ""
        lines.append(f"  {label:<22} {'unknown' if value is None else value}{unit}")
    return lines


def machine_lines(summary: dict) -> list[str]:
    """Returns the lines about world and processors, as far as they are known."""
    lines = []
    if summary["real_time_factor"] is not None:
        lines.append(f"  {'real-time factor':<22} {summary['real_time_factor']:.2f} (the world's seconds in a second)")
    processor = summary["processor"]
    if processor is not None:
        used = f"{processor['median_percent']:.0f} % in use (largest {processor['max_percent']:.0f} %)"
        lines.append(f"  processors             {used}; full for {processor['full_s']} s")
    return lines


def travel_lines(summary: dict) -> list[str]:
    return [f"  hand travel            {summary['hand_travel_rad']} rad (index, middle, thumb, spread)"]


def scenario_lines(summary: dict) -> list[str]:
    lines = []
    if summary["scenario"] is not None:
        lines.append(f"  scenario               {summary['scenario']['scenario']}: {summary['scenario']['step']}")
        if "giver" in summary["scenario"]:
            lines.append("  handed over            {thing}, from {giver} to {taker}".format(**summary["scenario"]))
        if "way_back" in summary["scenario"]:
            lines.append(
                "  collision guard        smallest distance {smallest_mm} mm, held for {held_s} s, way back taken: "
                "{way_back}".format(**summary["scenario"])
            )
        if "good" in summary["scenario"]:
            lines.append("  lifted                 in {good} of {rounds} rounds".format(**summary["scenario"]))
        if "taken" in summary["scenario"]:
            lines.append("  the operator took over in {taken} of them".format(**summary["scenario"]))
        if "clutched" in summary["scenario"]:
            text = "clutched {clutched} times, tool travel {travel_mm} mm, largest step at an engagement "
            lines.append(f"{'':25}{text.format(**summary['scenario'])}{summary['scenario']['engagement_step_mm']} mm")
    return lines


def object_lines(summary: dict) -> list[str]:
    lines = []
    if summary["grasps"]:
        lines += ["", "  grasps", *(line for grasp in summary["grasps"] for line in _grasp_lines(grasp))]
    if summary["objects"]:
        lines += ["", "  objects", *(_object_line(name, seen) for name, seen in summary["objects"].items())]
    return lines


def tracking_lines(summary: dict) -> list[str]:
    lines = ["", "  tool tracking error       rms mm   max mm  rms deg  max deg  samples"]
    for name, e in summary["tracking_error"].items():
        numbers = " ".join(_cell(e[k]) for k in ("rms_mm", "max_mm", "rms_deg", "max_deg"))
        lines.append(f"    to the {name:<15}  {numbers} {e['samples']:8d}")
    lines += ["", "  delay [ms]                                    p50      p95      p99  samples"]
    for name, d in summary["delay_ms"].items():
        numbers = " ".join(_cell(d[k]) for k in ("p50", "p95", "p99"))
        lines.append(f"    {name:<40} {numbers} {d['samples']:8d}")
    hand = summary["hand_to_arm_ms"]
    if hand is not None:
        interval = f"{hand['p10']:.0f} to {hand['p90']:.0f} ms in 80 % of {hand['windows']} windows"
        lines.append(f"  hand to arm            {hand['p50']:.0f} ms from the palm's motion to the tool's; {interval}")
    return lines


def _cell(value: float | None) -> str:
    return f"{'-' if value is None else f'{value:.2f}':>8}"
