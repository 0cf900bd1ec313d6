"""What the cockpit's scene shows, from the topics that RViz's presets show."""

from __future__ import annotations

import contextlib
import math
import struct
from collections.abc import Sequence
from pathlib import Path

import rospkg
import rospy
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from common import clock
from common.frames import (
    BASE,
    FLANGE_DESIRED,
    FLANGE_HOME,
    FLANGE_MEASURED,
    HAND,
    RGB_OPTICAL,
    TOOL_COMMANDED,
    TOOL_DESIRED,
    TOOL_HOME,
    VIRTUAL_LEAP,
    ArmFrames,
    frame_name,
)
from common.ros.node import repeat
from common.ros.on_demand import OnDemand
from common.ros.raw_tf import RawTfMessage
from common.ros.service_calls import MasterLost, ask_master
from leap_rig.cockpit.cloud import CloudFault, thinned
from leap_rig.cockpit.markers import MOST_MARKERS, MarkerStore
from leap_rig.cockpit.robot_tree import DescriptionFault
from leap_rig.cockpit.scene import SceneServer
from leap_rig.recording.topics import RECORDED
from rig_msgs.msg import SentGoals

PERIOD_S = 1.0 / 15.0
SLOW = 3  # markers but those of hands are read in each third period
CLOUD_PERIOD_S = 2.0
DESCRIPTION_PERIOD_S, CHANGE_PERIOD_S = 3.0, 15.0  # until all robots are described; then
JOINTS = 7
DESCRIPTION = "robot_description"
PACKAGE = "package://"
OF_AN_ARM = ("kuka/workspace", "kuka/guard_markers", "leap_kuka/interaction_box", "operator_view/hands",
             "operator_view/markers")  # fmt: skip
OF_THE_RIG = ("leap_motion/visualization_marker_array", "simulation/objects", "simulation/contacts", "ggcnn/markers",
              "grasping/proposal_marker")  # fmt: skip
HIDDEN = {"kuka/guard_markers": ("robot",), "operator_view/markers": ("text",)}
"""Namespaces that are not drawn: bodies that hide the robot, and the rows, which the page shows beside the scene."""
CLOUD = "camera/depth_registered/points"
NAMED_AXES = {VIRTUAL_LEAP: "virtual Leap", TOOL_DESIRED: "desired tool"}
PLAIN_AXES = (BASE, HAND, TOOL_COMMANDED, TOOL_HOME, FLANGE_DESIRED, FLANGE_HOME, FLANGE_MEASURED)


class SceneFeed:
    """Listens between `start` and `stop`, as long as somebody looks, and passes on what changes visibly. `arms`: the
    namespaces of the arms, empty for an only one."""

    def __init__(self, scene: SceneServer, arms: Sequence[str] = ("",)) -> None:
        self._scene, self._arms = scene, arms
        self._lock = clock.Lock()
        self._listen = OnDemand(self._subscribe)
        self._listen_cloud = OnDemand(lambda: [rospy.Subscriber(CLOUD, PointCloud2, self._take_cloud, queue_size=1)])
        self._transforms: dict[str, tuple] = {}  # what came since the scene was shown last
        self._arrays: dict[str, list] = {}
        self._tick = 0
        self._commanded: dict[str, Sequence[float]] = {}
        self._cloud: tuple | None = None
        self._markers: dict[str, MarkerStore] = {}
        self._described: dict[str, str] = {}
        self._descriptions: dict[str, str] = {}  # that are not shown yet
        self._said: set[str] = set()
        self._on, self._next_description, self._next_cloud = False, 0.0, 0.0
        for arm in arms:
            frames = ArmFrames(arm)
            for frame, name in NAMED_AXES.items():
                scene.show_axes(frames(frame), 0.08, f"{arm} {name}".strip())
            for frame in PLAIN_AXES:
                scene.show_axes(frames(frame), 0.04)
            scene.show_axes(RECORDED + frames(TOOL_DESIRED), 0.08, f"{arm} recorded desired tool".strip())
        scene.show_axes(RGB_OPTICAL, 0.06, "camera")
        repeat(self._show, PERIOD_S, "scene")
        repeat(self._follow, PERIOD_S, "scene's topics")  # beside the other: rospy waits for a master that hangs

    def start(self) -> None:
        """Listens from now on; no effect while it does."""
        if not self._on:
            self._on, self._next_description, self._next_cloud = True, 0.0, 0.0

    def stop(self) -> None:
        """Listens no more; what was shown last stays in the scene."""
        self._on = False

    def _follow(self) -> None:
        """Subscribes and unsubscribes, and reads descriptions, while the master answers."""
        on, now = self._on, clock.monotonic()
        self._listen.follow(on)
        # One message of the cloud at a time: its node computes none that nobody wants.
        self._listen_cloud.follow(on and now >= self._next_cloud)
        if on and now >= self._next_description:
            self._read_descriptions()
            all_known = len(self._described) == len(self._arms)
            self._next_description = now + (CHANGE_PERIOD_S if all_known else DESCRIPTION_PERIOD_S)

    def _subscribe(self) -> list[rospy.Subscriber]:
        of_arms = [f"{arm}/{topic}".lstrip("/") for arm in self._arms for topic in OF_AN_ARM]
        topics = (*of_arms, *OF_THE_RIG)
        return [
            rospy.Subscriber("/tf", RawTfMessage, self._take_tf),
            rospy.Subscriber("/tf_static", RawTfMessage, lambda message: self._take_tf(message, True)),
            *(rospy.Subscriber(topic, MarkerArray, self._take_markers, topic, queue_size=5) for topic in topics),
            *(
                rospy.Subscriber(f"{arm}/kuka/sent_goals".lstrip("/"), SentGoals, self._take_goals, arm, queue_size=5)
                for arm in self._arms
            ),
        ]

    def _take_tf(self, message: RawTfMessage, static: bool = False) -> None:
        now = math.inf if static else clock.monotonic()
        with self._lock, contextlib.suppress(struct.error, UnicodeDecodeError):
            self._transforms.update((t.child, (t.parent, t.numbers, now)) for t in message.raw_transforms())

    def _take_markers(self, message: MarkerArray, topic: str) -> None:
        with self._lock:
            self._arrays[topic] = [*self._arrays.get(topic, ()), *message.markers][-MOST_MARKERS:]

    def _take_goals(self, message: SentGoals, arm: str) -> None:
        with self._lock:
            self._commanded[arm] = message.joints[-JOINTS:]

    def _take_cloud(self, cloud: PointCloud2) -> None:
        self._next_cloud = clock.monotonic() + CLOUD_PERIOD_S
        try:
            points, colours = thinned(cloud)
        except CloudFault as fault:
            self._say(f"The point cloud is not drawn: {fault}.")
            return
        with self._lock:
            self._cloud = frame_name(cloud.header.frame_id), points, colours

    def _show(self) -> None:
        if not self._on:
            return
        now = clock.monotonic()
        with self._lock:
            descriptions, self._descriptions = self._descriptions, {}
            transforms, self._transforms = self._transforms, {}
            self._tick = (self._tick + 1) % SLOW
            due = [topic for topic in self._arrays if not self._tick or topic.endswith("hands")]
            arrays = {topic: self._arrays.pop(topic) for topic in due}
            commanded, self._commanded = self._commanded, {}
            cloud, self._cloud = self._cloud, None
        scene = self._scene
        for arm, text in descriptions.items():
            try:
                scene.set_robot(arm, text, read_mesh)
            except (DescriptionFault, OSError) as fault:
                self._say(str(fault))
        for child, (parent, numbers, at) in transforms.items():
            scene.put_transform(parent, child, numbers, at)
        for arm, joints in commanded.items():
            scene.set_commanded(arm, joints)
        for topic, markers in arrays.items():
            if topic not in self._markers:
                self._markers[topic] = MarkerStore(HIDDEN.get("/".join(topic.split("/")[-2:]), ()))
            for fault in self._markers[topic].take(markers, now):
                rospy.logwarn("%s: %s", topic, fault)
        with scene.together():
            for topic, store in self._markers.items():
                scene.set_drawings(topic, store.drawings(now))
            if cloud is not None:
                scene.set_cloud(*cloud)
            scene.update(now)

    def _read_descriptions(self) -> None:
        """Takes the robots of the parameter server, which may come or change while the scene is shown."""
        for arm in self._arms:
            try:
                text = ask_master("getParam", rospy.resolve_name(f"{arm}/{DESCRIPTION}".lstrip("/")))
            except MasterLost:
                return  # nothing new can be shown
            if isinstance(text, str) and text != self._described.get(arm):
                self._described[arm] = text
                with self._lock:
                    self._descriptions[arm] = text

    def _say(self, fault: str) -> None:
        if fault not in self._said:
            self._said.add(fault)
            rospy.logwarn("%s", fault)


def read_mesh(address: str) -> str:
    """Returns the text of a mesh, package://NAME/PATH; raises OSError."""
    package, _, path = address.partition(PACKAGE)[2].partition("/")
    try:
        folder = Path(rospkg.RosPack().get_path(package)).resolve()
    except rospkg.ResourceNotFound:
        raise FileNotFoundError(f"{address} cannot be read: there is no package {package!r}.") from None
    file = (folder / path).resolve()
    if folder not in file.parents:
        raise FileNotFoundError(f"{address} is no file of the package {package!r}.")
    return file.read_text(encoding="utf-8")
