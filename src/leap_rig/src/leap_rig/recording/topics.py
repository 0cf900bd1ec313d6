"""What a recording holds: topics by purpose."""

from __future__ import annotations

from common.frames import FLANGE_DESIRED, HAND_FILTERED, TOOL_DESIRED
from common.frames import HAND as HAND_FRAME
from common.robot_hand import HAND

RAW_FRAMES = "/leap_motion/raw_frames"
SENT_GOALS = "/kuka/sent_goals"
JOINTS = "/kuka/joint_positions"
HAND_STATE = f"/{HAND.state}"
HAND_COMMAND, RAW_HAND_COMMAND = (f"/{topic}" for topic in HAND.commands)
TF = "/tf"
COLOR = "/camera/rgb/image_raw"
DEPTH, DEPTH_INFO = "/camera/depth/image", "/camera/depth/camera_info"

EPISODE_MARK = "/cockpit/episode_mark"

INPUTS = (RAW_FRAMES, "/leap_kuka/operator_input", "/kuka/move/goal", EPISODE_MARK)
COMMANDS = (SENT_GOALS, HAND_COMMAND, RAW_HAND_COMMAND, "/kuka/gripper_control")
STATES = (
    *(JOINTS, "/kuka/joint_torques_external", "/kuka/joint_torques_measured", "/kuka/flange_force"),
    *("/kuka/flange_torque", "/kuka/mode", "/kuka/status", "/kuka/guard", "/kuka/move/result", HAND_STATE),
    *("/leap_kuka/stream", "/leap_kuka/state", "/operator_view/rows", "/grasping/state", "/grasping/outcome"),
    *("/diagnostics", "/rosout", "/simulation/status", "/simulation/scenario", "/simulation/object_states"),
)
VIEW = (
    *(TF, "/tf_static", "/joint_states", "/kuka/workspace", "/kuka/guard_markers", "/leap_kuka/interaction_box"),
    *("/operator_view/hands", "/operator_view/markers", "/simulation/objects", "/simulation/contacts"),
)
"""What RViz draws. None of these topics moves anything, but for frames in /tf (`DRIVING`)."""
CAMERA = {
    "off": (),
    "color": (COLOR, "/camera/rgb/camera_info"),
    "rgbd": (COLOR, "/camera/rgb/camera_info", DEPTH, DEPTH_INFO),
}
DRIVING = (TOOL_DESIRED, FLANGE_DESIRED, HAND_FRAME, HAND_FILTERED)
"""Frames that steer an arm, or follow from one that does."""
RECORDED = "recorded/"  # before their names in a replay


def recorded(camera: str) -> tuple[str, ...]:
    """Returns the topics of a recording with the images of `camera`, a key of CAMERA."""
    return (*INPUTS, *COMMANDS, *STATES, *VIEW, *CAMERA[camera])
