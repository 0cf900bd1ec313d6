"""A folder with pictures of the panel and the truth, as `rosrun rig_simulation panel_pictures.py` fills it."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rospkg
import yaml

from apriltag_ros.settings import TAG_KEYS, targets
from apriltag_ros.target import Target
from common.camera_model import CameraModel, from_calibration
from common.errors import DeviceError
from common.poses import check_pose
from common.ros.images import metres_from_millimetres

INDEX = "pictures.json"
TAGS = {"bundle": "tags.yaml", "single": "tags_single.yaml"}
TIMEOUT_S = 1800.0
"""The taking of the pictures ends within this."""


@dataclass(frozen=True, eq=False)
class Pair:
    """A colour and a depth picture of the panel with the truth."""

    grey: np.ndarray
    depth: np.ndarray
    distance: float
    tilt: float
    T_rgb_panel: np.ndarray


@dataclass(frozen=True, eq=False)
class Pictures:
    """A folder of pictures.

    Attributes:
        folder: where they are.
        entries: what each shows.
        plate: edge of the panel [m].
        rgb, depth: the cameras.
        T_rgb_depth: pose of the depth camera in the colour camera, shape (4, 4) [m].
    """

    folder: Path
    entries: list[dict]
    plate: float
    rgb: CameraModel
    depth: CameraModel
    T_rgb_depth: np.ndarray

    def pairs(self) -> Iterator[Pair]:
        """Reads one pair after the other.

        Raises:
            DeviceError: a file is missing or no picture.
        """
        for entry in self.entries:
            grey = cv2.imread(str(self.folder / entry["colour"]), cv2.IMREAD_GRAYSCALE)
            depth = cv2.imread(str(self.folder / entry["depth"]), cv2.IMREAD_UNCHANGED)
            if grey is None or depth is None or depth.dtype != np.uint16:
                raise DeviceError(f"{entry['colour']} and {entry['depth']} in {self.folder} are no pair of pictures.")
            T = check_pose(entry["T_rgb_panel"])
            yield Pair(grey, metres_from_millimetres(depth), float(entry["distance"]), float(entry["tilt"]), T)


def read_pictures(folder: Path) -> Pictures:
    """Returns what a folder holds.

    Raises:
        DeviceError: it holds no pictures.
    """
    try:
        index = json.loads((folder / INDEX).read_text(encoding="utf-8"))
        return Pictures(
            folder,
            list(index["pictures"]),
            float(max(index["panel"]["size"])),
            from_calibration(index["rgb"]),
            from_calibration(index["depth"]),
            check_pose(index["T_rgb_depth"]),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DeviceError(
            f"{folder / INDEX} does not say what pictures show: {type(error).__name__}: {error}."
        ) from None


def take_pictures(folder: Path, panel: str, *options: str) -> None:
    """Lets the simulation fill a folder.

    Args:
        panel: bundle or single.
        options: more of panel_pictures.py.

    Raises:
        DeviceError: it takes none.
    """
    command = ["rosrun", "rig_simulation", "panel_pictures.py", str(folder), "--panel", panel]
    command += ["--rgb", str(config_file("xtion_rgb.yaml")), "--depth", str(config_file("xtion_depth.yaml")), *options]
    try:
        code = subprocess.run(command, timeout=TIMEOUT_S, check=False).returncode
    except FileNotFoundError:
        raise DeviceError("There is no rosrun: source devel/setup.bash, or say where pictures are.") from None
    except subprocess.TimeoutExpired:
        raise DeviceError(f"The pictures were not taken within {TIMEOUT_S:g} s.") from None
    if code != 0:
        raise DeviceError(f"The pictures were not taken: {' '.join(command[:3])} ended with exit code {code}.")


def panel_target(panel: str) -> Target:
    """Returns the tags of the panel, bundle or single."""
    (target,) = targets({key: config(TAGS[panel]).get(key) for key in TAG_KEYS})
    return target


def config(name: str) -> dict:
    """Returns a yaml file of this package."""
    return yaml.safe_load(config_file(name).read_text(encoding="utf-8"))


def config_file(name: str) -> Path:
    """Raises DeviceError where ROS does not know this package."""
    try:
        return Path(rospkg.RosPack().get_path("vision")) / "config" / name
    except rospkg.ResourceNotFound:
        raise DeviceError("ROS does not know the package vision: source devel/setup.bash.") from None
