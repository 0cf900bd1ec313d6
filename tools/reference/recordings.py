"""The page of the series of a recording."""

from __future__ import annotations

from tools.reference import markdown, sources

INTRO = """Which series does a [recording](../handbook/record-and-replay.md) hold, in which unit and frame? These are \
the fields of what `leap_rig.recording.read` returns, and the columns of the \
[CSV files](../handbook/recordings-elsewhere.md#csv-and-mcap). Times are seconds since the epoch, by the clock of the \
machine that wrote them; a series of which nothing came has length 0. Poses are matrices, in CSV files position and \
quaternion."""

OTHERS = """Besides: `frames`, the texts of the tracker's service, received by the driver at `frame_times`; \
`manifest`; and `remark`, about a recording that was not completed."""


def page() -> str:
    """Returns the page."""
    sources.on_path()
    from leap_rig.recording import csv_export

    head = markdown.generated("Series of a recording", "leap_rig.recording.csv_export", INTRO)
    return f"{head}\n{markdown.table(*csv_export.table())}\n{OTHERS}\n"
