"""The page of reports from other projects, each with the test that tries it here, from the docstrings of the tests."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from tools.reference import markdown, sources

URL = r"https://github\.com/([\w.-]+)/([\w.-]+)/(?:issues|pull)/(\d+)"
REPORT = re.compile(rf"Reported in ((?:{URL}(?:, )?)+): (.*?) Tried: (.*?)\.(?= Reported in|$)")


def page() -> str:
    """Returns the page."""
    rows = [
        [links(urls), said.rstrip("."), tried, f"`{file.relative_to(sources.ROOT)}::{name}`"]
        for pattern in ("src/**/tests/test_*.py", "tests/test_*.py")
        for file in sorted(sources.ROOT.glob(pattern), key=sources.inside)
        for name, urls, said, tried in reports(file.read_text())
    ]
    head = markdown.generated(
        "Field reports",
        "docstrings of the tests",
        "Public reports about tools like these, each tried on this code as a small input. The test holds the answer. "
        "*cannot marshal None*, of a yaml key without a value: "
        "[troubleshooting](../handbook/troubleshooting.md).",
    )
    return f"{head}\n{markdown.table(['report', 'what was reported', 'tried here', 'test'], rows)}"


def reports(code: str) -> Iterator[tuple[str, str, str, str]]:
    """Yields test, addresses, what was reported and what was tried, for each report in the docstrings of a module."""
    if "Reported in " not in code:
        return
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            text = " ".join((ast.get_docstring(node) or "").split())
            for found in REPORT.finditer(text):
                yield node.name, found[1], found[5], found[6]


def links(urls: str) -> str:
    """Returns addresses as links by repository and number."""
    return ", ".join(f"[{found[2]}#{found[3]}]({found[0]})" for found in re.finditer(URL, urls))
