"""The page of messages and services: their definitions and MD5 sums."""

from __future__ import annotations

from pathlib import Path

from tools.reference import markdown, sources

DEFINITIONS = (Path("/usr/share"), Path("/opt/ros/noetic/share"))
"""Folders of the ROS packages whose messages ours use."""


def page() -> str:
    """Returns the page. Raises ImportError: genmsg of ROS is not installed."""
    import genmsg

    context = genmsg.MsgContext.create_default()
    search = _search_path()
    parts = [
        markdown.generated(
            "Messages and services",
            "the msg, srv and action files",
            "Definitions and MD5 sums (`rosmsg md5`, `rossrv md5`). Programs can communicate if the sums are equal.",
        )
    ]
    package = ""
    files = (*sources.ROOT.glob("src/**/*.[ms][sr][gv]"), *sources.ROOT.glob("src/**/*.action"))
    for file in sorted(files, key=sources.inside):
        if sources.package(file) != package:
            package = sources.package(file)
            parts.append(f"## {package}\n")
        name = f"{package}/{file.stem}"
        if file.suffix == ".action":
            parts.append(f"### {name}\n\nAn action.\n\n```text\n{file.read_text().rstrip()}\n```\n")
            continue
        load = genmsg.load_msg_by_type if file.suffix == ".msg" else genmsg.load_srv_by_type
        spec = load(context, name, search)
        genmsg.load_depends(context, spec, search)
        md5 = genmsg.compute_md5(context, spec)
        parts.append(f"### {name}\n\nMD5 `{md5}`\n\n```text\n{file.read_text().rstrip()}\n```\n")
    return "\n".join(parts)


def _search_path() -> dict[str, list[str]]:
    path: dict[str, list[str]] = {}
    folders = [file.parent for file in sources.ROOT.glob("src/**/*.[ms][sr][gv]")]
    folders += [folder for root in DEFINITIONS for folder in root.glob("*/msg")]
    for folder in folders:
        path.setdefault(folder.parent.name, [str(folder)])
        if str(folder) not in path[folder.parent.name]:
            path[folder.parent.name].append(str(folder))
    return path
