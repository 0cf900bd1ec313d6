"""The page of the states of an engagement: a diagram and tables, from the table of transitions."""

from __future__ import annotations

from leap_kuka.engagement import TRANSITIONS, EngagementState, EngagementTrigger, When
from tools.reference import markdown

INTRO = (
    "The states in which a hand steers an arm, or does not, and all transitions between them. The handbook explains "
    "[engagement, clutch and hold-to-enable](../handbook/engagement.md); `leap_kuka/state` and `leap_kuka/stream` "
    "publish state and sentence. Where a state has no row for "
    "what happens, nothing changes."
)


STEERS = "a_hand_steers"


def page() -> str:
    """Returns the page."""
    states = ((_name(s), f"{s.tool.value}", s.continues) for s in EngagementState)
    read = (
        (t.happens, markdown.text(t.sentence.replace("{detail}", "…").replace("{hand}", "…")))
        for t in EngagementTrigger
    )
    return "\n".join(
        [
            markdown.generated("States of an engagement", "leap_kuka/engagement.py", INTRO),
            diagram(),
            markdown.table(("state", "the tool", "who steers next"), states),
            markdown.table(("what happens", "what the operator reads"), read),
        ]
    )


def diagram() -> str:
    """Returns the diagram; what leads away from each state in which a hand steers is one arrow from all of them."""
    running = [state for state in EngagementState if state.running]
    arrows: dict[tuple[str, str], dict[When, list[str]]] = {}
    for row in TRANSITIONS:
        together = set(running) <= set(row.sources)
        alone = [_name(state) for state in row.sources if not (together and state.running)]
        for source in [*([STEERS] if together else []), *alone]:
            arrows.setdefault((source, _name(row.target)), {}).setdefault(row.when, []).append(row.trigger.happens)
    inner = {_name(state) for state in running}
    lines = ["```mermaid", "stateDiagram-v2", f"  [*] --> {_name(EngagementState.WAITING)}", f"  state {STEERS} {{"]
    lines += [f"    {_arrow(*key, texts)}" for key, texts in arrows.items() if inner >= {*key}]
    lines += ["  }", *(f"  {_arrow(*key, texts)}" for key, texts in arrows.items() if not inner >= {*key}), "```"]
    return "\n".join(lines) + "\n"


def _arrow(source: str, target: str, texts: dict[When, list[str]]) -> str:
    parts = [
        (f"if {when.value.replace('`', '')}: " if when is not When.ALWAYS else "") + "; ".join(happens)
        for when, happens in texts.items()
    ]
    return f"{source} --> {target}: {'. '.join(parts)}"


def _name(state: EngagementState) -> str:
    return state.name.lower()
