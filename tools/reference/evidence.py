"""The page of the evidence for the safety case: the tests and campaign rows that show what is done about a hazard."""

from __future__ import annotations

from tools.reference import markdown


def page() -> str:
    """Returns the page."""
    return markdown.generated(
        "Safety evidence",
        "the marks at the tests and rows",
        "What shows each line of the [safety case](../handbook/safety-case.md).",
    )
