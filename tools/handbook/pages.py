"""The markdown pages of the project: their links, anchors and code."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
LINK = re.compile(r"!?\[(?:[^\]]|\][^(])*?\]\(([^)\s]+)\)")
MARKERS = ("real hardware", "running rig", "screen", "slow")
"""Why a block of commands is not run by a test; stands in an HTML comment before the block."""


@dataclass(frozen=True)
class Block:
    """Commands of a page.

    Attributes:
        page: where they stand.
        line: number of the first one.
        text: the commands.
        marker: why no test runs them; empty for those that it runs, None for code that is no block of bash.
    """

    page: Path
    line: int
    text: str
    marker: str | None


def pages() -> list[Path]:
    """Returns all pages: those at the root, docs, and the READMEs beside the sources."""
    found = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("bench/*.md"), *ROOT.glob("cad/**/*.md")]
    found += ROOT.glob("src/**/*.md")
    return sorted(page for page in found if ".venv" not in page.parts)


def links(text: str) -> list[str]:
    """Returns the targets of the links and pictures in a page, without those in code."""
    return LINK.findall(re.sub(r"```.*?```|`[^`\n]*`", "", text, flags=re.DOTALL))


def anchors(text: str) -> set[str]:
    """Returns the anchors of a page's headings, as the repository's web page makes them."""
    found: dict[str, int] = {}
    for heading in re.findall(r"^#{1,6} +(.*?) *$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("\\", "")
        slug = re.sub(r"[^\w\- ]", "", words.lower()).strip().replace(" ", "-")
        found[slug] = found.get(slug, -1) + 1
        if found[slug]:
            found[f"{slug}-{found[slug]}"] = 0
    return set(found)


def bash_blocks(page: Path) -> Iterator[Block]:
    """Yields the fenced blocks of bash of a page."""
    text = page.read_text()
    pattern = re.compile(r"(?:<!-- *([^>]*?) *-->\s*\n)?^( *)```bash\n(.*?)^ *```", re.DOTALL | re.MULTILINE)
    for match in pattern.finditer(text):
        indent = len(match[2])
        commands = "\n".join(line[indent:] for line in match[3].splitlines())
        yield Block(page, text.count("\n", 0, match.start(3)) + 1, commands, match[1] or "")


def code(page: Path) -> Iterator[Block]:
    """Yields all code of a page that may hold commands: blocks, indented lines, and code within sentences."""
    text = page.read_text()
    for match in re.finditer(r"^( *)```(?:bash|sh|)\n(.*?)^ *```", text, re.DOTALL | re.MULTILINE):
        yield Block(page, text.count("\n", 0, match.start(2)) + 1, match[2], None)
    text = re.sub(r"```.*?```", lambda match: "\n" * match[0].count("\n"), text, flags=re.DOTALL)
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("    "):
            yield Block(page, number, line, None)
        else:
            for words in re.findall(r"`([^`]+)`", line):
                yield Block(page, number, words, None)
