"""Records the rig's topics and tf while the demo runs."""

from __future__ import annotations

import struct
from collections import deque

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from common import clock
from common.config import parse
from common.frames import BASE, TOOL_COMMANDED, TOOL_DESIRED, ArmFrames, frame_name
from common.modes import Mode
from common.mounting import ToolConfig
from common.robot_hand import HAND, hand_state
from common.ros.conversions import pose_from_message, pose_from_transform
from common.ros.diagnostics import STAGE_TIMES
from common.ros.raw_tf import data_of, encoded
from common.teleop_record import teleop_record
from leap_motion.ros.tracking import ReceivedPalms
from leap_rig.report.recorder import Recorder
from reflex_msgs.msg import Hand
from rig_msgs.msg import ObjectStates, TeleopState

STAGE_TIME = struct.Struct("<7I")
"""A TimeReference as `StageTimes` writes it, up to its source: seq, stamp, length of the empty frame_id, time_ref,
length of the source."""


class RigListener:
    """Feeds a Recorder. `mode` is the controller's mode; `arm`: of several, its namespace and its names' prefix."""

    def __init__(self, recorder: Recorder, arm: str = "") -> None:
        self.recorder = recorder
        self._of = of = f"{arm}/" if arm else ""
        self._base, self._desired, self._commanded = map(ArmFrames(arm), (BASE, TOOL_DESIRED, TOOL_COMMANDED))
        self._encoded = {name: (encoded(name), encoded(f"/{name}")) for name in (self._desired, self._commanded)}
        self.mode = ""
        self.sentences: deque[str] = deque()  # of the tutorial, not yet shown
        self._owner: tuple[int, bool] | None = None  # id of the hand that steers, and whether it is a left one
        self._lock = clock.Lock()
        self._T_flange_tool: np.ndarray | None = None
        self._subscribers: list[rospy.Subscriber] = []
        self._frames: dict[str, bytes] = {}  # the newest tf message with each of the tool's frames
        for topic, kind, callback, queue in (
            *((topic, rospy.AnyMsg, self._locked(self._stage), 500) for topic in {STAGE_TIMES, of + STAGE_TIMES}),
            (f"{of}leap_kuka/state", TeleopState, self._locked(self._teleop), 50),
            ("/diagnostics", DiagnosticArray, self._locked(self._diagnostics), 50),
            (f"{of}simulation/status", DiagnosticStatus, self._locked(self._simulation), 10),
            ("/tf", rospy.AnyMsg, self._locked(self._transforms), 100),
            (f"{of}simulation/flange", rospy.AnyMsg, self._sampled(PoseStamped, self._flange, 0.03), 1),
            ("simulation/object_states", rospy.AnyMsg, self._sampled(ObjectStates, self._objects, 0.1), 1),
            (f"{of}simulation/scenario", DiagnosticStatus, self._locked(self._scenario), 10),
            ("leap_rig/tutorial", DiagnosticStatus, self._locked(self._tutorial), 10),
            (f"{of}kuka/mode", String, self._locked(self._mode), 50),
            (of + HAND.state, rospy.AnyMsg, self._sampled(Hand, self._hand, 0.1), 1),
            ("leap_motion/leap_device", rospy.AnyMsg, self._sampled(ReceivedPalms, self._palm, 0.02), 1),
        ):
            self._subscribers.append(rospy.Subscriber(topic, kind, callback, queue_size=queue))

    def stop(self) -> None:
        for subscriber in self._subscribers:
            subscriber.unregister()

    def _locked(self, callback):
        def run(message) -> None:
            with self._lock:
                callback(message)

        return run

    def _sampled(self, kind, callback, period: float):
        """Returns a callback of a rospy.AnyMsg subscriber that reads one message in `period` [s]: the report needs no
        more, and to read a message costs more than to receive it."""
        due = 0.0

        def run(message: rospy.AnyMsg) -> None:
            nonlocal due
            now = clock.monotonic()
            if now >= due:
                due = max(due + period, now)
                with self._lock:
                    callback(kind().deserialize(data_of(message)))

        return run

    def _stage(self, message: rospy.AnyMsg) -> None:
        data = data_of(message)
        _, stamp_s, stamp_ns, _, done_s, done_ns, length = STAGE_TIME.unpack_from(data)
        stage = data[STAGE_TIME.size : STAGE_TIME.size + length].decode()
        self.recorder.stage(stage, stamp_s + 1e-9 * stamp_ns, done_s + 1e-9 * done_ns)

    def _teleop(self, message: TeleopState) -> None:
        record = teleop_record(message)
        self._owner = record.owner
        self.recorder.stream(record.running, record.reason, clock.monotonic(), record.codes)

    def _palm(self, human: ReceivedPalms) -> None:
        for hand in human.hands:
            if self._following and (hand.id, hand.is_left) == self._owner:
                self.recorder.palms.add(human.stamp.to_sec(), hand.palm.tolist())

    @property
    def _following(self) -> bool:
        return self.mode == Mode.SERVO and (self.recorder.streaming or not self.recorder.teleoperated)

    def _diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name = status.name[len(self._of) :] if status.name.startswith(self._of) else status.name
            self.recorder.status(name, _values(status))

    def _simulation(self, status: DiagnosticStatus) -> None:
        self.recorder.status("simulation", _values(status))

    def _scenario(self, status: DiagnosticStatus) -> None:
        self.recorder.set_scenario(_values(status))

    def _objects(self, message: ObjectStates) -> None:
        for state in message.objects:
            T_world_object = pose_from_message(state.pose)
            self.recorder.add_object(state.name, T_world_object, state.clearance, state.touches, clock.monotonic())

    def _tutorial(self, message: DiagnosticStatus) -> None:
        self.recorder.set_scenario(_values(message))
        self.sentences.append(message.message)

    def _mode(self, message: String) -> None:
        self.mode = message.data

    def _hand(self, message: Hand) -> None:
        self.recorder.hand(hand_state(message).angles)

    def _flange(self, message: PoseStamped) -> None:
        if self._T_flange_tool is None:
            kuka = rospy.get_param(f"{self._of}kuka")
            self._T_flange_tool = parse(ToolConfig, kuka, f"{self._of}kuka/", others=kuka).T_flange_tool
        T_base_tool = pose_from_message(message.pose) @ self._T_flange_tool
        if self._following:
            self.recorder.tools.add(message.header.stamp.to_sec(), T_base_tool[:3, 3].tolist())
        targets = [self._fresh(frame) if self._following else None for frame in (self._desired, self._commanded)]
        self.recorder.tool(T_base_tool, *targets)

    def _transforms(self, message: rospy.AnyMsg) -> None:
        """Keeps the messages that are needed, as bytes: to read all of them costs more than all else here."""
        data = data_of(message)
        for frame, forms in self._encoded.items():
            if any(form in data for form in forms):
                self._frames[frame] = data

    def _fresh(self, frame: str) -> np.ndarray | None:
        """Returns the pose of the frame in the base, shape (4, 4), or None where it is missing or old. Its publisher
        sends the frames between the two in the same message."""
        # An older frame no longer steers the arm.
        fresh_s = 0.2
        if frame not in self._frames:
            return None
        transforms = {frame_name(t.child_frame_id): t for t in TFMessage().deserialize(self._frames[frame]).transforms}
        T, name, oldest = np.eye(4), frame, rospy.Time.now() - rospy.Duration.from_sec(fresh_s)
        while name != self._base:
            transform = transforms.pop(name, None)
            if transform is None or transform.header.stamp < oldest:
                return None
            T, name = pose_from_transform(transform.transform) @ T, frame_name(transform.header.frame_id)
        return T


def _values(status: DiagnosticStatus) -> dict[str, str]:
    return {v.key: v.value for v in status.values}
