"""Places in Python source that can be mutated, and the mutated source. Pure: text in, text out."""

from __future__ import annotations

import ast
import keyword
import random
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

FLIPPED = {ast.Lt: (">", "<="), ast.LtE: (">", "<"), ast.Gt: ("<", ">="), ast.GtE: ("<", ">")}
FLIPPED_SIGN = {ast.Add: ("+", "-"), ast.Sub: ("-", "+")}
BLOCKS = ("body", "orelse", "finalbody", "handlers")


@dataclass(frozen=True)
class Place:
    """One change of one statement.

    Attributes:
        package: package of the file.
        file: the file, relative to the root of the project.
        line: line of the statement.
        function: qualified name of the enclosing function, empty at module level.
        statement: the statement, or the header of a compound statement, on one line.
        operator: kind of the change.
        number: index among the changes of this kind in this statement.
        before, after: the changed part of the source.
        offset: where `before` starts in the file [characters].
    """

    package: str
    file: str
    line: int
    function: str
    statement: str
    operator: str
    number: int
    before: str
    after: str
    offset: int

    def mutated(self, source: str) -> str:
        """Returns the source with this change.

        Raises:
            ValueError: the source is not the one that this place was found in.
        """
        end = self.offset + len(self.before)
        if source[self.offset : end] != self.before:
            raise ValueError(f"{self.file}:{self.line} does not hold {self.before!r}")
        padding = "\n" * (self.before.count("\n") - self.after.count("\n"))  # keeps the numbers of the lines below
        return source[: self.offset] + self.after + padding + source[end:]


def find(source: str, package: str, file: str) -> list[Place]:
    """Returns every place of a file."""
    return list(_Finder(source, package, file).places())


def choose(candidates: Iterable[Place], count: int, seed: int) -> list[Place]:
    """Returns `count` places at different statements, in proportion to the statements of each package."""
    rng = random.Random(seed)
    by_package: dict[str, dict[tuple[str, int], list[Place]]] = {}
    for place in candidates:
        by_package.setdefault(place.package, {}).setdefault((place.file, place.line), []).append(place)
    total = sum(map(len, by_package.values()))
    chosen = []
    for package, quota in _quotas({name: len(found) / total * count for name, found in by_package.items()}).items():
        statements = list(by_package[package].values())
        chosen += [rng.choice(places) for places in rng.sample(statements, min(quota, len(statements)))]
    return chosen


def find_again(saved: Iterable[Place], candidates: list[Place], seed: int) -> list[tuple[Place, bool]]:
    """Returns for each saved place the same one of a changed tree, or another one of its package.

    A statement is the same if its text is, or if only its names changed and no other statement has its form.

    Returns:
        The places, each with whether it is the same.
    """
    rng = random.Random(seed)
    lookups = [_lookup(candidates, key) for key in (_in_function, _in_package, _anywhere, _form)]
    saved = list(saved)
    forms = Counter(_form(place) for place in saved)
    taken: set[tuple[str, int]] = set()
    result: list[tuple[Place, bool]] = []
    for place in saved:
        keys = (_in_function(place), _in_package(place), _anywhere(place), _form(place))
        same = None
        for lookup, key in zip(lookups, keys):
            found = [other for other in lookup.get(key, []) if (other.file, other.line) not in taken]
            if found and (key != keys[-1] or (len(found) == 1 and forms[key] == 1)):
                same = found[0]
                break
        if same is None:
            free = [other for other in candidates if (other.file, other.line) not in taken]
            of_package = [other for other in free if other.package == place.package]
            result.append((rng.choice(of_package or free), False))
        else:
            result.append((same, True))
        taken.add((result[-1][0].file, result[-1][0].line))
    return result


def _quotas(exact: dict[str, float]) -> dict[str, int]:
    """Rounds to whole numbers of the same sum: the largest remainders are rounded up."""
    quotas = {name: int(value) for name, value in exact.items()}
    missing = round(sum(exact.values())) - sum(quotas.values())
    for name in sorted(exact, key=lambda name: quotas[name] - exact[name])[:missing]:
        quotas[name] += 1
    return quotas


def _lookup(candidates: list[Place], key: Callable[[Place], tuple]) -> dict[tuple, list[Place]]:
    table: dict[tuple, list[Place]] = {}
    for place in candidates:
        table.setdefault(key(place), []).append(place)
    return table


def _change(place: Place) -> tuple:
    return (_normalised(place.statement), place.operator, place.number)


def _in_function(place: Place) -> tuple:
    return (place.package, place.function, *_change(place))


def _in_package(place: Place) -> tuple:
    return (place.package, *_change(place))


def _anywhere(place: Place) -> tuple:
    return _change(place)


def _form(place: Place) -> tuple:
    names = re.sub(r"\b[A-Za-z_]\w*", lambda m: m[0] if keyword.iskeyword(m[0]) else "x", place.statement)
    return (_normalised(names), place.operator, place.number)


def _normalised(statement: str) -> str:
    return re.sub(r",(?=[)\]}])", "", re.sub(r"\s+", "", statement))


class _Finder:
    def __init__(self, source: str, package: str, file: str) -> None:
        self._source, self._package, self._file = source, package, file
        self._tree = ast.parse(source)
        self._starts = [0]
        for line in source.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))
        self._lines = source.splitlines()

    def places(self) -> Iterator[Place]:
        for statement, function in _statements(self._tree.body, ""):
            start, end = self._extent(statement)
            text = " ".join(self._source[start:end].split())
            numbers: Counter[str] = Counter()
            for operator, at, until, after in self._changes(statement):
                yield Place(
                    self._package, self._file, statement.lineno, function, text, operator, numbers[operator],
                    self._source[at:until], after, at,
                )  # fmt: skip
                numbers[operator] += 1

    def _extent(self, statement: ast.stmt) -> tuple[int, int]:
        """Returns where a statement, or the header of a compound one, begins and ends."""
        start, end = self._span(statement)
        inner = getattr(statement, "body", None)
        if isinstance(inner, list):
            end = self._source.rindex(":", start, self._span(inner[0])[0])
        return start, end

    def _changes(self, statement: ast.stmt) -> Iterator[tuple[str, int, int, str]]:
        if _can_be_deleted(statement):
            yield ("delete", *self._span(statement), "pass")
        elif isinstance(statement, ast.Return) and not _is_text_or_none(statement.value):
            yield ("delete", *self._span(statement.value), "None")
        for node in _expressions(statement):
            yield from self._changes_of(node)
        if isinstance(statement, ast.AugAssign) and type(statement.op) in FLIPPED_SIGN:
            before, after = FLIPPED_SIGN[type(statement.op)]
            yield self._between(statement.target, statement.value, before + "=", after + "=", "sign")

    def _changes_of(self, node: ast.AST) -> Iterator[tuple[str, int, int, str]]:
        start, end = self._span(node)
        if isinstance(node, ast.BinOp) and type(node.op) in FLIPPED_SIGN:
            yield self._between(node.left, node.right, *FLIPPED_SIGN[type(node.op)], "sign")
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            yield "sign", start, start + 1, "+"
        elif isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in FLIPPED:
            text = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}[type(node.ops[0])]
            for after in FLIPPED[type(node.ops[0])]:
                yield self._between(node.left, node.comparators[0], text, after, "compare")
        elif isinstance(node, ast.BoolOp):
            before, after = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
            yield self._between(node.values[0], node.values[1], before, after, "and/or")
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            value = node.value
            yield "constant", start, end, repr(value + 1 if isinstance(value, int) or not value else value * 1.5)
        if isinstance(node, (ast.IfExp, ast.If, ast.While)):
            at, until = self._span(node.test)
            yield "condition", at, until, f"(not ({self._source[at:until]}))"

    def _between(
        self, left: ast.AST, right: ast.AST, before: str, after: str, operator: str
    ) -> tuple[str, int, int, str]:
        at = self._source.index(before, self._span(left)[1], self._span(right)[0])
        return operator, at, at + len(before), after

    def _span(self, node: Any) -> tuple[int, int]:
        return self._offset(node.lineno, node.col_offset), self._offset(node.end_lineno, node.end_col_offset)

    def _offset(self, line: int, column: int) -> int:
        """Returns the index of a place that the parser gives as line and column [bytes of UTF-8]."""
        return self._starts[line - 1] + len(self._lines[line - 1].encode()[:column].decode())


def _statements(body: list, function: str) -> Iterator[tuple[ast.stmt, str]]:
    for node in body:
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            name = f"{function}.{node.name}".lstrip(".")
            if not isinstance(node, ast.ClassDef):
                yield node, name
            yield from _statements(node.body, name)
            continue
        if isinstance(node, ast.stmt) and not _has_no_effect(node):
            yield node, function
        for block in BLOCKS:
            yield from _statements(getattr(node, block, []), function)


def _has_no_effect(node: ast.stmt) -> bool:
    """Whether a statement is a docstring, an import, or a message to a person."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return True
    if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
        return True
    return isinstance(node, (ast.Import, ast.ImportFrom, ast.Pass, ast.Raise, ast.Assert, ast.Try))


def _can_be_deleted(statement: ast.stmt) -> bool:
    if isinstance(statement, (ast.AugAssign, ast.Break, ast.Continue)):
        return True
    if isinstance(statement, ast.Expr):
        return isinstance(statement.value, ast.Call)
    return isinstance(statement, ast.Assign) and isinstance(statement.targets[0], (ast.Attribute, ast.Subscript))


def _is_text_or_none(value: ast.expr | None) -> bool:
    return (
        value is None
        or isinstance(value, ast.JoinedStr)
        or (isinstance(value, ast.Constant) and (value.value is None or isinstance(value.value, str)))
    )


def _expressions(statement: ast.stmt) -> Iterator[ast.AST]:
    """Yields the statement and its expressions, without annotations, decorators, texts and inner blocks."""
    yield statement
    waiting: list[ast.AST] = []
    if isinstance(statement, (ast.FunctionDef, ast.AsyncFunctionDef)):
        waiting += [default for default in (*statement.args.defaults, *statement.args.kw_defaults) if default]
    else:
        for name, value in ast.iter_fields(statement):
            if name not in (*BLOCKS, "annotation"):
                waiting += value if isinstance(value, list) else [value]
    while waiting:
        node = waiting.pop(0)
        if isinstance(node, ast.AST) and not isinstance(node, (ast.JoinedStr, ast.expr_context, ast.Slice)):
            if hasattr(node, "lineno"):
                yield node
            waiting += ast.iter_child_nodes(node)
