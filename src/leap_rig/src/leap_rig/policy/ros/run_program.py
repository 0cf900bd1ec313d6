"""The program run_policy.py: lets a trained policy steer where no hand does, once leap_kuka/run_policy allows it.

In a namespace, __ns, it steers the arm of that namespace."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import rospy
import torch
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from common import clock
from common.camera_model import camera_model_from_info, same_camera
from common.command_line import real
from common.errors import DeviceError, RigError
from common.frames import BASE, TOOL_MEASURED, frame_name
from common.poses import check_pose, pose
from common.robot_hand import HAND, hand_state
from common.ros.conversions import message_from_pose
from common.ros.images import depth_from_image
from common.ros.node import join, run_program
from common.ros.policy_input import POLICY_ACTIONS, refuse_second_program
from common.rotations import rotation_from_quaternion
from common.sentences import without_numbers
from leap_rig.policy.network import PolicyNetwork, loaded
from leap_rig.policy.view import FAR_M, FINGERS, NEAR_M, DepthView, desired_tool, height_map, state_numbers
from leap_rig.recording.topics import DEPTH, DEPTH_INFO
from leap_rig.ros.newest import NewestMessages
from reflex_msgs.msg import Hand
from rig_msgs.msg import PolicyActions

SILENT_S, SLOW_S = 0.3, 3.0  # older measurements, and older images, are not used: a busy machine renders few


class PolicyRunner:
    """Publishes a new chunk of actions each `every` s from what the rig has published last."""

    def __init__(self, network: PolicyNetwork) -> None:
        self._network = network
        self._newest = NewestMessages()
        self._view: DepthView | None = None
        self._trouble = ""
        self._actions = rospy.Publisher(POLICY_ACTIONS, PolicyActions, queue_size=1, tcp_nodelay=True)
        for topic, kind in ((HAND.state, Hand), (DEPTH_INFO, CameraInfo), (DEPTH, Image)):
            self._newest.hear(topic, kind)

    def run(self, every: float) -> None:
        """Runs until ROS shuts down; says when it cannot act, once."""
        while not rospy.is_shutdown():
            began = clock.monotonic()
            try:
                self._actions.publish(self._message())
                trouble = ""
            except (DeviceError, ValueError) as error:
                trouble = str(error).rstrip(".")
            except rospy.ROSException:
                if not rospy.is_shutdown():  # then the topics close meanwhile
                    raise
                return
            kind = without_numbers(trouble)
            if kind != self._trouble:
                self._trouble = kind
                rospy.logwarn("The policy waits: %s.", trouble) if trouble else rospy.loginfo("The policy acts.")
            clock.sleep(max(0.0, every - (clock.monotonic() - began)))

    def _pose(self, frame: str) -> np.ndarray:
        """Returns where a frame is in the arm's base; raises DeviceError if that is unknown or old, or ValueError."""
        found = self._newest.pose(frame, SILENT_S)
        if found is None:
            raise DeviceError(f"Nothing says where {frame} is in {self._newest.frames(BASE)}.")
        return check_pose(pose(rotation_from_quaternion(np.array(found[3:])), np.array(found[:3])))

    def _heights(self, T_base_tool: np.ndarray) -> np.ndarray:
        image, info = self._newest.of(DEPTH, SLOW_S), self._newest.of(DEPTH_INFO, SLOW_S)
        camera = camera_model_from_info(info, (image.width, image.height))
        if self._view is None or not same_camera(self._view.camera, camera):
            self._view = DepthView(camera)
        T_base_camera = self._pose(frame_name(image.header.frame_id))
        points = self._view.points(depth_from_image(image), T_base_camera)
        if not len(points):
            raise DeviceError(f"{DEPTH} shows nothing at {NEAR_M:g} to {FAR_M:g} m.")
        return height_map(points, T_base_tool)

    def _message(self) -> PolicyActions:
        """Returns the actions for what is seen now; raises DeviceError where something is not, and ValueError where
        it cannot be, or the network says no pose."""
        stamp, about = rospy.Time.now(), self._network.about
        hand, tool = hand_state(self._newest.of(HAND.state, SILENT_S)), self._pose(self._newest.frames(TOOL_MEASURED))
        state = state_numbers(tool, hand.angles, hand.contacts)
        if not np.isfinite(state).all():
            raise ValueError("the angles of the hand's motors are not all finite")
        actions = self._network.act(self._heights(tool), state)
        poses = [message_from_pose(desired_tool(tool, one)) for one in actions]
        period = 1.0 / about.fps
        header = Header(0, stamp + rospy.Duration.from_sec(period), self._newest.frames(BASE))
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
    about = network.about
    if options.every > about.chunk / about.fps:
        lasts = f"what the policy says lasts {about.chunk / about.fps:g} s"
        raise RigError(f"--every is {options.every:g} s, but {lasts}, so it would stand between; choose less.")
    join("policy", anonymous=True)
    refuse_second_program()
    rospy.loginfo("The policy %s was trained on %d episodes: %s", options.file.name, about.episodes, about.task)
    PolicyRunner(network).run(options.every)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="run_policy.py", description=__doc__.partition("\n")[0])
    parser.add_argument("file", type=Path, metavar="FILE", help="a policy of train_policy.py")
    every = "time between two looks [s], default 0.8: what was said holds meanwhile"
    parser.add_argument("--every", type=real(0.05, 1.5), default=0.8, metavar="S", help=every)
    return parser
