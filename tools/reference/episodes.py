"""The page of the files of an episode."""

from __future__ import annotations

from tools.reference import markdown


def page() -> str:
    """Returns the page."""
    return markdown.generated(
        "Episode files", "the episode store", "The files of an episode that [training](../handbook/training.md) reads."
    )
