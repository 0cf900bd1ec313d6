"""The node grasp_collection: records depth images and the grasp of the operator that followed, one file an episode.

In: the depth images of the node ggcnn with their camera_info, tf, the state of the robot hand, leap_kuka/state, and
from grasp_execution grasping/state and grasping/outcome. Out: the files, /diagnostics, and the service
grasping/collection_label (std_srvs/SetBool), which sets the last episode aside (false) or takes it back (true).
The network runs here, on the kept frames only, with the parameters of the node ggcnn: its maps before smoothing, which
the refinement needs, have no topic.
"""

from __future__ import annotations

import math

import numpy as np
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import Image
from std_srvs.srv import SetBool, SetBoolResponse

from common import clock
from common.config import parse
from common.errors import ConfigError
from common.frames import BASE, TOOL_DESIRED
from common.robot_hand import HAND, hand_state
from common.ros.compressed_images import depth_topic
from common.ros.conversions import pose_in
from common.ros.diagnostics import Diagnostics
from common.ros.inputs import FaultLog, NodeInputs, clause
from common.ros.node import run
from common.ros.params import private_values
from common.teleop_record import teleop_record
from grasp_msgs.msg import GraspOutcome
from grasping.execution.execution import RUNNING
from grasping.execution.grasp_watch import ObservedGrasp
from grasping.lab.dataset.collector import Collector, Finished
from grasping.lab.dataset.episode import NOWHERE, Episode
from grasping.lab.ros.collection_setup import GGCNN, SECTIONS, CollectionConfig, CollectionSetup, read_setup
from grasping.lab.ros.episode_files import EpisodeFiles
from grasping.lab.ros.frame_reader import FrameReader
from grasping.pipeline.view import NoView
from grasping.ros.execution_io import hand_measurement
from grasping.ros.pose_lookup import PoseLookup
from reflex_msgs.msg import Hand
from rig_msgs.msg import TeleopState


class GraspCollection:
    """Passes messages to the collector, and finished grasps to the files."""

    def __init__(self, setup: CollectionSetup) -> None:
        silent_s = 1.0
        self._setup = setup
        self._object = setup.config.object
        self._T_flange_tool = setup.kuka.T_flange_tool
        self._poses = PoseLookup()
        self._lock = clock.Lock()
        topics = setup.ggcnn.input
        self._inputs = NodeInputs([topics.depth_topic, HAND.state], once=[topics.info_topic], silent=silent_s)
        self._log = FaultLog()
        self._reader = FrameReader(setup, self._poses, self._inputs)
        self._collector = Collector(setup.frames, setup.watch, setup.up)
        self._files = EpisodeFiles(setup.folder, self._written)
        self._T_base_camera = NOWHERE
        self._fingers = np.full(4, np.nan)
        self._unused = {"images": "", "hand": ""}  # why what comes is not used
        self._episodes = self._held = self._on_robot = 0
        self._inputs.subscribe(*depth_topic(topics.depth_topic, self._on_depth))
        self._inputs.subscribe(HAND.state, Hand, self._on_hand, queue_size=10)
        rospy.Subscriber("leap_kuka/state", TeleopState, self._on_teleop, queue_size=10)
        rospy.Subscriber("grasping/state", DiagnosticStatus, self._on_state, queue_size=10)
        rospy.Subscriber("grasping/outcome", GraspOutcome, self._on_outcome, queue_size=10)
        rospy.Service("grasping/collection_label", SetBool, self._on_label)
        Diagnostics("grasp_collection", self._diagnose)
        rospy.loginfo("Episodes go to %s.", setup.folder)

    def close(self) -> None:
        with self._lock:
            if self._collector.waiting:
                rospy.loginfo("%d frames that no grasp labelled are dropped.", self._collector.waiting)
        self._files.close()

    def _on_depth(self, message: Image) -> None:
        try:
            self._take_image(message)
        except (ValueError, NoView, tf2_ros.TransformException) as error:
            self._unused["images"] = clause(error)

    def _take_image(self, message: Image) -> None:
        """Keeps a frame; raises ValueError, NoView or TransformException that names what is missing."""
        stamp = message.header.stamp
        if stamp.is_zero():
            raise ValueError("the image has no stamp")
        with self._lock:
            self._take_time(rospy.Time.now())
            if not self._collector.due(stamp.to_sec()):
                return
            teleop, fingers = self._collector.teleop, self._fingers
        placed = self._reader.place(message)
        self._unused["images"] = ""
        with self._lock:
            if not self._collector.wants(stamp.to_sec(), placed.T_base_tool):
                return
        seen = self._reader.look(placed)
        if seen.on_robot:
            self._on_robot += 1
            return
        frame = seen.frame._replace(
            T_base_tool_desired=self._desired(stamp) if teleop else NOWHERE,
            finger_angles=fingers,
            teleop_active=teleop,
        )
        with self._lock:
            self._T_base_camera = placed.T_base_camera
            if self._collector.add(frame, seen.optics):
                rospy.logwarn("The camera changed: the frames before are dropped.")

    def _desired(self, stamp: rospy.Time) -> np.ndarray:
        try:
            return self._poses.at(TOOL_DESIRED, stamp)
        except tf2_ros.TransformException:
            return NOWHERE

    def _on_hand(self, message: Hand) -> None:
        stale_s = 0.5
        now = rospy.Time.now()
        try:
            T_base_tool = self._poses.flange(stale_s) @ self._T_flange_tool
        except (ValueError, tf2_ros.TransformException) as error:
            self._unused["hand"] = f"the state of the hand is ignored: {clause(error)}"
            return
        self._unused["hand"] = ""
        with self._lock:
            self._take_time(now)
            self._fingers = hand_state(message).angles
            finished = self._collector.hand(hand_measurement(message), T_base_tool, now.to_sec())
        self._store(finished)

    def _on_teleop(self, message: TeleopState) -> None:
        with self._lock:
            self._collector.stream(teleop_record(message).running)

    def _on_state(self, message: DiagnosticStatus) -> None:
        values = {value.key: value.value for value in message.values}
        with self._lock:
            self._collector.executing(values.get("state") in RUNNING)

    def _on_outcome(self, message: GraspOutcome) -> None:
        if not message.tool.header.frame_id:
            rospy.loginfo("The proposal %d makes no episode: %s", message.proposal.id, message.reason)
            return
        try:
            T_base_tool = pose_in(BASE, message.tool)
        except ValueError as error:
            rospy.logerr("An outcome on grasping/outcome is invalid: %s.", error)
            return
        with self._lock:
            grasp = ObservedGrasp(message.header.stamp.to_sec(), T_base_tool, message.held, message.reason)
            proposal = message.proposal
            finished = self._collector.outcome(grasp, proposal.quality if proposal.own_approach else math.nan)
        self._store(finished)

    def _take_time(self, now: rospy.Time) -> None:
        """The lock is held."""
        if self._collector.went_back(now.to_sec()):
            rospy.logwarn("Time went back: the frames before are dropped.")

    def _store(self, finished: Finished | None) -> None:
        if finished is None:
            return
        grasp, frames, setup = finished.grasp, finished.frames, self._setup
        tool = self._T_flange_tool, setup.T_tool_grasp
        if frames is None:
            rospy.logwarn(
                "A grasp makes no episode: no frame was kept since the operator began; in %d so far GGCNN took the "
                "robot for an object.",
                self._on_robot,
            )
            return
        metadata = setup.metadata(grasp, finished.source, self._object_name(), frames.optics.real, self._T_base_camera)
        self._files.put(frames.episode(grasp, metadata, *tool, lift=finished.lift))

    def _object_name(self) -> str:
        """Returns the name of the object now; the last one while the parameter is no text."""
        try:
            self._object = parse(CollectionConfig, private_values(), "~", others=(*SECTIONS, GGCNN)).object
        except ConfigError as error:
            rospy.logerr("The object is still called %s: %s", self._object, error)
        return self._object

    def _written(self, episode: Episode, file, size: int) -> None:
        self._episodes += 1
        self._held += episode.held
        about, held = episode.metadata, "held" if episode.held else "not held"
        written = f"{len(episode)} frames, {1e-6 * size:.1f} MB in {file}"
        rospy.loginfo(f"Episode {self._episodes} ({about.object}, {about.source}): {held}. {written}. {about.reason}")

    def _on_label(self, request: SetBool) -> SetBoolResponse:
        success, sentence = self._files.keep_last(request.data)
        rospy.loginfo(sentence)
        return SetBoolResponse(success, sentence)

    def _diagnose(self) -> tuple[int, str, dict[str, object]]:
        values = {
            "episodes": self._episodes,
            "held": self._held,
            "lost": self._files.lost,
            "waiting": self._files.waiting,
            "frames_kept": self._collector.kept,
            "frames_on_hand": self._on_robot,
            "frames_waiting": self._collector.waiting,
            "folder": self._setup.folder,
        }
        if self._files.fault:
            return DiagnosticStatus.ERROR, self._files.fault, values
        fault = self._log(self._inputs.missing() or self._unused["images"] or self._unused["hand"])
        if fault:
            return DiagnosticStatus.WARN, fault, values
        return DiagnosticStatus.OK, f"{self._episodes} episodes, {self._held} held", values


def _run() -> None:
    node = GraspCollection(read_setup())
    rospy.on_shutdown(node.close)
    rospy.spin()


def main() -> None:
    run("grasp_collection", _run, disposable=True)
