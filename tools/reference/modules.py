"""The page of modules: each Python file of each package with the first sentence about it."""

from __future__ import annotations

import ast
from pathlib import Path

from tools.reference import markdown, sources


def page() -> str:
    """Returns the page."""
    parts = [
        markdown.generated(
            "Modules",
            "the first sentences of the source files",
            "What each file is. [The code map](../code-map.md) says in which order to read. Files in `ros/` know ROS; "
            "the others are pure.",
        )
    ]
    packages: dict[str, list[Path]] = {}
    for file in sorted(sources.ROOT.glob("src/**/src/*/**/*.py"), key=sources.inside):
        packages.setdefault(sources.package(file), []).append(file)
    for package, files in packages.items():
        told = ((file, _said(file)) for file in files)
        rows = [[f"[{_name(file)}](../../{file.relative_to(sources.ROOT)})", said] for file, said in told if said]
        parts += [f"## {package}\n", markdown.table(["file", "what it is"], rows)]
    return "\n".join(parts)


def _name(file: Path) -> str:
    """Returns the place of a file in its package."""
    inner = len(file.parts) - 1 - file.parts[::-1].index("src")
    return str(Path(*file.parts[inner + 2 :]))


def _said(file: Path) -> str:
    """Returns the first paragraph about a file; none for files that only mark a package."""
    if file.name == "__init__.py":
        return ""
    return markdown.text((ast.get_docstring(ast.parse(file.read_text())) or "").split("\n\n")[0])
