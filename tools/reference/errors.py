"""The page of error messages: each sentence of the code with its cause and cure, which errors.yaml holds."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import yaml

from tools.reference import markdown, messages_in_code, sources
from tools.reference.messages_in_code import Sentence

CURES = sources.REFERENCE / "errors.yaml"
DEFECT = (
    "A fault of the program, or of one that uses it as a library: no file, device or argument leads here.",
    "Report it with all that the program said.",
)
"""Cause and cure of what the yaml lists as defects."""


@dataclass(frozen=True)
class Entry:
    """What errors.yaml says about some sentences of a package.

    Attributes:
        parts: of the sentences.
        cause: empty for a state that needs no cure.
        cure: likewise.
    """

    parts: tuple[str, ...]
    cause: str
    cure: str


def read_entries(text: str) -> dict[str, list[Entry]]:
    """Returns the entries of each package in their order."""
    packages: dict[str, list[dict[str, Any]]] = yaml.safe_load(text)
    return {package: [_entry(fields) for fields in entries] for package, entries in packages.items()}


def _entry(fields: dict[str, Any]) -> Entry:
    if "defects" in fields:
        return Entry(tuple(fields["defects"]), *DEFECT)
    return Entry(
        tuple(fields.get("messages", fields.get("states", ()))), fields.get("cause", ""), fields.get("cure", "")
    )


def sort(
    sentences: list[Sentence], entries: dict[str, list[Entry]]
) -> tuple[dict[str, dict[Entry, list[Sentence]]], list[Sentence]]:
    """Returns the sentences by package and entry, and those that no entry fits."""
    sorted_: dict[str, dict[Entry, list[Sentence]]] = defaultdict(lambda: defaultdict(list))
    left = []
    for sentence in sentences:
        package = sources.package(sentence.file)
        fitting = (e for e in entries.get(package, ()) if any(part in sentence.text for part in e.parts))
        entry = next(fitting, None)
        if entry is None:
            left.append(sentence)
        else:
            sorted_[package][entry].append(sentence)
    return sorted_, left


def page() -> str:
    """Returns the page."""
    entries = read_entries(CURES.read_text())
    sorted_, _ = sort(messages_in_code.sentences(), entries)
    parts = [
        markdown.generated(
            "Error messages",
            "the source and docs/reference/errors.yaml",
            f"Every sentence with which a program tells that something is wrong; {messages_in_code.GAP} stands for "
            "what is filled in. Search this page for a few words of what you see. How they are found, and what is not "
            "here: [pages that stay true](../decisions/pages-that-stay-true.md).",
        )
    ]
    for package in entries:
        rows = [
            ["<br>".join(markdown.text(s.text) for s in said), entry.cause, entry.cure, _places(said)]
            for entry in entries[package]
            if entry.cause and (said := sorted_[package].get(entry))
        ]
        parts += [f"## {package}\n", markdown.table(["message", "cause", "cure", "where"], rows)]
    return "\n".join(parts)


def _places(said: list[Sentence]) -> str:
    files = dict.fromkeys(sentence.file for sentence in said)
    return ", ".join(f"[{file.name}](../../{file.relative_to(sources.ROOT)})" for file in files)
