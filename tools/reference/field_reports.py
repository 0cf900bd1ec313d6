"""The page of reports from other projects, each with the test that answers it."""

from __future__ import annotations

from tools.reference import markdown


def page() -> str:
    """Returns the page."""
    return markdown.generated(
        "Field reports", "docstrings of the tests", "Reports of other projects, and the tests that answer them."
    )
