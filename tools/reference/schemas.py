"""Tables of the typed schemas of yaml files and private parameters."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import yaml

from tools.reference import markdown

if TYPE_CHECKING:
    from common.config import Key

KINDS = {"whole number": "integer", "true or false": "boolean"}
COLUMNS = ("default", "range", "meaning")


def keys_of(schema: str) -> list[Key]:
    """Returns the keys of `module:Class`."""
    from common.config import keys

    module, name = schema.split(":")
    return keys(getattr(importlib.import_module(module), name))


def row(key: Key, name: str, values: Mapping[str, Any], comment: str = "") -> list[str]:
    """Returns a row of the table: name, then the COLUMNS.

    Args:
        key: of the schema.
        name: how the page calls the key.
        values: of the yaml file; a key that is missing there has the schema's default.
        comment: used where the schema has no meaning."""
    return [
        markdown.code(name),
        markdown.code(value(values[key.name])) if key.name in values else _absent(key),
        _range(key),
        markdown.text(key.meaning or comment),
    ]


def table(first: str, rows: Iterable[list[str]]) -> str:
    """Returns the table of such rows; `first` is the title of the first column."""
    return markdown.table([first, *COLUMNS], rows)


def value(of: Any) -> str:
    """Returns a value as one line of yaml."""
    return yaml.safe_dump(of, default_flow_style=True, width=1000, allow_unicode=True).replace("...", "").strip()


def _absent(key: Key) -> str:
    from common.config import REQUIRED

    if key.absent is REQUIRED:
        return "must be given"
    if key.absent is None:
        return "none"
    plain = key.absent.tolist() if hasattr(key.absent, "tolist") else key.absent
    return "empty" if plain == "" else markdown.code(value(plain))


def _range(key: Key) -> str:
    """Returns type, range and unit of a key; the type of a number is omitted."""
    if key.type == "one of":
        return "empty" + key.range if key.range.startswith(",") else key.range
    kind = "" if key.type == "number" and (key.range or key.unit) else KINDS.get(key.type, key.type)
    return " ".join(part for part in (kind, key.range, key.unit) if part)
