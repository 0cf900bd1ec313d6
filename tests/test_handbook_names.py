"""Names of topics, services, frames and parameters in the handbook exist in the code."""

from __future__ import annotations

import re

import pytest

from tools.reference.sources import ROOT

PAGES = sorted(
    ROOT / "docs" / "handbook" / f"{name}.md"
    for name in ("camera", "control-loops", "engagement", "fingers", "frames", "programs")
)
CODE = (
    *("src/**/src/**/*.py", "src/**/launch/*.launch", "src/**/config/**/*.yaml", "src/**/urdf/*.urdf"),
    "docs/reference/interface.md",  # the ROS graph, with names that the code composes
)
NAME = re.compile(r"[~/]?([a-z][a-z0-9_]*(?:/[a-z0-9_]+)+)")


@pytest.fixture(scope="module")
def code():
    return "\n".join(file.read_text() for pattern in CODE for file in ROOT.glob(pattern))


def names(page: str) -> set[str]:
    """Returns the names in a page's inline code."""
    words = re.findall(r"`([^`\n]+)`", re.sub(r"```.*?```", "", page, flags=re.DOTALL))
    return {match[1] for match in map(NAME.fullmatch, words) if match}


def is_in(code: str, name: str) -> bool:
    """Whether the code has the name, or its last part after a placeholder."""

    def before(text: str) -> set[str]:
        # A pattern that looks behind itself would take ten times as long.
        return {code[match.start() - 1 : match.start()] for match in re.finditer(rf"{text}(?!\w)", code)}

    whole = any(not re.fullmatch(r"[\w/]", character) for character in before(name))
    return whole or not before(f"/{name.split('/')[-1]}").isdisjoint("}>")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_name_is_in_the_code(page, code):
    assert not {name for name in names(page.read_text()) if not is_in(code, name)}


def test_a_name_that_is_not_there_is_found(code):
    assert names("`kuka/status` and `/kuka/states`, `a.py`\n```\n`x/y`\n```\n") == {"kuka/status", "kuka/states"}
    assert is_in(code, "kuka/status")
    assert not is_in(code, "kuka/states")
