"""The files of the simulation: robot and meshes of rig_description, scenes and marker boards of this package. They are
found in the source tree and, with ROS, where ROS knows their package."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from common.errors import ConfigError
from common.ros.files import read_yaml

ROBOTS = ("LBR7R800", "LBR14R820")
FLANGES = ("MF_elektrisch", "MF_pneumatisch", "MF_IO_pneumatisch", "MF_touch_pneumatisch")
SUFFIXES = (".yaml", ".yml")  # of paths of yaml files; other names are of the files here
SOURCE_TREE = Path(__file__).resolve().parents[2]  # the folder of this package


def read_urdf(robot: str, flange: str, ring: bool = False) -> str:
    """Returns the URDF of an arm with media flange, and a `ring` for the marker board; FileNotFoundError if unknown."""
    return _read_description(f"urdf/{'with_ring/' if ring else ''}{robot.lower()}_{flange}.urdf")


def read_mesh(uri: str) -> str:
    """Returns the text of a mesh, package://rig_description/...; raises FileNotFoundError likewise."""
    return _read_description(uri.partition("package://rig_description/")[2])


def read_scene(name: str) -> dict[str, Any]:
    """Returns the mapping of a scene, by its name here or the path of a yaml file; ConfigError if unreadable."""
    return _read_yaml("scenes", name)


def read_board(name: str) -> dict[str, Any]:
    """Returns the mapping of a marker board, like `read_scene`."""
    return _read_yaml("panels", name)


def _package_folders(package: str) -> list[Path]:
    try:
        import rospkg

        return [SOURCE_TREE.parent / package, Path(rospkg.RosPack().get_path(package))]
    except Exception:  # without ROS, or without that package in it, rospkg fails in several ways
        return [SOURCE_TREE.parent / package]


def _read_description(path: str) -> str:
    for folder in _package_folders("rig_description"):
        if (folder / path).is_file():
            return (folder / path).read_text(encoding="utf-8")
    raise FileNotFoundError(
        f"The package rig_description has no file {path!r}; check robot and flange, or restore the file."
    )


def _read_yaml(kind: str, name: str) -> dict[str, Any]:
    is_path = Path(name).suffix.lower() in SUFFIXES
    folders = [folder / "config" / kind for folder in _package_folders("rig_simulation")]
    for path in [Path(name)] if is_path else [folder / f"{name}.yaml" for folder in folders]:
        if os.path.isfile(path):  # unlike Path.is_file also of a name that is too long
            return read_yaml(path)
    if is_path:
        raise ConfigError([f"There is no file {Path(name).absolute()}."])
    known = sorted({path.stem for folder in folders for path in folder.glob("*.yaml")})
    raise ConfigError([f"There is no {name!r} in {kind}; choose {', '.join(known)}, or the path of a yaml file."])
