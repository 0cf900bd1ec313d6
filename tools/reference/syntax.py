"""Names in Python's syntax trees, for Python 3.8, whose `ast` has no `unparse`."""

from __future__ import annotations

import ast


def dotted(node: ast.expr) -> str:
    """Returns `a`, `a.b` or `a.b.c` as in the source; a part that is not a name is empty."""
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""
