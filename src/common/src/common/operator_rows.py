"""What the operator is shown, as rows that RViz, the control panel and the headset's page draw alike."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum

OLD_ROWS_S = 1.5  # rows that are older no longer hold [s]
TEXT, TICKS, BARS = "text", "ticks", "bars"  # kinds of rows
NOTHING = "-"
ARM = "Arm"  # name of the row of the arm's controller, which the control panel shows in another place


class RowTone(Enum):
    """What a row means to the operator."""

    GOOD = "good"
    NORMAL = "normal"
    WARNING = "warning"
    FAULT = "fault"
    STALE = "stale"  # old, or never received


COLOURS = {
    RowTone.GOOD: "#2e9e44",
    RowTone.NORMAL: "#1f2933",
    RowTone.WARNING: "#b7791f",
    RowTone.FAULT: "#c62828",
    RowTone.STALE: "#9aa5b1",
}
"""On a light background."""
BRIGHT_COLOURS = {
    RowTone.GOOD: "#5fe07d",
    RowTone.NORMAL: "#ffffff",
    RowTone.WARNING: "#ffc83c",
    RowTone.FAULT: "#ff6b6b",
    RowTone.STALE: "#b4bec8",
}
"""On a dark one."""


@dataclass(frozen=True)
class Row:
    """One row: a name, a text, and ticks or bars with their labels."""

    name: str
    text: str
    tone: RowTone
    kind: str = TEXT
    labels: tuple[str, ...] = ()
    values: tuple[float, ...] = ()  # 0 to 1, of each label: the length of its bar; of a tick 0 or 1


SILENT = (Row("View", "no news from the node operator_view", RowTone.STALE),)


def fraction(value: float) -> float:
    """Returns a value as the length of a bar, 0 to 1; 0 for one that is not finite."""
    return min(max(value, 0.0), 1.0) if math.isfinite(value) else 0.0


def stale(row: Row, text: str) -> Row:
    return replace(row, text=text, tone=RowTone.STALE)


def rows_of(messages: Iterable) -> tuple[Row, ...]:
    """Returns the rows of rig_msgs/OperatorView; a row from another version, with an unknown tone, is a stale one."""
    tones = {tone.value: tone for tone in RowTone}
    return tuple(
        Row(m.name, m.text, tones.get(m.tone, RowTone.STALE), m.kind, tuple(m.labels), tuple(map(fraction, m.values)))
        for m in messages
    )


def plain_text(rows: Iterable[Row], width: int) -> str:
    """Returns the rows as lines of at most `width` characters, ASCII as far as the texts are: of a long text its
    beginning, of ticks those that are missing, and no bars."""
    most_lines = 3
    lines = []
    for row in rows:
        lines += textwrap.wrap(
            f"{row.name}: {row.text}", width, subsequent_indent="    ", max_lines=most_lines, placeholder=" ..."
        )
        missing = [label for label, value in zip(row.labels, row.values) if row.kind == TICKS and not value]
        lines += textwrap.wrap(", ".join(missing), width, initial_indent="  - ", subsequent_indent="    ")
    return "\n".join(lines)
