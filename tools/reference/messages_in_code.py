"""Finds the sentences in the code that tell of something wrong, by reading its source."""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tools.reference import sources

GAP = "…"
"""Stands in a sentence for what is filled in at run time."""

NEVER_SHOWN = {"ROSInterruptException"}
"""Exceptions whose words nobody sees, because they end a program that was told to."""

LEVELS = re.compile(r"rospy\.log(warn|err|fatal)")
NAMES = re.compile(r"fault|failure|refusal|refused|reason|because|sentence|trouble|problem|^_?why$")
"""Variables, arguments and functions that hold or make such sentences."""


@dataclass(frozen=True)
class Sentence:
    """A sentence and where it stands.

    Attributes:
        text: with GAP for what is filled in.
        file: of the source.
    """

    text: str
    file: Path


def sentences(files: list[Path] | None = None) -> list[Sentence]:
    """Returns the sentences of these files, of all packages by default, each once for each file, in their order."""
    files = sorted(sources.ROOT.glob("src/**/src/*/**/*.py"), key=sources.inside) if files is None else files
    found: dict[Sentence, None] = {}
    for file in files:
        for node in _carriers(ast.parse(file.read_text())):
            for text in _texts(node):
                if len(text.split()) > 2:
                    found[Sentence(text, file)] = None
    return list(found)


def _carriers(tree: ast.Module) -> Iterator[ast.expr]:
    """Yields the expressions that hold such sentences."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            name = ast.unparse(node.exc.func).split(".")[-1]
            if not hasattr(builtins, name) and name not in NEVER_SHOWN:
                yield from node.exc.args
        elif isinstance(node, ast.Call):
            yield from _of_call(node)
        elif isinstance(node, (ast.Assign, ast.AugAssign, ast.AnnAssign)) and node.value:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if any(NAMES.search(_name(target)) for target in targets):
                yield node.value
        elif isinstance(node, ast.FunctionDef) and NAMES.search(node.name):
            yield from (n.value for n in ast.walk(node) if isinstance(n, (ast.Return, ast.Yield)) and n.value)
        elif isinstance(node, ast.Tuple) and len(node.elts) > 1 and _tells_of_trouble(node.elts[0]):
            yield node.elts[1]
        elif isinstance(node, ast.ClassDef) and re.search(r"Failure|Infeasib", node.name):
            yield from (n.value for n in node.body if isinstance(n, ast.Assign))


def _of_call(node: ast.Call) -> Iterator[ast.expr]:
    """Yields what such calls say: to the log, to the parser, to standard error, in an answer, to a list of faults."""
    name = ast.unparse(node.func)
    if LEVELS.match(name) or name in ("parser.error", "sys.exit"):
        yield from node.args
    elif name == "print":
        if any(k.arg == "file" and ast.unparse(k.value) == "sys.stderr" for k in node.keywords):
            yield from node.args
    elif len(node.args) > 1 and _tells_of_trouble(node.args[0]):
        yield node.args[1]
    elif name.endswith((".append", ".extend")) and NAMES.search(name.split(".")[-2]):
        yield from node.args
    yield from (k.value for k in node.keywords if k.arg and NAMES.search(k.arg))


def _tells_of_trouble(node: ast.expr) -> bool:
    words = ast.unparse(node)
    return words in ("False", "None", "'warn'", "'error'") or words.endswith((".WARN", ".ERROR"))


def _name(node: ast.expr) -> str:
    """Returns the last name of `a`, `a.b` or `a[0]`."""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def _texts(node: ast.expr) -> Iterator[str]:
    """Yields the sentences in an expression: literals, and those that others are built of."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield _tidy(re.sub(r"%[-.\d]*[sdgrf]", GAP, node.value))
    elif isinstance(node, ast.JoinedStr):
        parts = [part.value if isinstance(part, ast.Constant) else GAP for part in node.values]
        yield _tidy("".join(map(str, parts)))
    elif isinstance(node, (ast.List, ast.Tuple)):
        for element in node.elts:
            yield from _texts(element)
    elif isinstance(node, ast.IfExp):
        yield from _texts(node.body)
        yield from _texts(node.orelse)
    elif isinstance(node, (ast.ListComp, ast.GeneratorExp)):
        yield from _texts(node.elt)
    elif isinstance(node, ast.BinOp):
        yield from _texts(node.left)
        yield from _texts(node.right)
    elif isinstance(node, ast.BoolOp):
        for value in node.values:
            yield from _texts(value)


def _tidy(text: str) -> str:
    return " ".join(text.split())
