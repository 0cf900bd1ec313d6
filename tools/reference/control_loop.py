"""The page of the control loops' states and of the streams they follow, from the tables of both."""

from __future__ import annotations

from enum import Enum

from kuka_control.loop.admission import ADMISSIONS, REFUSALS, Admission
from kuka_control.loop.transitions import (
    PTP_STATES,
    REAL_TIME_STATES,
    TRANSITIONS,
    Action,
    State,
    Trait,
    transitions_among,
)
from tools.reference import markdown

INTRO = (
    "The states of the two controllers of the arm and all transitions between them. The handbook explains "
    "[the control loops](../handbook/control-loops.md); `kuka/mode` and `kuka/status` publish the mode of the state. "
    "A fault ends in `stopped`, which waits until control is switched off and on again."
)

STREAMS = (
    "A stream is a run of desired tool frames without a pause. Only one that counts is followed, and one that ran "
    "before slowly, once that is announced. What has no row changes nothing.\n"
)


def page() -> str:
    """Returns the page."""
    unlike = [f"`{_name(s)}` ({s.mode.value})" for s in State if _name(s) != s.mode.value]
    return "\n".join(
        [
            markdown.generated("States of the control loops", "kuka_control/loop/transitions.py", INTRO),
            f"States with the mode of another one: {', '.join(unlike)}.\n",
            states(),
            diagram(REAL_TIME_STATES),
            f"Only the PTP controller has {_only(PTP_STATES, REAL_TIME_STATES)}; "
            f"only the real-time controller has {_only(REAL_TIME_STATES, PTP_STATES)}. "
            "A motion or servo mode that the robot refuses leads to `stopped`; after `zero` to `ended`.\n",
            "## Which desired tool frame counts\n",
            STREAMS,
            streams(),
        ]
    )


def states() -> str:
    """Returns the table of the states and their traits, and of what follows once the arm has braked."""
    rows = [[f"`{_name(s)}`", *("x" if trait in s.traits else "" for trait in Trait)] for s in State if s.traits]
    after: dict[str, list[str]] = {}
    for row in TRANSITIONS:
        if row.target is State.BRAKING:
            after.setdefault(row.at_rest.value, []).append(row.trigger.value)
    braked = "".join(f"* {rest}: after {'; '.join(triggers)}\n" for rest, triggers in after.items())
    blocked: dict[str, list[str]] = {}
    for row in TRANSITIONS:
        if row.action is Action.PTP or row.target is State.LINE:
            blocked.setdefault(row.if_blocked.text, []).append(f"{row.trigger.value} (to `{_name(row.target)}`)")
    ways = "".join(f"* {what}: after {'; '.join(dict.fromkeys(triggers))}\n" for what, triggers in blocked.items())
    head = ["state", *(trait.value for trait in Trait)]
    return f"{markdown.table(head, rows)}\nWhat ends `braking`:\n\n{braked}\nIf a body is in the way:\n\n{ways}"


def diagram(states: frozenset[State]) -> str:
    """Returns the diagram of the algorithm that has these states; refusals are left to the table."""
    arrows: dict[tuple[State, State], list[str]] = {}
    for (source, trigger), row in transitions_among(states).items():
        if trigger.name != "REFUSED":
            arrows.setdefault((source, row.target), []).append(trigger.value)
    drawn = [f"  {_name(a)} --> {_name(b)}: {', or '.join(triggers)}" for (a, b), triggers in arrows.items()]
    ptp = sorted({_name(row.target) for row in transitions_among(states).values() if row.action is Action.PTP})
    lines = ["```mermaid", "stateDiagram-v2", f"  [*] --> {_name(State.STARTING)}", *drawn]
    lines += [f"  {_name(State.ENDED)} --> [*]", "```"]
    return "\n".join(lines) + f"\n\nA PTP motion runs in {', '.join(f'`{name}`' for name in ptp)}.\n"


def streams() -> str:
    """Returns what happens to a stream, and why it is not followed, the first reason on top."""
    states = markdown.table(("state", "the stream"), ((f"`{_name(state)}`", state.value) for state in Admission))
    rows = []
    for row in ADMISSIONS:
        sources = "any" if len(row.sources) == len(Admission) else ", ".join(f"`{_name(s)}`" for s in row.sources)
        sentence = markdown.text(row.sentence.format(detail="…", anew="…"))
        rows.append((sources, row.event.value, f"`{_name(row.target)}`", sentence))
    table = markdown.table(("state", "what happens", "next", "what the operator reads"), rows)
    refusals = ((row.when, row.where.text) for row in REFUSALS)
    reasons = markdown.table(("the stream is not followed because", "where"), refusals)
    return f"{states}\n{table}\nThe first reason that holds is published:\n\n{reasons}"


def _name(state: Enum) -> str:
    return state.name.lower()


def _only(states: frozenset[State], others: frozenset[State]) -> str:
    return ", ".join(f"`{_name(state)}`" for state in State if state in states and state not in others)
