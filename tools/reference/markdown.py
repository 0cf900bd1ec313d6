"""Markdown of the generated pages."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Returns a table; bars and line ends in the cells are kept from breaking it."""
    first, *rest = ("| " + " | ".join(_cell(cell) for cell in line) + " |" for line in (head, *rows))
    return "\n".join([first, "|" + "---|" * len(head), *rest]) + "\n"


def code(text: str) -> str:
    """Returns the text as code, which may hold backticks itself; nothing for nothing."""
    if not text:
        return ""
    return f"`` {text} ``" if "`" in text else f"`{text}`"


def text(words: str) -> str:
    """Returns words in which markdown and HTML see nothing of theirs."""
    return re.sub(r"([\\`*_<>\[\]#])", r"\\\1", words)


def generated(title: str, source: str, intro: str) -> str:
    """Returns the head of a page: its title, where it comes from, what it is."""
    return f"# {title}\n\n<!-- Made by `make docs` from {source}; changes here are lost. -->\n\n{intro}\n"


def _cell(words: str) -> str:
    return " ".join(words.split()).replace("|", "\\|")
