"""The files of the world: scenes and marker boards of this package, meshes of the robot's description."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from common.errors import ConfigError
from rig_simulation.devices.sunrise.description import PACKAGE as DESCRIPTION
from rig_simulation.devices.sunrise.description import SOURCE_TREE as DESCRIPTION_TREE
from rig_simulation.devices.sunrise.description import package_folders

PACKAGE = "rig_simulation"
SOURCE_TREE = Path(__file__).resolve().parents[3]


def read_scene(name: str) -> dict[str, Any]:
    """Returns the mapping of a scene: of this package by its name, or of a yaml file by its path.

    Raises:
        ConfigError: the file is missing or is not yaml.
    """
    return _read("scenes", name)


def read_board(name: str) -> dict[str, Any]:
    """Returns the mapping of a marker board, like `read_scene`."""
    return _read("panels", name)


def read_mesh(uri: str) -> str:
    """Returns the text of a mesh of the robot's description.

    Args:
        uri: package://rig_description/...

    Raises:
        FileNotFoundError: there is no such file.
    """
    path = uri.partition(f"package://{DESCRIPTION}/")[2]
    for folder in package_folders(DESCRIPTION, DESCRIPTION_TREE):
        if (folder / path).is_file():
            return (folder / path).read_text(encoding="utf-8")
    raise FileNotFoundError(f"There is no mesh {uri}; undo changes of rig_description.")


def _read(kind: str, name: str) -> dict[str, Any]:
    folders = [folder / "config" / kind for folder in package_folders(PACKAGE, SOURCE_TREE)]
    paths = [Path(name)] if name.endswith(".yaml") else [folder / f"{name}.yaml" for folder in folders]
    for path in paths:
        if path.is_file():
            try:
                return yaml.safe_load(path.read_text(encoding="utf-8"))
            except (yaml.YAMLError, UnicodeDecodeError) as error:
                raise ConfigError([f"The file {path} is not valid yaml: {str(error).splitlines()[0]}."]) from None
    if name.endswith(".yaml"):
        raise ConfigError([f"There is no file {Path(name).absolute()}."])
    known = sorted({path.stem for folder in folders for path in folder.glob("*.yaml")})
    raise ConfigError([f"There is no {name!r} in {kind}; choose {', '.join(known)}, or the path of a yaml file."])
