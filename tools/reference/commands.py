"""The page of commands: the targets of make and the programs of each package."""

from __future__ import annotations

import ast
import re

from tools.reference import markdown, sources


def page() -> str:
    """Returns the page."""
    parts = [
        markdown.generated(
            "Commands",
            "the Makefile and the programs",
            "Programs start with `rosrun PACKAGE PROGRAM`, after `source devel/setup.bash`; most have "
            "`--help`. Nodes get their parameters from the [launch files](launch.md) that start them.",
        ),
        "## make\n",
        markdown.table(["command", "effect"], [[f"`make {name}`", what] for name, what in targets().items()]),
    ]
    name = ""
    rows: list[list[str]] = []
    for file in sorted(sources.ROOT.glob("src/**/scripts/*.py"), key=sources.inside):
        if sources.package(file) != name:
            if rows:
                parts.append(markdown.table(["program", "effect"], rows))
            name, rows = sources.package(file), []
            parts.append(f"## {name}\n")
        doc = ast.get_docstring(ast.parse(file.read_text())) or ""
        rows.append([markdown.code(file.name), markdown.text(doc.split("\n\n")[0])])
    parts.append(markdown.table(["program", "effect"], rows))
    return "\n".join(parts)


def targets() -> dict[str, str]:
    """Returns the commands of the Makefile and what they do."""
    return dict(re.findall(r"^([a-z-]+):.*?## (.*)$", (sources.ROOT / "Makefile").read_text(), re.MULTILINE))
