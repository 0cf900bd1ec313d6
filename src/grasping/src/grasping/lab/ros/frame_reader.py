"""Depth images to frames of an episode: what the network sees, with the poses of camera and tool at the stamp."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image

from common.camera_model import CameraModel, camera_model_from_info
from common.frames import FLANGE_MEASURED
from common.ros.images import depth_from_image
from common.ros.inputs import NodeInputs
from grasping.lab.dataset.episode import NOWHERE
from grasping.lab.dataset.frame_buffer import KeptFrame, Optics, look, on_hand
from grasping.lab.ros.collection_setup import CollectionSetup
from grasping.ros.pose_lookup import PoseLookup


class PlacedImage(NamedTuple):
    """A depth image with its camera and the poses at its stamp, shape (4, 4) [m]."""

    message: Image
    camera: CameraModel
    T_base_camera: np.ndarray
    T_base_tool: np.ndarray


class SeenFrame(NamedTuple):
    """A frame as it is kept; without an operator: no desired tool, fingers unknown."""

    frame: KeptFrame
    optics: Optics
    on_robot: bool  # whether GGCNN took the robot for an object: its map does not tell where an operator grasps


class FrameReader:
    """Reads the depth images of the setup's camera with its network."""

    def __init__(self, setup: CollectionSetup, poses: PoseLookup, inputs: NodeInputs) -> None:
        self._setup, self._poses = setup, poses
        self._views, self._live = setup.ggcnn.views(), setup.ggcnn.steps(setup.up)
        self._info: CameraInfo | None = None
        inputs.subscribe(setup.ggcnn.input.info_topic, CameraInfo, self._on_info)

    def place(self, message: Image) -> PlacedImage:
        """Returns an image with its camera and poses; raises ValueError or TransformException for what is missing."""
        stamp, wait = message.header.stamp, self._setup.config.tf_wait
        if stamp.is_zero():
            raise ValueError("the image has no stamp")
        if self._info is None:
            raise ValueError(f"nothing has come on {rospy.resolve_name(self._setup.ggcnn.input.info_topic)}")
        camera = camera_model_from_info(self._info, (message.width, message.height))
        T_base_camera = self._poses.at(message.header.frame_id, stamp, wait)
        T_base_tool = self._poses.at(FLANGE_MEASURED, stamp, wait) @ self._setup.kuka.T_flange_tool
        return PlacedImage(message, camera, T_base_camera, T_base_tool)

    def look(self, placed: PlacedImage) -> SeenFrame:
        """Returns what the network sees; raises ValueError or NoView for an image of no use."""
        depth, camera = depth_from_image(placed.message), placed.camera
        view = self._views.step(depth, camera)
        kept, T_view_own = look(self._setup.network, view, self._live)
        T_base_view = placed.T_base_camera @ view.T_camera_view
        frame = KeptFrame(
            stamp=placed.message.header.stamp.to_sec(),
            **kept._asdict(),
            T_base_camera=T_base_view,
            T_base_tool_measured=placed.T_base_tool,
            T_base_tool_desired=NOWHERE,
            finger_angles=np.full(4, np.nan),
            teleop_active=False,
        )
        on_robot = T_view_own is not None and on_hand(
            (T_base_view @ T_view_own)[:3, 3], placed.T_base_tool, self._setup.frames
        )
        return SeenFrame(frame, Optics(view.camera, view.image.crop, camera), on_robot)

    def _on_info(self, message: CameraInfo) -> None:
        self._info = message
