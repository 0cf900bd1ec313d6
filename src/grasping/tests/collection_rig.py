"""A rig for grasp_collection without devices: publishes, tick by tick, what a rig would while an operator grasps."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import yaml
from episodes import CAMERA, DOWN

from common import clock
from common.poses import pose, translation
from common.rotations import rotation_about

CONFIG = Path(__file__).parents[1] / "config"
KUKA = Path(__file__).parents[2] / "kuka_control" / "config" / "kuka_params_rt.yaml"
CAMERA_FRAME = "camera_depth_optical_frame"
TICK_S = 0.05
IMAGE_EVERY = 3  # ticks
TOOL_LENGTH_M = yaml.safe_load(KUKA.read_text())["tool_length"]
OPEN, FIST = 0.0, 1.8
GRASP_Z = 0.4


def tool(z: float) -> np.ndarray:
    """The tool points down, below the camera."""
    return pose(rotation_about(0, np.pi), (0.52, -0.4, z))


def grasp(touched: bool = True) -> list[tuple]:
    """What the operator does: (seconds, bend of the fingers, touched, height of the tool before, and after)."""
    return [
        (0.5, OPEN, False, GRASP_Z + 0.1, GRASP_Z + 0.1),
        (2.0, OPEN, False, GRASP_Z + 0.1, GRASP_Z),
        (1.5, FIST, touched, GRASP_Z, GRASP_Z),
        (1.0, FIST, touched, GRASP_Z, GRASP_Z + 0.1),
        (1.0, FIST, touched, GRASP_Z + 0.1, GRASP_Z + 0.1),
        (1.0, OPEN, False, GRASP_Z + 0.1, GRASP_Z + 0.1),
    ]


def ticks(phases, tick=TICK_S):
    """Yields bend, touched and height for each tick."""
    for seconds, bend, touched, before, after in phases:
        count = round(seconds / tick)
        for i in range(count):
            yield bend, touched, before + (after - before) * (i + 1) / count


def hand_message(bend: float, touched: bool):
    from reflex_msgs.msg import Hand

    message = Hand()
    for i in range(3):
        message.motor[i].joint_angle = bend
        message.finger[i].pressure[0] = 60.0 if touched else 0.0
    return message


def image() -> np.ndarray:
    """A box on a table, in millimetres."""
    depth = np.full((480, 640), 900, np.uint16)
    depth[220:260, 300:340] = 850
    depth[:, :3] = 0
    return depth


def messages(stamp, bend, touched, z, depth=None) -> list[tuple]:
    """Returns topics and messages of a tick; the image comes last."""
    from tf2_msgs.msg import TFMessage

    from common.ros.conversions import stamped_transform
    from common.ros.images import camera_info_message, image_message

    depth = image() if depth is None else depth
    flange = tool(z) @ translation(0.0, 0.0, -TOOL_LENGTH_M)
    return [
        (
            "/tf",
            TFMessage(
                [
                    stamped_transform(flange, "kuka/base_frame", "kuka/flange_frame/measured", stamp),
                    stamped_transform(tool(z - 0.001), "kuka/base_frame", "kuka/tool_frame/desired", stamp),
                ]
            ),
        ),
        ("/reflex_takktile/hand_state", hand_message(bend, touched)),
        ("/camera/depth/camera_info", camera_info_message(CAMERA, CAMERA_FRAME, stamp)),
        ("/camera/depth/image", image_message(depth, "16UC1", CAMERA_FRAME, stamp)),
    ]


def camera_pose(stamp):
    """The message of /tf_static."""
    from tf2_msgs.msg import TFMessage

    from common.ros.conversions import stamped_transform

    return TFMessage([stamped_transform(DOWN, "kuka/base_frame", CAMERA_FRAME, stamp)])


def teleop(active: bool):
    """The message of leap_kuka/state."""
    from rig_msgs.msg import TeleopState

    return TeleopState(state=TeleopState.RUNNING if active else TeleopState.WAITING)


class PuppetRig:
    """Publishes the tick that it is given, again and again, until it is given another.

    `tick` [s], with an image in one of `image_every`; `silent` are topics and child frames that do not come.
    """

    def __init__(self, tick=TICK_S, image_every=IMAGE_EVERY):
        import rospy
        from diagnostic_msgs.msg import DiagnosticStatus
        from sensor_msgs.msg import CameraInfo, Image
        from tf2_msgs.msg import TFMessage

        from grasp_msgs.msg import GraspOutcome
        from reflex_msgs.msg import Hand
        from rig_msgs.msg import TeleopState

        kinds = {
            "/tf": TFMessage,
            "/reflex_takktile/hand_state": Hand,
            "/camera/depth/camera_info": CameraInfo,
            "/camera/depth/image": Image,
            "/grasping/outcome": GraspOutcome,
        }
        latched = {
            "/tf_static": TFMessage,
            "/leap_kuka/state": TeleopState,
            "/grasping/state": DiagnosticStatus,
        }
        self.publishers = {name: rospy.Publisher(name, kind, queue_size=10) for name, kind in kinds.items()}
        self.publishers.update(
            {name: rospy.Publisher(name, kind, queue_size=1, latch=True) for name, kind in latched.items()}
        )
        self.publishers["/tf_static"].publish(camera_pose(rospy.Time.now()))
        self.say("/leap_kuka/state", teleop(False))
        self.depth = image()
        self.silent: set[str] = set()
        self._tick, self._seconds, self._image_every = (OPEN, False, GRASP_Z + 0.1), tick, image_every
        self._ended = clock.Event()
        self._thread = clock.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def say(self, topic, message) -> None:
        self.publishers[topic].publish(message)

    def perform(self, phases) -> None:
        """Does what the operator does, in its time."""
        for tick in ticks(phases, self._seconds):
            self._tick = tick
            clock.sleep(self._seconds)

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        for publisher in self.publishers.values():
            publisher.unregister()

    def _loop(self) -> None:
        import rospy

        for count in itertools.count():
            if self._ended.wait(self._seconds):
                return
            for topic, message in messages(rospy.Time.now(), *self._tick, self.depth):
                if topic == "/tf":
                    message.transforms = [t for t in message.transforms if t.child_frame_id not in self.silent]
                if topic not in self.silent and (count % self._image_every == 0 or not topic.startswith("/camera")):
                    self.say(topic, message)
