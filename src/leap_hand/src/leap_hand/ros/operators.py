"""The files of the people whose hands were measured: NAME.yaml in ~/.config/leap_rig/operators; each holds values above
those of leap_hand.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from common.errors import RigError
from common.ros.files import read_yaml, user_file
from common.simulated import SIMULATED
from leap_hand.config import FINGERS

FILES, OPERATOR = "files", "operator"  # under leap_hand/: the values of each file by itself, that of operator:= too
LOWER_FILES = ("limits", "overrides")
MAPPING = (*(f"{finger}_{whose}" for finger in FINGERS for whose in ("human", "robot")), SIMULATED)


def operator_file(name: str) -> Path:
    """Returns the path of a person's file; raises RigError if the name is not one of a file."""
    return user_file("operator", name)


def known_names() -> list[str]:
    """Returns the names of the people whose hands were measured."""
    return sorted(file.stem for file in operator_file("any").parent.glob("*.yaml"))


def known_file(name: str) -> Path:
    """Returns the path of an existing file; raises RigError, which names the known people, if it does not exist."""
    path = operator_file(name)
    if not path.is_file():
        known = ", ".join(known_names()) or "nobody"
        measure = f"`rosrun leap_hand hand_wizard.py {name}` measures the hand"
        raise RigError(f"There is no file {path} for operator:={name}; known: {known}. {measure}.")
    return path


def with_operator(name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the parameters `values` of leap_hand/ with the mapping of another person, of nobody if the name is
    empty. Raises RigError: there is no such file, or it changes more than the mapping."""
    stored: Any = {}
    if name:
        path = known_file(name)
        stored = read_yaml(path) or {}
        if not isinstance(stored, dict) or not set(stored) <= set(MAPPING):
            more = "its values" if not isinstance(stored, dict) else ", ".join(map(str, set(stored) - set(MAPPING)))
            raise RigError(f"{path} has more than the mapping of the fingers ({more}): start with operator:={name}.")
    files = {**values.get(FILES, {})}
    before = files.pop(OPERATOR, {})
    new = {key: value for key, value in values.items() if key not in before}
    for layer in ({SIMULATED: False}, *(files.get(file, {}) for file in LOWER_FILES)):
        new.update({key: layer[key] for key in before if key in layer})
    return {**new, **stored, FILES: {**files, OPERATOR: dict(stored)} if name else files}
