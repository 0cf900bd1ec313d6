"""A folder with images of the marker board and the truth, written by `rosrun rig_simulation panel_pictures.py`."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rospkg
import yaml

from apriltag_ros.settings import TAG_KEYS, TagTarget, targets
from common.camera_model import CameraModel, from_calibration
from common.errors import DeviceError
from common.poses import check_pose
from common.ros.files import read_text
from common.ros.images import metres_from_millimetres

INDEX = "pictures.json"
TAGS = {"bundle": "tags.yaml", "single": "tags_single.yaml"}


@dataclass(frozen=True, eq=False)
class BoardImagePair:
    """A colour and a depth image of the marker board with the truth."""

    grey: np.ndarray
    depth: np.ndarray
    distance: float
    tilt: float
    T_rgb_board: np.ndarray


@dataclass(frozen=True, eq=False)
class BoardImageSet:
    """A folder of images."""

    folder: Path
    entries: list[dict]  # the description of each pair
    plate: float  # edge of the marker board [m]
    rgb: CameraModel
    depth: CameraModel
    T_rgb_depth: np.ndarray  # pose of the depth camera in the colour camera, shape (4, 4) [m]

    def pairs(self) -> Iterator[BoardImagePair]:
        """Reads one pair after the other; raises DeviceError if a file is missing, or is not an image."""
        for entry in self.entries:
            grey = cv2.imread(str(self.folder / entry["colour"]), cv2.IMREAD_GRAYSCALE)
            depth = cv2.imread(str(self.folder / entry["depth"]), cv2.IMREAD_UNCHANGED)
            if grey is None or depth is None or depth.dtype != np.uint16:
                names = f"{entry['colour']} and {entry['depth']} in {self.folder}"
                raise DeviceError(f"{names} are not a colour and a depth image: render the folder again.")
            distance, tilt, T = float(entry["distance"]), float(entry["tilt"]), check_pose(entry["T_rgb_panel"])
            yield BoardImagePair(grey, metres_from_millimetres(depth), distance, tilt, T)


def read_images(folder: Path) -> BoardImageSet:
    """Returns the content of a folder; raises DeviceError if its index is missing or incomplete."""
    try:
        index = json.loads(read_text(folder / INDEX))
        entries, plate = list(index["pictures"]), float(max(index["panel"]["size"]))
        rgb, depth = from_calibration(index["rgb"]), from_calibration(index["depth"])
        return BoardImageSet(folder, entries, plate, rgb, depth, check_pose(index["T_rgb_depth"]))
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        fault = f"{folder / INDEX} does not describe images: {type(error).__name__}: {error}."
        raise DeviceError(f"{fault} Fill the folder with rosrun rig_simulation panel_pictures.py.") from None


def render_images(folder: Path, board: str, *options: str) -> None:
    """Lets the simulation fill a folder with images of a board, bundle or single, with further options of
    panel_pictures.py; raises DeviceError if it fails."""
    timeout_s = 1800.0  # maximum time for rendering the images
    command = ["rosrun", "rig_simulation", "panel_pictures.py", str(folder), "--panel", board]
    command += ["--rgb", str(config_file("xtion_rgb.yaml")), "--depth", str(config_file("xtion_depth.yaml")), *options]
    try:
        code = subprocess.run(command, timeout=timeout_s, check=False).returncode
    except FileNotFoundError:
        raise DeviceError("rosrun is not installed: source devel/setup.bash, or give a folder of images.") from None
    except subprocess.TimeoutExpired:
        raise DeviceError(f"Rendering took longer than {timeout_s:g} s and was stopped: try fewer images.") from None
    if code != 0:
        raise DeviceError(f"No images: {' '.join(command[:3])} exited with code {code}; see its message above.")


@contextmanager
def rendered_images(board: str, *options: str) -> Iterator[Path]:
    """Yields a temporary folder with rendered images; arguments and errors are those of `render_images`."""
    with tempfile.TemporaryDirectory(prefix="board_images") as folder:
        render_images(Path(folder), board, *options)
        yield Path(folder)


def board_target(board: str) -> TagTarget:
    (target,) = targets({key: read_config(TAGS[board]).get(key) for key in TAG_KEYS})
    return target


def read_config(name: str) -> dict:
    return yaml.safe_load(config_file(name).read_text(encoding="utf-8"))


def config_file(name: str) -> Path:
    """Returns the path of a file in config/; raises DeviceError if ROS does not find this package."""
    try:
        return Path(rospkg.RosPack().get_path("vision")) / "config" / name
    except rospkg.ResourceNotFound:
        raise DeviceError("ROS does not find the package vision: source devel/setup.bash.") from None
