"""The page of the evidence for the safety case: the tests and campaign rows that show what is done about a hazard."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from tools.reference import markdown, sources
from tools.reference.syntax import dotted

TESTS = ("src/**/tests/test_*.py", "tests/test_*.py")


def page() -> str:
    """Returns the page."""
    head = markdown.generated(
        "Safety evidence",
        "the marks `hazard` of the tests and the `hazards` of the campaign's rows",
        "What shows the measures of each line of the [safety case](../handbook/safety-case.md): tests, and rows of the "
        "[campaign](campaign.md), which provokes faults on the running simulated rig. All of it is on "
        "simulated devices. Lines without a test rest on measures that no test can show.",
    )
    by_test, by_row = tests(), rows()
    lines = []
    for number in sorted({hazard for hazards in (*by_test.values(), *by_row.values()) for hazard in hazards}):
        shown = [f"`{file}::{name}`" for (file, name), hazards in by_test.items() if number in hazards]
        campaign = [f"row {row}" for row, hazards in sorted(by_row.items()) if number in hazards]
        lines.append([str(number), "<br>".join(sorted(shown)), ", ".join(campaign)])
    return f"{head}\n{markdown.table(['hazard', 'tests', 'campaign'], lines)}"


def tests() -> dict[tuple[str, str], list[int]]:
    """Returns the numbers of the hazards by file and name of each test that is marked by some."""
    found = {}
    for file in sorted(path for pattern in TESTS for path in sources.ROOT.glob(pattern)):
        for function, call in _decorators(file, "pytest.mark.hazard"):
            found[file.name, function] = [_number(argument) for argument in call.args]
    return found


def rows() -> dict[int, list[int]]:
    """Returns the numbers of the hazards by the number of each row of the campaign."""
    found = {}
    for file in sorted((sources.ROOT / "campaign" / "rows").glob("*.py")):
        for _, call in _decorators(file, "row"):
            given = next((word.value for word in call.keywords if word.arg == "hazards"), ast.Tuple([]))
            assert isinstance(given, ast.Tuple)
            found[_number(call.args[0])] = [_number(element) for element in given.elts]
    return found


def _decorators(file: Path, name: str) -> Iterator[tuple[str, ast.Call]]:
    text = file.read_text()
    if f"@{name}(" not in text:
        return
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            for call in node.decorator_list:
                if isinstance(call, ast.Call) and dotted(call.func) == name:
                    yield node.name, call


def _number(node: ast.expr) -> int:
    value = ast.literal_eval(node)
    assert isinstance(value, int)
    return value
