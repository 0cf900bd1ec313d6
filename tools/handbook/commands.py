"""Checks commands against the source: the programs, launch files, options, targets, services and topics they name."""

from __future__ import annotations

import functools
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

from tools.reference import launch_files, sources
from tools.reference.commands import targets

CHECKED = ("make", "rosrun", "roslaunch", "rosservice", "rostopic")
EXAMPLE = re.compile(r"[A-Z]{2,}|…|\.\.\.|<")
"""A placeholder that the reader replaces."""


def faults(text: str) -> list[str]:
    """Returns what is wrong with the commands in a text, one sentence each."""
    return [fault for words in commands(text) for fault in _faults(words)]


def commands(text: str) -> Iterator[list[str]]:
    """Yields the words of each command that is checked; a backslash continues a line."""
    for line in text.replace("\\\n", " ").splitlines():
        for part in re.split(r"&&|;|\|", line):
            try:
                words = shlex.split(part, comments=True)
            except ValueError:
                continue
            while words and (re.fullmatch(r"\w+=\S*", words[0]) or words[0] in ("sudo", "$", "nice", "exec")):
                words = words[1:]
            if len(words) > 1 and words[0] in CHECKED:
                yield words


def for_a_real_rig(text: str) -> list[str]:
    """Returns the commands in a text that use real devices, above all those that may move a real arm."""
    return [" ".join(words) for words in commands(text) if _real(words)]


def _real(words: list[str]) -> bool:
    rest = " ".join(words[1:])
    if re.search(r"(?<!\S)(robot_ip:=|ip:=|--ip[ =])127\.", rest):
        return False
    if re.search(r"(?<!\S)(sim:=false|robot_ip:=|ip:=|--ip[ =])", rest):
        return True
    if words[0] == "roslaunch" and _real_by_default(words[1:]):
        return True
    asks = re.search(r"(?<!\S)--(list|help|by-hand|again)(?!\S)", rest)
    return not asks and re.match(r"kuka_control simple_controller\.py|vision calibrate_camera\.py", rest) is not None


def _real_by_default(words: list[str]) -> bool:
    """Whether a launch file starts real devices where it is not asked to simulate them."""
    launch = _launch_file(*(*words, "", "")[:2])
    sim = launch_files.arguments(launch).get("sim") if launch is not None and launch.is_file() else None
    given = {name: value for name, assigned, value in (word.partition(":=") for word in words) if assigned}
    if sim is None or given.get("camera") == "false":
        return False
    return given.get("sim", sim.get("default")) != "true"


def _faults(words: list[str]) -> list[str]:
    check = {"make": _make, "rosrun": _rosrun, "roslaunch": _roslaunch, "rosservice": _graph, "rostopic": _graph}
    return [f"`{' '.join(words)}`: {fault}" for fault in check[words[0]](words[1:])]


def _make(words: list[str]) -> Iterator[str]:
    makefile = (sources.ROOT / "Makefile").read_text()
    for word in words:
        name, _, value = word.partition("=")
        if value or "=" in word:
            if not re.search(rf"^{re.escape(name)} \?=", makefile, re.MULTILINE):
                yield f"the Makefile takes no {name}"
        elif not word.startswith("-") and name not in targets():
            yield f"the Makefile has no target {name}"


def _rosrun(words: list[str]) -> Iterator[str]:
    package, program = (*words, "", "")[:2]
    folder = _packages().get(package)
    if folder is None or not program or EXAMPLE.search(program):
        return
    script = folder / "scripts" / program
    if not script.is_file():
        yield f"{package} has no program {program}"
        return
    source = "\n".join(path.read_text() for path in folder.glob("src/**/*.py"))
    source += "\n".join(path.read_text() for path in sources.ROOT.glob("src/modules/rig_simulation/src/**/*.py"))
    for word in words[2:]:
        if word == "--":
            return
        option = re.match(r"--([a-z][a-z-]*)", word)
        if option and option[1] != "help" and not _takes(source, option[1]):
            yield f"{program} has no option --{option[1]}"


def _takes(source: str, option: str) -> bool:
    """Whether the source has the option, or a record with that field from which options are made."""
    return (
        f'"--{option}"' in source or re.search(rf"^    {option.replace('-', '_')}: ", source, re.MULTILINE) is not None
    )


def _roslaunch(words: list[str]) -> Iterator[str]:
    words = [word for word in words if not word.startswith("--")]
    package, file = (*words, "", "")[:2]
    launch = _launch_file(package, file)
    if launch is None or EXAMPLE.search(file):
        return
    if not launch.is_file():
        yield f"{package} has no launch file {file}"
        return
    known = launch_files.arguments(launch)
    for word in words[2:]:
        name, assigned, _ = word.partition(":=")
        if assigned and name not in known:
            yield f"{launch.name} has no argument {name}"


def _launch_file(package: str, file: str) -> Path | None:
    """Returns the path of a launch file, which need not exist; None for a package that is not here."""
    folder = _packages().get(package)
    name = file if file.endswith(".launch") else f"{file}.launch"
    return None if folder is None else folder / "launch" / name


def _graph(words: list[str]) -> Iterator[str]:
    names = [word for word in words[1:2] if not word.startswith("-")]
    for name in names:
        if EXAMPLE.search(name):
            continue
        last = name.strip("/").split("/")[-1]
        if not re.search(rf"[\"'/~]{re.escape(last)}[\"'/]", _all_source()):
            yield f"no node has the name {name}"


@functools.lru_cache(maxsize=None)
def _packages() -> dict[str, Path]:
    return {manifest.parent.name: manifest.parent for manifest in sources.ROOT.glob("src/**/package.xml")}


@functools.lru_cache(maxsize=None)
def _all_source() -> str:
    files = [*sources.ROOT.glob("src/**/src/**/*.py"), *sources.ROOT.glob("src/**/launch/*.launch")]
    return "\n".join(file.read_text() for file in files)
