"""Measures a cell of the table of bad networks on a running rig."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from campaign.judge import Evidence, Expected, Limits, judge
from campaign.network.cells import CELL_S, Cell, CellResult, unprovoked
from campaign.network.link import CLEAR, CONDITIONS
from common import clock

ITSELF_S, OPERATOR_S = 3.0, 20.0
"""How long the arm may take to follow by itself, and control to be switched on again [s]."""


def run_cell(rig, cell: Cell) -> CellResult:
    """Lets the arm follow a hand while the link is bad, and afterwards until it follows again."""
    before = rig.pids()
    rig.follow(right=-0.06)
    rig.hand.sway(1.0, right=0.06)
    rig.wait(lambda: rig.arm.now.tool_speed > 0.05, "the arm to move")
    rig.modes.clear()
    began, goals, stops = clock.monotonic(), rig.arm.now.goals, rig.arm.now.stops
    counts = _let_pass(rig.wire, cell)
    ended = clock.monotonic()
    goals_per_s = (rig.arm.now.goals - goals) / (ended - began)
    error = tracking_error(rig, began, ended)
    pick_ups = rig.modes.count("pick_up")
    said = "" if rig.mode == "servo" else f"{rig.mode}: {rig.status.reason}"
    recovery, after = _recover(rig)
    clock.sleep(0.1)  # the arm's trace is so far behind
    steps = np.array(list(rig.arm.steps)) if rig.arm.steps else np.zeros((0, 16))
    after_pids = rig.pids()
    died = [name for name, pid in before.items() if after_pids.get(name) != pid]
    expected = Expected("", 1.0, limits=Limits.of_the_drives())  # which hurry behind each late goal
    verdict = judge(expected, Evidence(steps, began, clock.monotonic(), rig.arm.heard, died=died))
    stops = rig.arm.now.stops - stops
    faults = verdict.faults + unprovoked(cell.condition, counts["packets"], counts["lost"])
    if stops:
        faults.append(f"the robot stopped itself {stops} times")
    if recovery == "none":
        faults.append(f"the arm never followed again{rig.situation}")
    return CellResult(
        "failed" if faults else "passed", faults, goals_per_s, error,
        verdict.joint_speed, verdict.joint_acceleration, verdict.tool_speed,
        pick_ups, stops, recovery, after, said, counts["packets"], counts["lost"],
        max((duration for _, duration in rig.arm.pauses), default=0.0), died,
    )  # fmt: skip


def _let_pass(wire, cell: Cell) -> dict[str, int]:
    """Lets the condition pass; returns how many packets came and how many were lost."""
    total = {"packets": 0, "lost": 0}
    end = clock.monotonic() + CELL_S
    wire.set(CLEAR)
    for duration, link in (*CONDITIONS[cell.condition].phases, (0.0, CLEAR)):
        for phase in (link,) if clock.monotonic() < end else (CLEAR,):
            for name, count in wire.set(phase).items():
                total[name] += count
        clock.sleep(max(0.0, min(duration, end - clock.monotonic())))
    return total


def tracking_error(rig, began: float, ended: float) -> float | None:
    """Returns how far the tool was from where it should have been, root mean square [mm]."""
    offset = clock.time() - clock.monotonic()
    stamps = np.array(rig.desired_at[:]) - offset
    desired = np.array([T[:3, 3] for T in rig.desired[: len(stamps)]])
    samples = rig.arm.since(began - 1.0)
    within = (stamps > began) & (stamps < ended)
    if not within.any() or not samples:
        return None
    times, tools = np.array([s.time for s in samples]), np.array([s.T_base_tool[:3, 3] for s in samples])
    true = np.column_stack([np.interp(stamps[within], times, tools[:, k]) for k in range(3)])
    return float(1e3 * np.sqrt(np.mean(np.sum((true - desired[within]) ** 2, axis=1))))


def _recover(rig) -> tuple[str, float]:
    """Waits until the arm follows again; returns what it took and how long [s]."""
    ended = clock.monotonic()
    followed_on = all(mode == "servo" for mode in rig.modes)

    def follows() -> bool:
        return rig.mode == "servo" and rig.arm.now.tool_speed > 0.05

    def hand_in_again() -> bool:
        rig.hand.show(right=-0.06)
        shown = _within(lambda: rig.mode == "servo", OPERATOR_S)
        rig.hand.sway(1.0, right=0.06)
        return shown

    def control_off_and_on() -> bool:
        rig.hand.hide()
        on = _within(lambda: rig.control(False).success and rig.control(True).success, OPERATOR_S)
        return on and _within(lambda: rig.mode == "home", OPERATOR_S) and hand_in_again()

    ways: list[tuple[str, Callable[[], bool]]] = [
        ("followed on" if followed_on else "by itself", lambda: True),
        ("hand in again", hand_in_again),
        ("control off and on", control_off_and_on),
    ]
    if rig.mode == "stopped":  # latched: nothing else helps
        ways = ways[2:]
    for way, act in ways:
        if act() and _within(follows, ITSELF_S):
            return way, clock.monotonic() - ended
    return "none", clock.monotonic() - ended


def _within(condition: Callable[[], bool], seconds: float) -> bool:
    """Waits for a condition, no longer than an operator would: these times are part of the measure, on any machine."""
    end = clock.monotonic() + seconds
    while not condition():
        if clock.monotonic() >= end:
            return False
        clock.sleep(0.02)
    return True
