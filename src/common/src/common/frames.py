"""The tf frames of the rig, each name once. They are part of the ROS interface. Below `BASE`: the arm's frames, the
operator's, and the camera's. The links of the robot description (`kuka/link_1`, `reflex/...`) are named in
rig_description; of these, only `BASE` and `FLANGE` are used elsewhere."""

from __future__ import annotations

import re
from dataclasses import dataclass

from common.config import text

WORLD = "world"  # in which several arms stand
BASE = "kuka/base_frame"
FLANGE = "kuka/flange"  # the flange as a link of the robot description
FLANGE_HOME = "kuka/flange_frame/home"
FLANGE_MEASURED = "kuka/flange_frame/measured"
FLANGE_DESIRED = "kuka/flange_frame/desired"
FLANGE_SEEN = "kuka/flange_frame/seen"  # the flange as the camera detects it by the marker board
TOOL_HOME = "kuka/tool_frame/home"
TOOL_MEASURED = "kuka/tool_frame/measured"  # the tool at the measured joints
TOOL_DESIRED = "kuka/tool_frame/desired"  # the input of the arm's controllers
TOOL_COMMANDED = "kuka/tool_frame/commanded"
"""The tool as the controller last sent it to the robot: scaled, and clipped to the workspace."""

VIRTUAL_LEAP = "leap_motion/virtual_frame"
HAND = "hand/frame"  # the operator's hand as the tracker measures it, in `VIRTUAL_LEAP`
HAND_FILTERED = "hand/frame/filtered"  # the same averaged or filtered: the hand that steers
CAMERA_LINK = "camera_link"
RGB, DEPTH = "camera_rgb_frame", "camera_depth_frame"  # the RGB-D camera's two sensors in `CAMERA_LINK`, x forward
RGB_OPTICAL, DEPTH_OPTICAL = "camera_rgb_optical_frame", "camera_depth_optical_frame"
"""The same, z forward: the frames in the headers of the images."""
RGB_ALIAS, DEPTH_ALIAS = "camera/rgb_frame", "camera/depth_frame"  # the rig's own names of the optical frames
GRASP_TARGET = "camera_target_frame"  # the best grasp, in `DEPTH`
GRASP_VIEW = "ggcnn/view"  # the virtual camera whose image the grasp network sees, in an optical frame


def frame_name(text: str) -> str:
    """Returns a frame id, of a message or a parameter, without leading slash: tf of ROS 1 takes /a for a."""
    return text.lstrip("/")


PREFIX = re.compile(r"(\w+(/\w+)*)?", re.ASCII)


@dataclass(frozen=True)
class ArmFrames:
    """The frames of one of several arms: behind its prefix, as left/kuka/base_frame; of an only arm as above."""

    tf_prefix: str = text(
        doc="prefix of an arm's tf frames, where there are two, such as left",
        absent="",
        empty=True,
        taken_as=frame_name,
    )

    def __call__(self, name: str) -> str:
        """Returns what a frame of this module, of arm or operator, is called for this arm."""
        return f"{self.tf_prefix}/{name}" if self.tf_prefix else name

    def faults(self) -> list[str]:
        """Returns what is wrong with the prefix: robot_state_publisher would make another name of it."""
        if PREFIX.fullmatch(self.tf_prefix):
            return []
        allowed = "letters, digits and _, with single slashes between them, such as left"
        return [f"tf_prefix is {self.tf_prefix!r}, but must be {allowed}, or empty."]


ONE_ARM = ArmFrames("")
