"""The page of the series of a recording."""

from __future__ import annotations

from tools.reference import markdown


def page() -> str:
    """Returns the page."""
    return markdown.generated(
        "Series of a recording", "the export", "What a [recording](../handbook/recordings-elsewhere.md) holds."
    )
