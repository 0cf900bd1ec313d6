"""The MuJoCo model of robot, table, objects, marker board, camera and light, from a description of the world.

Processes that build it from the same description have the same model; a `WorldCopy` follows the original's state. The
world frame is upright with its origin in the arm's base; with an upright arm it is `kuka/base_frame`.
With several robots the origin is that of the frame `world`, and a robot's names have its prefix: left/kuka/link_1.
Names: bodies and joints of the robot as in its URDF, and `panel` with `panel/plate` and `panel/tag_<id>` on its flange;
`table`, `floor`, `post/<name>`; `object/<name>`, each with a free joint of that name; cameras
`camera_rgb_optical_frame`, `camera_depth_optical_frame`, which look along their own -z with y up, as in MuJoCo: the
optical frames turned by half a turn about x."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from common.arms import arms_from
from common.errors import ConfigError, DeviceError
from common.frames import BASE, CAMERA_LINK, DEPTH_OPTICAL, FLANGE, RGB_OPTICAL, WORLD
from common.mounting import rotation_of_mounting
from common.poses import pose
from common.rotations import rotation_about, unit
from rig_simulation.control_port import ControlClient
from rig_simulation.files import FLANGES, ROBOTS, read_urdf
from rig_simulation.world.hand_model import prepare_hand
from rig_simulation.world.mjcf import BOARD, ROBOT, VISUAL, add_mesh, add_robot, body, child, geom, merge_robot, numbers
from rig_simulation.world.scene import CameraPose, MarkerBoard, add_object, add_table, board_from, scene_from, tag_mesh

TIMESTEP_S = 0.001  # the cycle of the simulated controller
SKY = (0.85, 0.89, 0.93)
WHITE = (0.95, 0.95, 0.95)
BLACK = (0.03, 0.03, 0.03)
R_FLANGE_BOARD = ((-1, 0, 0), (0, 0, 1), (0, 1, 0))
"""Orientation of the board in the flange: its face parallel to the flange's axis, its y axis along the flange's z."""
RGB_IN_LINK, DEPTH_IN_LINK = (0.0, -0.045, 0.0), (0.0, -0.018, 0.0)


@dataclasses.dataclass(frozen=True)
class WorldDescription:
    """All that a process needs to build the model."""

    robot: str  # as in the parameter kuka/robot
    flange: str  # as in the parameter kuka/flange
    mounting: tuple[float, float, float]  # roll, pitch, yaw of the base in the upright world [deg]
    scene: Mapping[str, Any]  # mapping as in the scene's yaml
    # Mapping as in the yaml of the marker board, which has a ring between flange and hand; None: no board
    panel: Mapping[str, Any] | None = None
    # Several of this robot: mapping as in the yaml of common.arms, and `mounting` is not used; None: one, in the origin
    arms: Mapping[str, Any] | None = None
    panel_arm: str = ""  # which of several robots holds the board, by its prefix; an only robot has none

    @property
    def frame(self) -> str:
        """Name of the world's frame in tf, but for the mounting of an only robot."""
        return BASE if self.arms is None else WORLD

    @property
    def placements(self) -> dict[str, np.ndarray]:
        """Poses of the robots' bases in the world, shape (4, 4), by prefix; ConfigError: `arms` is not valid."""
        if self.arms is None:
            return {"": pose(rotation_of_mounting(self.mounting))}
        return {name: arm.T_world_base for name, arm in arms_from(self.arms, "arms/").placements.items()}


def build_model(description: WorldDescription, visuals: bool = True) -> mujoco.MjModel:
    """Returns the model; visual shapes change neither joints nor bodies, and the physics does not need them.

    Raises ConfigError if the scene or the marker board is invalid, FileNotFoundError if there is no description of this
    robot."""
    return mujoco.MjModel.from_xml_string(mjcf(description, visuals))


def mjcf(description: WorldDescription, visuals: bool = True) -> str:
    """Returns the model as MuJoCo's XML; arguments and errors as for `build_model`."""
    floor_below_table = 0.75
    haze = (0.62, 0.67, 0.72)
    floor_colour = (0.45, 0.43, 0.4)
    if description.robot not in ROBOTS or description.flange not in FLANGES:
        raise FileNotFoundError(f"There is no robot {description.robot} with {description.flange}; check both names.")
    scene = scene_from(description.scene)
    root = ET.Element("mujoco", model="rig")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    option = ET.SubElement(root, "option", timestep=str(TIMESTEP_S), integrator="implicitfast")
    option.attrib.update(cone="elliptic", impratio="10")
    ET.SubElement(option, "flag", multiccd="enable")
    visual = ET.SubElement(root, "visual")
    ambient, ahead, above = (numbers([scene.light * part] * 3) for part in (0.35, 0.3, 0.6))
    ET.SubElement(visual, "headlight", ambient=ambient, diffuse=ahead, specular="0 0 0")
    ET.SubElement(visual, "map", znear="0.02", zfar="20")
    ET.SubElement(visual, "quality", shadowsize="0")
    ET.SubElement(visual, "global", offwidth="1280", offheight="1024")
    ET.SubElement(root, "statistic", extent="1", center="0.4 -0.4 0.3")
    sky = ET.SubElement(ET.SubElement(root, "asset"), "texture", type="skybox", builtin="gradient")
    sky.attrib.update(rgb1=numbers(SKY), rgb2=numbers(haze), width="64", height="384")
    world = ET.SubElement(root, "worldbody")
    ET.SubElement(world, "light", pos="0.5 0 2.5", dir="0 0 -1", directional="true", diffuse=above)
    floor = body(world, "floor", pose(p=(0, 0, scene.table.top - floor_below_table)))
    geom(floor, "floor", BOARD, "plane", (5, 5, 0.1), colour=floor_colour)
    add_table(world, scene.table, scene.posts)
    _add_camera(world, scene.camera)
    placements = description.placements
    _check_panel_arm(description, placements)
    for number, (prefix, T_world_base) in enumerate(placements.items()):
        holds = description.panel is not None and prefix == description.panel_arm
        urdf = read_urdf(description.robot, description.flange, ring=holds)
        robot = _alone(urdf, T_world_base, visuals)
        if holds:
            _add_board(robot, child(robot, "worldbody"), board_from(description.panel), visuals)
        merge_robot(root, robot, prefix, number, len(placements))
    for name, shape in scene.objects.items():
        add_object(world, name, shape)
    return ET.tostring(root, encoding="unicode")


def _check_panel_arm(description: WorldDescription, placements: Mapping[str, np.ndarray]) -> None:
    """Raises ConfigError unless exactly one robot holds the marker board, if there is one."""
    arm, names = description.panel_arm, " or ".join(placements)
    if arm and description.panel is None:
        raise ConfigError([f"panel_arm is {arm!r}, but there is no marker board to hold."])
    if description.panel is not None and arm not in placements:
        raise ConfigError([f"panel_arm is {arm!r}, but must be {names or 'left out'}: it holds the marker board."])


def _alone(urdf: str, T_world_base: np.ndarray, visuals: bool) -> ET.Element:
    root = ET.Element("mujoco")
    for section in ("option", "asset"):
        ET.SubElement(root, section)
    add_robot(root, ET.SubElement(root, "worldbody"), urdf, T_world_base, visuals)
    prepare_hand(root)
    return root


def camera_link_pose(camera: CameraPose) -> np.ndarray:
    """Returns the pose of `camera_link` in the world, shape (4, 4): x points at the target, y is level."""
    ahead = unit(camera.target - camera.position)
    left = unit(np.cross((0.0, 0.0, 1.0), ahead))
    return pose(np.column_stack([ahead, left, np.cross(ahead, left)]), camera.position)


def _add_camera(world: ET.Element, camera: CameraPose) -> None:
    camera_size = (0.018, 0.090, 0.018)
    fovy_deg = 45.0  # from the data sheet; the renderers set the intrinsics of their cameras
    link = body(world, CAMERA_LINK, camera_link_pose(camera))
    geom(link, "camera", VISUAL, "box", np.array(camera_size) / 2.0, p=(-camera_size[0], -0.03, 0), colour=BLACK)
    # Looks along x of camera_link, its own y up.
    R_link_camera = rotation_about(2, -np.pi / 2.0) @ rotation_about(0, np.pi / 2.0)
    for name, optical, p in (("rgb", RGB_OPTICAL, RGB_IN_LINK), ("depth", DEPTH_OPTICAL, DEPTH_IN_LINK)):
        mount = body(link, f"camera/{name}", pose(R_link_camera, p))
        ET.SubElement(mount, "camera", name=optical, fovy=str(fovy_deg))


def _add_board(root: ET.Element, world: ET.Element, board: MarkerBoard, visuals: bool) -> None:
    plate_thickness = 0.004
    flange = child(world, f".//body[@name='{FLANGE}']")
    plate = body(flange, "panel", pose(R_FLANGE_BOARD, board.centre))
    half = (*(board.size / 2.0), plate_thickness / 2.0)
    below = (0, 0, -plate_thickness / 2.0)
    geom(plate, "panel/plate", ROBOT, "box", half, p=below, colour=WHITE, mass=0.1, group="1")
    for tag in board.tags if visuals else ():
        name = f"panel/tag_{tag.id}"
        add_mesh(child(root, "asset"), name, *tag_mesh(tag.id, tag.size))
        geom(plate, name, VISUAL, "mesh", None, p=(*tag.position, 0.0), colour=BLACK, mesh=name)


class WorldCopy:
    """The model of the world in the state of the last snapshot: model, data of MuJoCo and the world's `description`,
    once `follow` was called."""

    def __init__(self, client: ControlClient) -> None:
        self._client = client
        self._load: int | None = None
        self.description: WorldDescription
        self.model: mujoco.MjModel
        self.data: mujoco.MjData

    def follow(self) -> bool:
        """Copies the present state of the world; returns whether the model is new. Raises DeviceError if the world
        gives no valid answer; the next call then rebuilds the model."""
        load, self._load = self._load, None
        try:
            snapshot = self._client.ask("snapshot")
            new = snapshot["loads"] != load
            if new:
                fields = self._client.ask("scene")
                load = fields.pop("loads")
                self.description = WorldDescription(**fields)
                self.model = build_model(self.description)
                self.data = mujoco.MjData(self.model)
                snapshot = self._client.ask("snapshot")
            self.data.qpos[:] = snapshot["qpos"]
        except (KeyError, TypeError, ValueError, FileNotFoundError, ConfigError) as error:
            problem = f"The simulated world gave an invalid answer: {type(error).__name__}: {error}."
            raise DeviceError(f"{problem} Is it of another version?") from None
        self._load = load
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        return new
