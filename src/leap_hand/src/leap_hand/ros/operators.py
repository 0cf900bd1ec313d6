"""The files of the people whose hands were measured: NAME.yaml in ~/.config/leap_rig/operators."""

from __future__ import annotations

from pathlib import Path

from common.errors import RigError
from common.ros.files import user_file


def operator_file(name: str) -> Path:
    """Returns the path of a person's file; raises RigError if the name is not one of a file."""
    return user_file("operator", name)


def known_file(name: str) -> Path:
    """Returns the path of an existing file; raises RigError, which names the known people, if it does not exist."""
    path = operator_file(name)
    if not path.is_file():
        known = ", ".join(sorted(file.stem for file in path.parent.glob("*.yaml"))) or "nobody"
        measure = f"`rosrun leap_hand hand_wizard.py {name}` measures the hand"
        raise RigError(f"There is no file {path} for operator:={name}; known: {known}. {measure}.")
    return path
