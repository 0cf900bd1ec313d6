"""The results as a line, a table for the terminal, JSON, and the page of the handbook."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

from campaign.trial import Row

ROOT = str(Path(__file__).parents[1])
OF_THE_RUN = re.compile(rf"\x1b\[\d*m|\[\d+\.\d+\]:? ?|{re.escape(ROOT)}/|/tmp/[^\s\"']*/")
"""What a message says of the run alone: colours, times of the log, folders."""

HEAD = """# The campaign

The campaign provokes {rows} of the {catalogue} faults of a catalogue on the running simulated rig: simulated devices on
their wires, real nodes, a real ROS master. What the arm did is read from the simulated arm, every millisecond on its
control port, not from the controller under test. `make campaign` makes this page; `make campaign ONLY=1,8` runs two
rows.

| reaction | meaning |
| --- | --- |
| H | decelerate within limits and hold |
| D | leave the hand: the arm stays or goes home by a planned motion, and follows again only after a deliberate start |
| S | leave servo mode cleanly |
| L | latched, the operator resets it |
| R | refuse, with the reason |

Joint speeds are fractions of the data sheet's, accelerations those of joint 1, of the faster joints in proportion, as
means over 20 ms. They are the largest from the fault to the end of the row, recovery included. A goal that comes late
is caught up with by the drives, at up to 17.2 rad/s²; over 80 ms no row may exceed 14.5 rad/s².

*virtual* is the reaction time in virtual time, in which tests run the rows, too (`python -m campaign.run --virtual`):
it is exact, and judged there. On the real rig it depends on the machine. What the rig said is in
docs/campaign.json.
"""
CATALOGUE = 93  # faults; a row has the number of its fault


def as_json(results: dict[str, dict]) -> str:
    """Returns the results by row as JSON, a row on a line."""
    ordered = sorted(results.items(), key=lambda item: int(item[0]))
    lines = (f'"{number}": {json.dumps(_rounded(result), sort_keys=True)}' for number, result in ordered)
    return "{\n" + ",\n".join(lines) + "\n}\n"


def times_as_json(times: dict[str, float | None]) -> str:
    """Returns reaction times by row as JSON, a row on a line."""
    ordered = sorted(times.items(), key=lambda item: int(item[0]))
    lines = (f'"{number}": {json.dumps(time and round(time, 3))}' for number, time in ordered)
    return "{\n" + ",\n".join(lines) + "\n}\n"


def line(entry: Row, result: dict) -> str:
    """Returns one line for the terminal."""
    reaction = result.get("reaction_s")
    time = "" if reaction is None else f" after {reaction:.2f} s"
    text = f"{entry.number:3d} {result['result']:6} {entry.expected.reactions:3}{time} {entry.fault}"
    return "\n".join([text, *(f"      {fault}" for fault in result["faults"])])


def table(entries: dict[int, Row], results: dict[int, dict]) -> str:
    """Returns the table for the terminal."""
    rows = [" row result reaction [s] speed  acc. tool [m/s] took fault"]
    for number, result in results.items():
        reaction = result.get("reaction_s")
        rows.append(
            f"{number:4d} {result['result']:6} {entries[number].expected.reactions:3} "
            f"{'' if reaction is None else f'{reaction:.2f}':>8} {result.get('joint_speed', 0.0):5.2f} "
            f"{result.get('joint_acceleration', 0.0):5.1f} {result.get('tool_speed', 0.0):10.2f} "
            f"{result['seconds']:4.0f} {entries[number].fault}"
        )
    counts = Counter(result["result"] for result in results.values())
    return "\n".join([*rows, ", ".join(f"{count} {what}" for what, count in sorted(counts.items()))])


def page(entries: dict[int, Row], results: dict[str, dict], times: dict[str, float | None]) -> str:
    """Returns the handbook's page, with the reaction times in virtual time [s]."""
    lines = [
        HEAD.format(catalogue=CATALOGUE, rows=len(entries)),
        "| row | fault | reaction | result | time [s] | virtual [s] | joint speed | "
        "acceleration [rad/s²] | tool [m/s] |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for number, entry in entries.items():
        result = _rounded(results[str(number)]) if str(number) in results else None
        if result is None:
            cells = ["not run", "", _time(times.get(str(number))), "", "", ""]
        else:
            cells = [
                result["result"],
                _time(result.get("reaction_s")),
                _time(times.get(str(number))),
                *(f"{result.get(key, 0.0):.2f}" for key in ("joint_speed", "joint_acceleration", "tool_speed")),
            ]
        lines.append("| " + " | ".join([str(number), entry.fault, " ".join(entry.expected.reactions), *cells]) + " |")
    notes = [f"- Row {entry.number}: {entry.instead}" for entry in entries.values() if entry.instead]
    notes += [f"- Row {entry.number} has no virtual time: {entry.real}." for entry in entries.values() if entry.real]
    notes += [
        f"- Row {entry.number} differs from the catalogue: [why](../decisions/{entry.argued})."
        for entry in entries.values()
        if entry.argued
    ]
    dangerous = [f"- {entry.number}, {entry.fault}: {entry.dangerous}" for entry in entries.values() if entry.dangerous]
    if notes:
        lines += ["", "## Notes", "", *notes]
    lines += ["", "## The most dangerous rows", "", "`make campaign ONLY=dangerous` runs these:", "", *dangerous]
    return "\n".join(lines) + "\n"


def _time(seconds: float | None) -> str:
    return "" if seconds is None else f"{seconds:.2f}"


def _rounded(result: dict) -> dict:
    def plain(value: Any) -> Any:
        if isinstance(value, str):
            return OF_THE_RUN.sub("", value)
        return round(value, 3) if isinstance(value, float) else value

    return {key: plain(value) for key, value in result.items()}
