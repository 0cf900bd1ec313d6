"""The parameters of the node grasp_collection, and what is made of them before the first picture."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rospkg
import rospy
import torch

from common.config import flag, integer, number, parse, path, required, text
from common.mounting import mounting_field, rotation_of_mounting
from common.ros.params import wait_for_param
from common.tool import ToolConfig
from grasping.dataset.configuration import grasp_in_tool
from grasping.dataset.frame_buffer import FrameBufferConfig
from grasping.dataset.grasp_watch import GraspWatchConfig
from grasping.predictor import frozen
from grasping.ros.weight_files import load_network
from grasping.settings import NetworkConfig
from grasping.tool_pose import ToolPoseConfig

SECTIONS = {
    "network": NetworkConfig,
    "frames": FrameBufferConfig,
    "watch": GraspWatchConfig,
    "tool_pose": ToolPoseConfig,
}
GIT_S = 5.0


@dataclass(frozen=True)
class CollectionConfig:
    """Private parameters beside the SECTIONS."""

    folder: str = path(doc="folder of the episodes; empty: leap_rig/grasps in ROS's home, ~/.ros")
    object: str = text(doc="what is grasped; may be set anew while the node runs")
    operator: str = text(doc="who teleoperates")
    crop_side: int = integer("px", low=32, high=4096, doc="window in the middle of the depth picture")
    crop_rows_up: int = integer("px", low=-2048, high=2048, doc="how far the window stands above the middle")
    tf_wait: float = number("s", above=0.0, high=5.0, doc="how long the places at a picture's time are waited for")
    from_bag: bool = flag(doc="start the recording that collection_bag is about to play")


@dataclass(frozen=True)
class KukaConfig(ToolConfig):
    """What the parameters under kuka/ tell of the arm."""

    robot: str = text(doc="LBR7R800 or LBR14R820")
    flange: str = text(doc="media flange")
    mounting: np.ndarray = mounting_field()
    dh_parameters: str = path(absent="", doc="file of a calibrated arm")

    @property
    def identity(self) -> dict[str, Any]:
        """Robot, flange, mounting and calibrated parameters as JSON can hold them."""
        values = {key: getattr(self, key) for key in ("robot", "flange", "dh_parameters")}
        return {**values, "mounting": self.mounting.tolist()}


@dataclass(frozen=True, eq=False)
class CollectionSetup:
    """All that the node needs.

    Attributes:
        config: its own parameters.
        frames: which frames are kept.
        watch: how a grasp is seen.
        kuka: the arm and its tool.
        T_tool_grasp: grasp in the tool, shape (4, 4) [m].
        up: the vertical in the base frame, shape (3,).
        network: ready to be run.
        weights_sha256: of its file.
        folder: of the episodes.
        version, revision: of this package.
    """

    config: CollectionConfig
    frames: FrameBufferConfig
    watch: GraspWatchConfig
    kuka: KukaConfig
    T_tool_grasp: np.ndarray
    up: np.ndarray
    network: torch.jit.ScriptModule
    weights_sha256: str
    folder: Path
    version: str
    revision: str


def read_setup() -> CollectionSetup:
    """Returns the setup; waits for the parameters of the arm.

    Raises:
        RigError: a parameter is wrong, or the weight file cannot be used.
    """
    values = rospy.get_param("~", {})
    config = parse(CollectionConfig, values, prefix="~", others=SECTIONS)
    sections = {name: parse(schema, values.get(name, {}), f"~{name}/") for name, schema in SECTIONS.items()}
    rospy.loginfo("%s; %s", config, "; ".join(str(section) for section in sections.values()))
    loaded = load_network(sections["network"])
    torch.set_num_threads(sections["network"].threads)
    for name in required(KukaConfig):
        wait_for_param(f"kuka/{name}")
    given = rospy.get_param("kuka")
    kuka = parse(KukaConfig, given, "kuka/", others=given)
    package = rospkg.RosPack()
    return CollectionSetup(
        config=config,
        frames=sections["frames"],
        watch=sections["watch"],
        kuka=kuka,
        T_tool_grasp=grasp_in_tool(sections["tool_pose"]),
        up=rotation_of_mounting(kuka.mounting)[2],
        network=frozen(loaded.network),
        weights_sha256=loaded.sha256,
        folder=Path(config.folder) if config.folder else Path(rospkg.get_ros_home()) / "leap_rig" / "grasps",
        version=package.get_manifest("grasping").version,
        revision=revision(package.get_path("grasping")),
    )


def revision(folder: str) -> str:
    """Returns the commit that last changed the folder, with a plus if it was changed since; empty outside of git."""
    answers = []
    for question in (("log", "-1", "--format=%H"), ("status", "--porcelain")):
        try:
            answers.append(
                subprocess.run(
                    ("git", "-C", folder, *question, "--", "."),
                    capture_output=True,
                    text=True,
                    timeout=GIT_S,
                    check=True,
                ).stdout.strip()
            )
        except (OSError, subprocess.SubprocessError):
            return ""
    commit, changes = answers
    return f"{commit}+" if commit and changes else commit
