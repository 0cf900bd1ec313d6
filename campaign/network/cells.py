"""The table of bad networks: each condition of a link on each wire of the rig. Pure: results come in, text goes out."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field

from campaign.network.link import CONDITIONS

WIRES = {
    "arm": "the controller's TCP connection to the robot",
    "leap": "the WebSocket of the Leap service",
    "ros": "every connection between two nodes, and to the ROS master",
    "afar": "the way between a relay and the rig, by which a headset's page sends the hands",
}
CELL_S = 20.0  # how long a condition lasts [s]


@dataclass(frozen=True)
class Cell:
    """A condition on a wire."""

    wire: str
    condition: str
    spoils: bool = False

    @property
    def number(self) -> str:
        """Its name, such as arm:loss_5."""
        return f"{self.wire}:{self.condition}"

    @property
    def variant(self) -> str:
        """The rig that it needs; see trial.VARIANTS."""
        return f"shipped/{self.wire}"


def unprovoked(condition: str, packets: int, lost: int) -> list[str]:
    """Returns why a cell shows nothing of its condition, in sentences; none if packets met it."""
    loses = any(link.loss > 0.0 for _, link in CONDITIONS[condition].phases)
    if not packets:
        return ["no packet passed the link, so the cell shows nothing"]
    return ["the link lost no packet, so the cell shows nothing"] if loses and not lost else []


def _is_afar(condition: str) -> bool:
    return condition.startswith("delay_") and "loss" in condition


CELLS = {
    cell.number: cell
    for cell in (Cell(wire, condition) for wire in WIRES for condition in CONDITIONS)
    if _is_afar(cell.condition) is (cell.wire == "afar")
}


@dataclass
class CellResult:
    """What came of a cell. The largest values are those up to the recovery."""

    result: str  # "passed" or "failed"
    faults: list[str]
    goals: float  # on the wire [1/s]
    error_mm: float | None  # from the desired to the true tool, root mean square; None without desired frames
    joint_speed: float  # largest, as a fraction of full speed
    joint_acceleration: float  # largest, of joint 1, in proportion for the others [rad/s^2]
    tool_speed: float  # largest [m/s]
    pick_ups: int
    stops: int  # safety stops of the robot
    recovery: str  # "followed on", "by itself", "hand in again", "control off and on", "none"
    recovery_s: float  # since the end of the condition [s]
    said: str  # by kuka/status at the end of the condition, where the arm did not follow then
    packets: int
    lost: int
    pause_s: float  # longest pause of the machine that was measured on [s]
    died: list[str] = field(default_factory=list)


def chosen(only: str) -> list[Cell]:
    """Returns the cells that `only` names: cells, wires or conditions, or all if it is empty."""
    names = only.replace(",", " ").split() or ([only] if only else [])
    for name in names:
        if name not in (*CELLS, *WIRES, *CONDITIONS):
            raise SystemExit(
                f"There is no cell {name!r}; there are the wires {', '.join(WIRES)}, conditions such as loss_5, "
                "and cells such as arm:loss_5."
            )
    return [cell for cell in CELLS.values() if not names or {cell.number, cell.wire, cell.condition} & set(names)]


def as_json(results: Mapping[str, dict]) -> str:
    """Returns the results by cell as JSON, a cell on a line, in the order of the table."""
    shown = {name: {key: _rounded(value) for key, value in result.items()} for name, result in results.items()}
    lines = (f'"{name}": {json.dumps(shown[name], sort_keys=True)}' for name in CELLS if name in shown)
    return "{\n" + ",\n".join(lines) + "\n}\n"


HEAD = ("goals/s", "error [mm]", "joint speed", "acceleration", "tool [m/s]", "pick-ups", "stops", "recovery", "result")


def figures(result: Mapping) -> list[str]:
    """Returns a result as texts, one for each of HEAD."""
    if "goals" not in result:
        return ["-"] * (len(HEAD) - 1) + [result["result"]]
    error = result["error_mm"]
    return [
        f"{result['goals']:.0f}",
        "-" if error is None else f"{error:.0f}",
        *(f"{result['joint_speed']:.2f}", f"{result['joint_acceleration']:.1f}", f"{result['tool_speed']:.2f}"),
        *(str(result["pick_ups"]), str(result["stops"])),
        result["recovery"] + (f", {result['recovery_s']:.1f} s" if result["recovery"] != "followed on" else ""),
        result["result"],
    ]


def line(name: str, result: Mapping) -> str:
    """Returns a result as a line for the terminal, its faults below."""
    cells = dict(zip(HEAD, figures(result)))
    text = f"{name:22} {cells['result']:6} {cells['goals/s']:>4} goals/s {cells['error [mm]']:>4} mm"
    text += f"  speed {cells['joint speed']} acc. {cells['acceleration']:>4} tool {cells['tool [m/s]']} m/s"
    text += f"  {cells['pick-ups']} pick-ups {cells['stops']} stops  {cells['recovery']}"
    if result.get("pause_s", 0.0) > 0.3:
        text += f"  (the machine paused for {result['pause_s']:.1f} s)"
    return "\n".join([text, *(f"      {more}" for more in (result.get("said"), *result["faults"]) if more)])


def page(results: Mapping[str, dict]) -> str:
    """Returns the handbook's page."""
    lines = [PAGE]
    for wire, what in WIRES.items():
        lines += [f"## {what[0].upper()}{what[1:]}", ""]
        lines += ["| condition | " + " | ".join(HEAD) + " |", "| --- " * (len(HEAD) + 1) + "|"]
        for cell in (each for each in CELLS.values() if each.wire == wire):
            result = results.get(cell.number, {"result": "not run"})
            lines.append(f"| {CONDITIONS[cell.condition].title} | " + " | ".join(figures(result)) + " |")
        lines.append("")
    faults = [f"- {name}: {fault}" for name in CELLS for fault in results.get(name, {}).get("faults", ())]
    return "\n".join([*lines, *(["## Faults", "", *faults, ""] if faults else [])])


PAGE = f"""# Bad networks

The simulated rig as shipped, on links that are bad one at a time: their packets pass a program on a network device,
which delays, loses, reorders, repeats or holds them, in each direction, on the kernel's own TCP. A hand moves to and
fro by 120 mm, 1 s each way; the condition lasts {CELL_S:.0f} s, then the link is good again. `make networks` makes this
page; `make networks ONLY=arm:loss_5` runs a cell, `ONLY=arm` a wire, `ONLY=loss_5` a condition.

- *goals/s*: servo goals that the robot received; *error*: distance from desired to true tool, root mean square.
- *joint speed*, *acceleration*, *tool*: the largest values up to the recovery; speeds of joints as fractions of the
  data sheet's, accelerations [rad/s²] of joint 1, of the faster joints in proportion, means over 20 ms.
- *pick-ups*: motions to a hand that was too far away to follow; *stops*: safety stops of the robot.
- *recovery*: the arm *followed on* in servo mode all the time, or went on *by itself* after the condition, after the
  *hand* was taken out and *in again*, or after *control off and on*.

A cell fails if a limit is exceeded, the robot stops itself, a node dies, or the arm never follows again. The limits:
0.95 of the joint speeds, a tool speed of 0.71 m/s, and an acceleration of 14.5 rad/s² over 80 ms. For less time the
robot's own drives hurry behind a late goal, at up to 17.2 rad/s². The queue in front of 256 kbit/s holds 32 kB, which
is a second. What the rig said is in docs/bad-networks.json.

The last table was made in virtual time, whose TCP has neither segments nor congestion control. The delay
begins while the arm follows, which 200 ms alone ends, as no hand comes meanwhile.
"""


def _rounded(value: object) -> object:
    return round(value, 3) if isinstance(value, float) else value
