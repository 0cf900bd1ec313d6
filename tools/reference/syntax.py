"""Names in Python's syntax trees, for Python 3.8, whose `ast` cannot turn a tree into text."""

from __future__ import annotations

import ast


def dotted(node: ast.expr) -> str:
    """Returns `a`, `a.b` or `a.b.c` as it stands in the source; a part that is no name is empty."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""
