"""Finds the sentences in the code that tell of something wrong, by reading its source."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tools.reference import sources
from tools.reference.syntax import dotted

GAP = "…"
"""Stands in a sentence for what is filled in at run time."""

PROGRAMS = ("src/**/src/*/**/*.py", "src/**/shell/*.sh", "tools/*.sh")
"""Where people who run the rig get sentences from."""

NEVER_SHOWN = {"ROSInterruptException"}
"""Exceptions whose words nobody sees, because they end a program that was told to."""

LEVELS = re.compile(r"rospy\.log(warn|err|fatal)")
SHELL = re.compile(r"""(?:echo|printf) (["'])(?P<said>.*)\1.*>&2|failed (")(?P<end>.*)\3""")
"""What a script says to standard error, or by its function `failed`."""
SHELL_GAP = re.compile(r"\$\(.*?\)|\$\{.*?\}|\$\w+")
NAMES = re.compile(
    r"fault|fail|refus|Refus|reason|because|sentence|trouble|problem|hindrance|complaint|contradiction|objection|silence"
    r"|absent|remark|slow|waits_for|give_up|latch|set_status|Health|NEVER|NOT_|NO_|_OFF$|CAUSE"
    r"|^(_?(why|lost|lose|lose_client|cause|again|none)|errors|limits|waited|skewed|broken|notes|tell|respond|__str__)$"
)
"""Variables, constants, arguments, functions and records that hold, make or take such sentences."""


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
    """Returns the sentences of these files, of all programs by default, each once for each file, in their order."""
    found: dict[Sentence, None] = {}
    for file in _all_files() if files is None else files:
        source = file.read_text()
        for text in _of_shell(source) if file.suffix == ".sh" else _of_python(source):
            if len(text.split()) > 2:
                found[Sentence(text, file)] = None
    return list(found)


def _all_files() -> list[Path]:
    files = [file for pattern in PROGRAMS for file in sources.ROOT.glob(pattern)]
    return sorted(files, key=sources.inside)


def _of_shell(source: str) -> Iterator[str]:
    for said in SHELL.finditer(source):
        yield _tidy(_formatted(SHELL_GAP.sub(GAP, said["said"] or said["end"])).replace("\\n", " "))


def _of_python(source: str) -> Iterator[str]:
    tree = ast.parse(source)
    carriers = list(_carriers(tree))
    named = {node.id for node in carriers if isinstance(node, ast.Name)}
    for node in [*carriers, *_assigned(tree, lambda name: name in named)]:
        yield from _texts(node)


def _assigned(tree: ast.Module, counts: Callable[[str], object]) -> Iterator[ast.expr]:
    """Yields what is assigned to the names that count."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.Assign, ast.AugAssign, ast.AnnAssign)) and node.value:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if any(counts(_name(target)) for target in targets):
                yield node.value


def _carriers(tree: ast.Module) -> Iterator[ast.expr]:
    """Yields the expressions that hold such sentences."""
    yield from _assigned(tree, NAMES.search)
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            if dotted(node.exc.func).split(".")[-1] not in NEVER_SHOWN:
                yield from node.exc.args
        elif isinstance(node, ast.Call):
            yield from _of_call(node)
        elif isinstance(node, ast.FunctionDef) and (NAMES.search(node.name) or _sentence_or_none(node.returns)):
            yield from (n.value for n in ast.walk(node) if isinstance(n, (ast.Return, ast.Yield)) and n.value)
        elif isinstance(node, ast.Tuple):
            yield from _behind_trouble(node.elts)
        elif isinstance(node, ast.Dict):
            yield from (v for k, v in zip(node.keys, node.values) if isinstance(k, ast.Constant) and k.value == "error")
        elif isinstance(node, ast.ClassDef) and re.search(r"Failure|Infeasib", node.name):
            yield from (n.value for n in node.body if isinstance(n, ast.Assign))


def _of_call(node: ast.Call) -> Iterator[ast.expr]:
    """Yields what such calls say: to the log, to the parser, to standard error, in an answer, to a list of faults."""
    name = dotted(node.func)
    if LEVELS.match(name) or name in ("parser.error", "sys.exit"):
        yield from node.args
    elif name == "print":
        if any(k.arg == "file" and dotted(k.value) == "sys.stderr" for k in node.keywords):
            yield from node.args
    elif any(NAMES.search(part) for part in name.split(".")[-2 if name.endswith((".append", ".extend")) else -1 :]):
        yield from node.args
    yield from _behind_trouble(node.args)
    yield from (k.value for k in node.keywords if k.arg and NAMES.search(k.arg))


def _behind_trouble(elements: list[ast.expr]) -> Iterator[ast.expr]:
    """Yields what stands behind a "no" or a condition, as in `return False, "it is closed"`."""
    yield from (text for before, text in zip(elements, elements[1:]) if _tells_of_trouble(before))


def _tells_of_trouble(node: ast.expr) -> bool:
    if isinstance(node, ast.Constant):
        return node.value is False or node.value in (None, "warn", "warning", "error")
    return isinstance(node, ast.Compare) or dotted(node).endswith((".WARN", ".ERROR"))


def _sentence_or_none(annotation: ast.expr | None) -> bool:
    """Whether it is `str | None`: what stands in the way, if anything does."""
    return isinstance(annotation, ast.BinOp) and dotted(annotation.left) == "str"


def _name(node: ast.expr) -> str:
    """Returns the last name of `a`, `a.b` or `a[0]`."""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def _texts(node: ast.expr) -> Iterator[str]:
    """Yields the sentences in an expression: literals, and those that others are built of."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield _tidy(_formatted(node.value))
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


def _formatted(text: str) -> str:
    return re.sub(r"%[-.\d]*[sdgrf]", GAP, text)


def _tidy(text: str) -> str:
    return " ".join(text.split())
