"""The page of launch files: each with its arguments, their defaults and meanings."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from pathlib import Path

from tools.reference import markdown, sources


def page() -> str:
    """Returns the page."""
    parts = [
        markdown.generated(
            "Launch files",
            "the launch files",
            "`roslaunch PACKAGE FILE.launch name:=value ...`. `roslaunch leap_rig demo` is short for `demo.launch`. "
            "An argument that another launch file of the package has already, with the same default, is only named.",
        )
    ]
    name = ""
    shown: dict[tuple[str, ...], str] = {}
    for file in sorted(sources.ROOT.glob("src/**/launch/*.launch"), key=sources.inside):
        if sources.package(file) != name:
            name = sources.package(file)
            parts.append(f"## {name}\n")
        parts.append(_file(file, shown))
    return "\n".join(parts)


def arguments(file: Path) -> dict[str, ElementTree.Element]:
    """Returns the arguments that a caller may set, by name; those with a fixed `value` are internal."""
    return {a.get("name", ""): a for a in ElementTree.parse(file).getroot().findall("arg") if a.get("value") is None}


def _file(file: Path, shown: dict[tuple[str, ...], str]) -> str:
    """Returns the section of a launch file; arguments already in `shown` for its package are only named."""
    rows, same = [], defaultdict(list)
    for name, arg in arguments(file).items():
        row = [markdown.code(name), _default(arg), markdown.text(arg.get("doc", ""))]
        before = shown.setdefault((sources.package(file), *row[:2]), file.name)
        if before == file.name:
            rows.append(row)
        else:
            same[before].append(row[0])
    parts = [f"### {file.name}\n", f"{markdown.text(_comment(file))}\n"]
    if rows:
        parts.append(markdown.table(["argument", "default", "meaning"], rows))
    parts += [f"As in {markdown.code(other)}: {', '.join(names)}.\n" for other, names in same.items()]
    return "\n".join(parts)


def _default(arg: ElementTree.Element) -> str:
    default = arg.get("default")
    if default is None:
        return "must be given"
    return markdown.code(default) or "empty"


def _comment(file: Path) -> str:
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.parse(file, parser).getroot()
    return next((" ".join((child.text or "").split()) for child in root if child.tag is ElementTree.Comment), "")
