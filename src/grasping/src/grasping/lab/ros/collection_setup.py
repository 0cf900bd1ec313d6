"""The parameters of the node grasp_collection, and the objects made of them at start-up."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import rospkg
import rospy
import torch

from common.camera_model import CameraModel
from common.config import number, parse, path, required, text
from common.mounting import ToolConfig, mounting_field, rotation_of_mounting
from common.ros.params import private_values, wait_for_param
from common.stored_time import utc
from grasping.execution.grasp_watch import GraspWatchConfig, ObservedGrasp
from grasping.lab.dataset.episode import Metadata
from grasping.lab.dataset.frame_buffer import FrameBufferConfig
from grasping.network.networks import MapNetwork, frozen
from grasping.pipeline.settings import GgcnnSettings, overlaid, rig_configuration, settings_from
from grasping.pipeline.tool_pose import grasp_in_tool
from grasping.ros.weight_files import load_network, own_yaml, package_folder

SECTIONS = {"frames": FrameBufferConfig, "watch": GraspWatchConfig}
GGCNN = "ggcnn"  # section with the parameters of the node ggcnn for its network and view


@dataclass(frozen=True)
class CollectionConfig:
    """The node's parameters beside the sections."""

    folder: str = path(doc="folder of the episodes; empty: leap_rig/grasps in ROS's home, ~/.ros")
    object: str = text(doc="name of the grasped object; may be changed while the node runs")
    operator: str = text(doc="who teleoperates")
    tf_wait: float = number("s", above=0.0, high=5.0, doc="longest wait for the poses at an image's time")


@dataclass(frozen=True)
class KukaConfig(ToolConfig):
    """The arm's parameters under kuka/."""

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
    """Everything that the node needs."""

    config: CollectionConfig
    ggcnn: GgcnnSettings  # the network, its view, and the hand on the tool
    frames: FrameBufferConfig
    watch: GraspWatchConfig
    kuka: KukaConfig
    T_tool_grasp: np.ndarray  # shape (4, 4) [m]
    up: np.ndarray  # the vertical in the base frame, shape (3,)
    network: MapNetwork
    weights_sha256: str
    folder: Path  # of the episodes
    version: str  # of this package
    revision: str  # its commit

    def metadata(
        self, grasp: ObservedGrasp, source: str, thing: str, camera: CameraModel, T_base_camera: np.ndarray
    ) -> Metadata:
        """Returns the description of an episode of a grasp, of the real camera and its pose, shape (4, 4) [m]."""
        return Metadata(
            version=self.version,
            revision=self.revision,
            date=utc(grasp.time),
            operator=self.config.operator,
            object=thing,
            source=source,
            reason=grasp.reason,
            configuration=rig_configuration(
                self.kuka.identity, self.kuka.T_flange_tool, self.T_tool_grasp, camera, T_base_camera, self.ggcnn,
                self.weights_sha256,
            ),
        )  # fmt: skip


def read_setup() -> CollectionSetup:
    """Returns the setup by the node's private parameters, as `setup_from` does."""
    return setup_from(private_values())


def default_values() -> dict[str, Any]:
    """Returns the parameters of this package's yaml files, without those that only the user knows."""
    return {**own_yaml("collection.yaml"), GGCNN: {}}


def setup_from(values: Mapping[str, Any]) -> CollectionSetup:
    """Returns the setup, once the arm's parameters are set; raises RigError for a wrong parameter or weight file."""
    config = parse(CollectionConfig, values, prefix="~", others=(*SECTIONS, GGCNN))
    sections = {name: parse(schema, values.get(name, {}), prefix=f"~{name}/") for name, schema in SECTIONS.items()}
    own = {**own_yaml("ggcnn.yaml"), "tool": own_yaml("tool_pose.yaml")}
    settings = settings_from(overlaid(own, values.get(GGCNN, {})), prefix=f"~{GGCNN}/")
    rospy.loginfo("%s; %s", config, "; ".join(str(section) for section in (*sections.values(), settings)))
    loaded = load_network(settings.network)
    torch.set_num_threads(settings.network.threads)
    cv2.setNumThreads(settings.network.threads)
    for name in required(KukaConfig):
        wait_for_param(f"kuka/{name}")
    given = rospy.get_param("kuka")
    kuka = parse(KukaConfig, given, "kuka/", others=given)
    package = package_folder()
    return CollectionSetup(
        config=config,
        ggcnn=settings,
        frames=sections["frames"],
        watch=sections["watch"],
        kuka=kuka,
        T_tool_grasp=grasp_in_tool(settings.tool),
        up=rotation_of_mounting(kuka.mounting)[2],
        network=frozen(loaded.network, precision=settings.network.precision),
        weights_sha256=loaded.sha256,
        folder=Path(config.folder) if config.folder else Path(rospkg.get_ros_home()) / "leap_rig" / "grasps",
        version=ElementTree.parse(package / "package.xml").findtext("version"),
        revision=revision(package),
    )


def revision(folder: Path) -> str:
    """Returns the commit that last changed the folder, with a plus if it was changed since; empty outside of git."""
    git_s = 5.0
    answers = []
    for question in (("log", "-1", "--format=%H"), ("status", "--porcelain")):
        try:
            # A status that writes the index would lock it against the operator, and leave the lock on a full disk.
            command = ("git", "--no-optional-locks", "-C", str(folder), *question, "--", ".")
            found = subprocess.run(command, capture_output=True, text=True, timeout=git_s, check=True)
            answers.append(found.stdout.strip())
        except (OSError, subprocess.SubprocessError):
            return ""
    commit, changes = answers
    return f"{commit}+" if commit and changes else commit
