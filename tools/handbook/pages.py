"""The markdown pages of the project: their links, anchors and code."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
LINK = re.compile(r"!?\[(?:[^\]]|\][^(])*?\]\(([^)\s]+)\)")
FENCE = re.compile(r"( *)```(\w*)\s*$")
HEADING = re.compile(r"#{1,6} ")
MARK = re.compile(r" *<!-- *([^>]*?) *-->\s*$")

BESIDE_RIG, UNTIL_CTRL_C, REAL_HARDWARE, SLOW, ELSEWHERE = (
    "running rig", "until Ctrl-C", "real hardware", "slow", "run by "
)  # fmt: skip
"""Marks in the comment before a block, separated by commas: how the handbook tests run it, or why not.
`run by ` is followed by FILE or FILE::TEST."""
MARKS = (BESIDE_RIG, UNTIL_CTRL_C, REAL_HARDWARE, SLOW)


@dataclass(frozen=True)
class Block:
    """Commands, or a program, of a page.

    Attributes:
        page: where they stand.
        line: number of the first one.
        text: the commands.
        marks: how tests run them; empty for those that just end by themselves.
        language: "bash" or "python".
        section: number of the heading below which they stand."""

    page: Path
    line: int
    text: str
    marks: tuple[str, ...] = ()
    language: str = "bash"
    section: int = 0

    @property
    def where(self) -> str:
        """Page and line, for messages."""
        return f"{self.page.relative_to(ROOT) if ROOT in self.page.parents else self.page.name}:{self.line}"

    @property
    def why_not(self) -> str:
        """Why the handbook tests skip it: `slow`, `real hardware`, `run by`; empty if they run it."""
        for mark in self.marks:
            if mark in (REAL_HARDWARE, SLOW):
                return mark
            if mark.startswith(ELSEWHERE):
                return ELSEWHERE.strip()
        return ""

    @property
    def commands(self) -> list[str]:
        """The commands one by one, without comments; a backslash continues a line."""
        lines = (re.sub(r"(^|\s)#.*", "", line).strip() for line in self.text.replace("\\\n", " ").splitlines())
        return [line for line in lines if line]


def pages() -> list[Path]:
    """Returns all pages: those at the root, docs, and the READMEs beside the sources."""
    found = [
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/**/*.md"),
        *ROOT.glob("bench/*.md"),
        *ROOT.glob("examples/*.md"),
        *ROOT.glob("cad/**/*.md"),
    ]
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


def generated(page: Path) -> bool:
    """Whether a program writes the page, all of it."""
    return ROOT / "docs" / "reference" in page.parents


def words(text: str) -> int:
    """Returns how many words a page has: what has a letter or digit, without fenced blocks, comments, link targets."""
    text = re.sub(r"^ *```.*?^ *```", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"\]\([^)]*\)", "]", text)
    return sum(bool(re.search(r"[A-Za-z0-9]", word)) for word in text.split())


def blocks(page: Path, languages: tuple[str, ...] = ("bash", "python")) -> Iterator[Block]:
    """Yields the fenced blocks of commands and programs of a page, in order."""
    section, comment, fence = 0, "", None
    found: list[str] = []
    for number, line in enumerate(page.read_text().splitlines(), 1):
        if fence is not None:
            if line.strip() != "```":
                found.append(line[len(fence[1]) :])
                continue
            if fence[2] in languages:
                marks = tuple(filter(None, comment.split(", ")))
                yield Block(page, number - len(found), "\n".join(found), marks, fence[2], section)
            fence, comment, found = None, "", []
        elif FENCE.match(line):
            fence = FENCE.match(line)
        elif line.strip():
            section += bool(HEADING.match(line))
            mark = MARK.match(line)
            comment = mark[1] if mark else ""


def runs(mark: str, block: Block) -> bool:
    """Whether the file after `run by ` exists and has the test; for a page, whether it runs the same commands."""
    name, _, test = mark[len(ELSEWHERE) :].partition("::")
    file = ROOT / name
    if not file.is_file():
        return False
    if file.suffix == ".md":
        ran = {command for other in blocks(file) if not other.why_not for command in other.commands}
        return ran.issuperset(block.commands)
    return re.search(rf"^ *(def|class) {test}\b", file.read_text(), re.MULTILINE) is not None if test else True


def code(page: Path) -> Iterator[Block]:
    """Yields all code of a page that may contain commands: blocks, indented lines, inline code."""
    text = page.read_text()
    for match in re.finditer(r"^( *)```(?:bash|sh|)\n(.*?)^ *```", text, re.DOTALL | re.MULTILINE):
        yield Block(page, text.count("\n", 0, match.start(2)) + 1, match[2])
    text = re.sub(r"```.*?```", lambda match: "\n" * match[0].count("\n"), text, flags=re.DOTALL)
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("    "):
            yield Block(page, number, line)
        else:
            for words in re.findall(r"`([^`]+)`", line):
                yield Block(page, number, words)
