"""The program run_policy.py: lets a trained policy steer where no hand does, once leap_kuka/run_policy allows it."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rospy
import torch
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from common import clock
from common.command_line import real
from common.errors import DeviceError, RigError
from common.frames import BASE, TOOL_MEASURED, frame_name
from common.poses import pose
from common.robot_hand import HAND, hand_state
from common.ros.conversions import message_from_pose
from common.ros.images import camera_model_from_info, depth_from_image
from common.ros.node import join, run_program
from common.ros.policy_input import POLICY_ACTIONS
from common.rotations import rotation_from_quaternion
from leap_rig.cockpit.frame_poses import FramePoses
from leap_rig.policy.network import PolicyNetwork, loaded
from leap_rig.policy.view import FINGERS, DepthView, desired_tool, height_map, state_numbers
from leap_rig.recording.topics import DEPTH
from reflex_msgs.msg import Hand
from rig_msgs.msg import PolicyActions

INFO = "/camera/depth/camera_info"
SILENT_S, SLOW_S = 0.3, 3.0  # older measurements, and older images, are not used: a busy machine renders few
READ_BYTES = 2**22  # of a subscriber's buffer: rospy's own is smaller than an image


class PolicyRunner:
    """Publishes a new chunk of actions each `every` s from what the rig has published last."""

    def __init__(self, network: PolicyNetwork) -> None:
        self._network = network
        self._lock = clock.Lock()
        self._newest: dict[str, tuple[float, Any]] = {}
        self._poses = FramePoses()
        self._view: tuple[CameraInfo, DepthView] | None = None
        self._trouble = ""
        self._actions = rospy.Publisher(POLICY_ACTIONS, PolicyActions, queue_size=1, tcp_nodelay=True)
        for topic, kind in ((HAND.state, Hand), (INFO, CameraInfo)):
            rospy.Subscriber(topic, kind, partial(self._keep, topic), queue_size=1, tcp_nodelay=True)
        rospy.Subscriber(DEPTH, Image, partial(self._keep, DEPTH), queue_size=1, buff_size=READ_BYTES)
        for topic in ("/tf", "/tf_static"):
            rospy.Subscriber(topic, TFMessage, partial(self._transforms, topic), queue_size=100, tcp_nodelay=True)

    def run(self, every: float) -> None:
        """Runs until ROS shuts down; says when it cannot act, once."""
        while not rospy.is_shutdown():
            began = clock.monotonic()
            try:
                self._actions.publish(self._message())
                trouble = ""
            except (DeviceError, ValueError) as error:
                trouble = str(error).rstrip(".")
            if trouble.split(" for ")[0] != self._trouble:
                self._trouble = trouble.split(" for ")[0]
                rospy.logwarn("The policy waits: %s.", trouble) if trouble else rospy.loginfo("The policy acts.")
            clock.sleep(max(0.0, every - (clock.monotonic() - began)))

    def _keep(self, key: str, message: Any) -> None:
        with self._lock:
            self._newest[key] = clock.monotonic(), message

    def _transforms(self, topic: str, message: TFMessage) -> None:
        received = float("inf") if topic == "/tf_static" else clock.monotonic()
        with self._lock:
            self._poses.take(message.transforms, received)

    def _of(self, key: str, oldest: float) -> Any:
        with self._lock:
            at, message = self._newest.get(key, (float("-inf"), None))
        age = clock.monotonic() - at
        if message is None or age > oldest:
            raise DeviceError(f"{key} has said nothing {'yet' if message is None else f'for {age:.1f} s'}.")
        return message

    def _pose(self, frame: str) -> np.ndarray:
        """Returns where a frame is in the base; raises DeviceError if that is unknown or old."""
        with self._lock:
            fresh = clock.monotonic() - self._poses.received(frame) < SILENT_S
            chain = self._poses.chain(frame) if fresh else None
        if chain is None or chain[0] != BASE:
            raise DeviceError(f"Nothing says where {frame} is.")
        return pose(rotation_from_quaternion(np.array(chain[1][3:])), np.array(chain[1][:3]))

    def _heights(self, T_base_tool: np.ndarray) -> np.ndarray:
        image, info = self._of(DEPTH, SLOW_S), self._of(INFO, SLOW_S)
        if self._view is None or self._view[0].K != info.K or self._view[0].D != info.D:
            self._view = info, DepthView(camera_model_from_info(info, (image.width, image.height)))
        T_base_camera = self._pose(frame_name(image.header.frame_id))
        return height_map(self._view[1].points(depth_from_image(image), T_base_camera), T_base_tool)

    def _message(self) -> PolicyActions:
        """Returns the actions for what is seen now; raises DeviceError where something is not, and ValueError where
        the network says no pose."""
        stamp, about = rospy.Time.now(), self._network.about
        hand, tool = hand_state(self._of(HAND.state, SILENT_S)), self._pose(TOOL_MEASURED)
        actions = self._network.act(self._heights(tool), state_numbers(tool, hand.angles, hand.contacts))
        poses = [message_from_pose(desired_tool(tool, one)) for one in actions]
        period = 1.0 / about.fps
        header = Header(0, stamp + rospy.Duration.from_sec(period), BASE)
        return PolicyActions(header, period, poses, actions[:, -FINGERS:].ravel().tolist())


def main() -> None:
    options = _parser().parse_args(rospy.myargv()[1:])
    run_program("run_policy", lambda: serve(options), "Interrupted.")


def serve(options: argparse.Namespace) -> int:
    """Runs the policy of a file until ROS shuts down; returns the exit code."""
    torch.set_num_threads(1)
    try:
        network = loaded(options.file.read_bytes())
    except OSError as error:
        raise RigError(f"{options.file} cannot be read: {error.strerror}.") from error
    except RigError as error:
        raise RigError(f"{options.file}: {error}") from error
    join("policy")
    about = network.about
    rospy.loginfo("The policy %s was trained on %d episodes: %s", options.file.name, about.episodes, about.task)
    PolicyRunner(network).run(options.every)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="run_policy.py", description=__doc__.partition("\n")[0])
    parser.add_argument("file", type=Path, metavar="FILE", help="a policy of train_policy.py")
    every = "time between two looks [s], default 0.8: what was said holds meanwhile"
    parser.add_argument("--every", type=real(0.05, 1.5), default=0.8, metavar="S", help=every)
    return parser
