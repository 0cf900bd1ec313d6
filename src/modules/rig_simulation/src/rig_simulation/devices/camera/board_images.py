"""The program `panel_pictures.py`: colour and depth images of the marker board with their true poses.

The arm holds the board face up, and the camera moves around it: at each distance and tilt, for several units of the
sensor, each with its own errors. Images are PNG files; `pictures.json` describes them completely.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import cv2
import mujoco
import numpy as np

from common.camera_model import from_calibration
from common.command_line import failed, finite, not_negative, positive
from common.config import parse
from common.errors import ConfigError, DeviceError, RigError
from common.frames import CAMERA_LINK, DEPTH_OPTICAL, RGB_OPTICAL
from common.poses import inverse, pose
from common.ros.files import read_yaml
from common.rotations import quaternion_from_rotation, rotation_about, unit
from rig_simulation.devices.camera.rgbd_camera import RgbdCamera
from rig_simulation.files import SOURCE_TREE, read_board, read_scene
from rig_simulation.node_parameters import ColourConfig, DepthConfig
from rig_simulation.world.model import WorldDescription, build_model

NAME = "panel_pictures"
INDEX = "pictures.json"
TURN_OVER = rotation_about(0, np.pi)
"""From MuJoCo's cameras, which look along -z with y up, to optical frames; and from a board to its viewer."""
HALF_VIEW = np.array([0.50, 0.38])  # tangents of half the common field of view of both cameras


class BoardScene:
    """The world with a marker board, a mapping as in its yaml, and a movable camera."""

    def __init__(self, panel: dict) -> None:
        holding_deg = (0.0, 30.0, 0.0, -60.0, 0.0, 0.0, 90.0)  # forearm level, board on top, face up, above the table
        self.model = build_model(WorldDescription("LBR7R800", "MF_elektrisch", (0, 0, 0), read_scene("empty"), panel))
        self.data = mujoco.MjData(self.model)
        for number, angle in enumerate(np.radians(holding_deg), start=1):
            self.data.qpos[self.model.joint(f"kuka/joint_{number}").qposadr[0]] = angle
        self._refresh()
        body = self.data.body("panel")
        self._T_world_panel = pose(body.xmat.reshape(3, 3), body.xpos)
        link = self.data.body(CAMERA_LINK)
        self._T_rgb_link = inverse(self.optical(RGB_OPTICAL)) @ pose(link.xmat.reshape(3, 3), link.xpos)
        self.T_rgb_depth = inverse(self.optical(RGB_OPTICAL)) @ self.optical(DEPTH_OPTICAL)

    def place_camera(self, T_rgb_panel: np.ndarray) -> None:
        """Moves the camera so that it sees the board at the pose, shape (4, 4) [m]."""
        T = self._T_world_panel @ inverse(T_rgb_panel) @ self._T_rgb_link
        link = self.model.body(CAMERA_LINK)
        link.pos, link.quat = T[:3, 3], quaternion_from_rotation(T[:3, :3])[[3, 0, 1, 2]]
        self._refresh()

    def optical(self, name: str) -> np.ndarray:
        """Returns the pose of a camera's optical frame in the world, shape (4, 4) [m]."""
        camera = self.data.camera(name)
        return pose(camera.xmat.reshape(3, 3) @ TURN_OVER, camera.xpos)

    def _refresh(self) -> None:
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)


def random_pose(distance: float, tilt: float, size: float, rng: np.random.Generator) -> np.ndarray:
    """Returns a random pose, shape (4, 4) [m], of a board of edge `size` [m], wholly in the image of the colour camera:
    its centre at `distance` [m], its normal at `tilt` [rad] to the line of sight."""
    room = np.clip(HALF_VIEW - size / np.sqrt(2.0) / distance, 0.0, None)
    sight = unit([*(room * rng.uniform(-1.0, 1.0, 2)), 1.0])
    right = unit(np.cross((0.0, 1.0, 0.0), sight))
    R_look = np.column_stack((right, np.cross(sight, right), sight))
    towards, roll = rng.uniform(-np.pi, np.pi, 2)
    lean = rotation_about(2, towards) @ rotation_about(0, tilt) @ rotation_about(2, -towards)
    return pose(R_look @ lean @ TURN_OVER @ rotation_about(2, roll), distance * sight)


def main(arguments: list[str] | None = None) -> int:
    options = _options(arguments)
    try:
        count = _take(options)
    except (RigError, OSError) as error:
        return failed(NAME, error)
    print(f"{NAME}: {count} pairs of images in {options.folder}", flush=True)
    return 0


def _take(options: argparse.Namespace) -> int:
    panel = read_board(options.panel)
    scene = BoardScene(panel)
    calibrations = {name: _yaml(getattr(options, name)) for name in ("rgb", "depth")}
    rgb, depth = (from_calibration(values) for values in calibrations.values())
    colour_config = parse(ColourConfig, options.config.get("colour"), prefix="colour/")
    depth_config = parse(DepthConfig, options.config.get("depth"), prefix="depth/")
    rng = np.random.default_rng(options.seed)
    options.folder.mkdir(parents=True, exist_ok=True)
    entries: list[dict[str, Any]] = []
    for number in range(options.units):
        samples = int(options.config.get("samples", 0))
        camera = RgbdCamera(rgb, depth, colour_config, depth_config, samples, seed=options.seed + 1 + number)
        try:
            camera.attach(scene.model)
            for distance, tilt, _ in itertools.product(options.distances, options.tilts, range(options.pictures)):
                T = random_pose(distance, np.radians(tilt), float(max(panel["size"])), rng)
                scene.place_camera(T)
                taken = camera.take(scene.data, colour=True, depth=True, registered=False)
                files = [f"{len(entries):04d}_{name}.png" for name in ("colour", "depth")]
                assert taken.colour is not None and taken.depth is not None  # both were requested
                for file, image in zip(files, (taken.colour[..., ::-1], taken.depth)):
                    if not cv2.imwrite(str(options.folder / file), image):
                        raise DeviceError(f"Cannot write the image {options.folder / file}; is the disk full?")
                entry = {"colour": files[0], "depth": files[1], "unit": number, "distance": distance}
                entries.append({**entry, "tilt": tilt, "T_rgb_panel": T.tolist()})
        finally:
            camera.close()
    index = {"panel": panel, **calibrations, "T_rgb_depth": scene.T_rgb_depth.tolist(), "pictures": entries}
    (options.folder / INDEX).write_text(json.dumps(index), encoding="utf-8")
    return len(entries)


def _yaml(path: Path) -> dict:
    values = read_yaml(path)
    if not isinstance(values, dict):
        raise ConfigError([f"The file {path} is not a mapping."])
    return values


def _count(text: str) -> int:
    if not text.isdecimal() or not 0 < int(text) <= 1000:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 1 to 1000")
    return int(text)


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=NAME, description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder for the images")
    parser.add_argument("--rgb", type=Path, required=True, help="calibration file of the colour camera")
    parser.add_argument("--depth", type=Path, required=True, help="calibration file of the depth camera")
    parser.add_argument("--panel", default="bundle", help="a marker board of this package, or a yaml file")
    camera = SOURCE_TREE / "config" / "camera.yaml"
    parser.add_argument("--config", type=Path, default=camera, help="the sensors' errors")
    parser.add_argument("--distances", type=positive, nargs="+", default=[0.5, 1.0, 1.5, 2.0], help="[m]")
    parser.add_argument("--tilts", type=not_negative, nargs="+", default=[0.0, 20.0, 40.0, 60.0], help="[deg]")
    parser.add_argument("--units", type=_count, default=5, help="number of sensor units")
    parser.add_argument("--pictures", type=_count, default=2, help="of each unit at each distance and tilt")
    parser.add_argument("--seed", type=lambda text: int(finite(text)), default=0, help="of poses, units and noise")
    options = parser.parse_args(arguments)
    if max(options.tilts) > 80.0:
        parser.error(f"a tilt of {max(options.tilts):g} deg is more than 80")
    try:
        options.config = _yaml(options.config)
    except ConfigError as error:
        parser.error(str(error))
    return options
