"""Records the rig's topics and tf, and shows its state in the terminal while the demo runs."""

from __future__ import annotations

import struct
import sys
import threading
import time

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import TimeReference
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from common.config import parse
from common.frames import BASE, TOOL_COMMANDED, TOOL_DESIRED
from common.mounting import ToolConfig
from common.ros.conversions import pose_from_message, pose_from_transform
from common.ros.diagnostics import STAGE_TIMES
from leap_motion.frames import TrackingFrame
from leap_motion.ros.tracking import LEFT, RIGHT, ReceivedPalms, subscribe
from leap_rig.recorder import Recorder
from reflex_msgs.msg import Hand
from rig_msgs.msg import ObjectStates

ENCODED = {name: struct.pack("<I", len(name)) + name.encode() for name in (TOOL_DESIRED, TOOL_COMMANDED)}
FRESH_S = 0.2
"""An older frame no longer steers the arm."""
CLEAR_LINE = "\r\033[K"
COMPLAINT = "[${severity}] ${node}: ${message}"
"""ROSCONSOLE_FORMAT of the nodes."""


class RigListener:
    """Feeds a Recorder. `mode` is the controller's mode."""

    def __init__(self, recorder: Recorder) -> None:
        self.recorder = recorder
        self.mode = ""
        self._owner: tuple[str, str] | None = None  # number and side of the hand that steers
        self._lock = threading.Lock()
        self._T_flange_tool: np.ndarray | None = None
        self._subscribers: list[rospy.Subscriber] = []
        self._frames: dict[str, bytes] = {}  # the newest tf message with each of the tool's frames
        for topic, kind, callback, queue in (
            (STAGE_TIMES, TimeReference, self._stage, 500),
            ("leap_kuka/stream", DiagnosticStatus, self._stream, 50),
            ("/diagnostics", DiagnosticArray, self._diagnostics, 50),
            ("simulation/status", DiagnosticStatus, lambda m: recorder.status("simulation", _values(m)), 10),
            ("/tf", rospy.AnyMsg, self._transforms, 100),
            ("simulation/flange", PoseStamped, self._flange, 1),
            ("simulation/object_states", ObjectStates, self._objects, 10),
            ("simulation/scenario", DiagnosticStatus, lambda m: recorder.set_scenario(_values(m)), 10),
            ("kuka/mode", String, self._mode, 50),
            ("reflex_takktile/hand_state", Hand, self._hand, 1),
        ):
            self._subscribers.append(rospy.Subscriber(topic, kind, self._locked(callback), queue_size=queue))
        self._subscribers.append(subscribe(self._palm, ReceivedPalms))

    def stop(self) -> None:
        """Stops recording."""
        for subscriber in self._subscribers:
            subscriber.unregister()

    def _locked(self, callback):
        def run(message) -> None:
            with self._lock:
                callback(message)

        return run

    def _stage(self, message: TimeReference) -> None:
        self.recorder.stage(message.source, message.header.stamp.to_sec(), message.time_ref.to_sec())

    def _stream(self, message: DiagnosticStatus) -> None:
        values = _values(message)
        self._owner = values.get("hand_id", ""), values.get("hand_side", "")
        self.recorder.stream(values.get("state") == "running", message.message, time.monotonic())

    def _palm(self, frame: TrackingFrame, stamp: rospy.Time) -> None:
        for hand in frame.hands:
            if self._following and (str(hand.id), LEFT if hand.is_left else RIGHT) == self._owner:
                self.recorder.palms.add(stamp.to_sec(), hand.palm.tolist())

    @property
    def _following(self) -> bool:
        return self.mode == "servo" and self.recorder.streaming

    def _diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.recorder.status(status.name, _values(status))

    def _objects(self, message: ObjectStates) -> None:
        for state in message.objects:
            T_world_object = pose_from_message(state.pose)
            self.recorder.add_object(state.name, T_world_object, state.clearance, state.touches, time.monotonic())

    def _mode(self, message: String) -> None:
        self.mode = message.data

    def _hand(self, message: Hand) -> None:
        self.recorder.hand(np.array([motor.joint_angle for motor in message.motor]))

    def _flange(self, message: PoseStamped) -> None:
        if self._T_flange_tool is None:
            kuka = rospy.get_param("kuka")
            self._T_flange_tool = parse(ToolConfig, kuka, "kuka/", others=kuka).T_flange_tool
        T_base_tool = pose_from_message(message.pose) @ self._T_flange_tool
        if self._following:
            self.recorder.tools.add(message.header.stamp.to_sec(), T_base_tool[:3, 3].tolist())
        targets = [self._fresh(frame) if self._following else None for frame in (TOOL_DESIRED, TOOL_COMMANDED)]
        self.recorder.tool(T_base_tool, *targets)

    def _transforms(self, message: rospy.AnyMsg) -> None:
        """Keeps the messages that are needed, as bytes: to read all of them costs more than all else here."""
        for frame in (TOOL_DESIRED, TOOL_COMMANDED):
            if ENCODED[frame] in message._buff:
                self._frames[frame] = message._buff

    def _fresh(self, frame: str) -> np.ndarray | None:
        """Returns the pose of the frame in the base, shape (4, 4), or None where it is missing or old.

        Its publisher sends the frames between the two in the same message.
        """
        if frame not in self._frames:
            return None
        transforms = {t.child_frame_id: t for t in TFMessage().deserialize(self._frames[frame]).transforms}
        T, name, oldest = np.eye(4), frame, rospy.Time.now() - rospy.Duration.from_sec(FRESH_S)
        while name != BASE:
            transform = transforms.pop(name, None)
            if transform is None or transform.header.stamp < oldest:
                return None
            T, name = pose_from_transform(transform.transform) @ T, transform.header.frame_id
        return T


def _values(status: DiagnosticStatus) -> dict[str, str]:
    return {v.key: v.value for v in status.values}


class LiveStatus:
    """One live line on a terminal, a line every five seconds elsewhere; nodes print their own warnings as COMPLAINT."""

    def __init__(self) -> None:
        self._terminal = sys.stdout.isatty()
        self._period = 0.5 if self._terminal else 5.0
        self._next = 0.0
        self._frames = 0
        self._time = time.monotonic()

    def update(self, listener: RigListener, phase: str) -> None:
        """Prints the state, at most once a period."""
        now = time.monotonic()
        recorder = listener.recorder
        if now < self._next:
            return
        self._next = now + self._period
        rate = max(recorder.frames - self._frames, 0) / max(now - self._time, 1e-3)
        self._frames, self._time = recorder.frames, now
        speed = recorder.counters.get("simulation", {}).get("tcp_speed")
        hand = "steers" if recorder.streaming else "waits"
        text = f"{phase:>8} | arm {listener.mode or '-':<9} | hand {hand:<6} | {rate:4.0f} frames/s"
        if speed is not None:
            text += f" | TCP {1e3 * float(speed):4.0f} mm/s"
        if recorder.scenario is not None:
            text += f" | {recorder.scenario['step']}"
        self._print(text + ("" if self._terminal else "\n"))

    def say(self, sentence: str) -> None:
        """Prints a sentence on a line of its own."""
        self._print(sentence + "\n")

    def finish(self) -> None:
        """Ends the live line."""
        if self._terminal:
            print()

    def _print(self, text: str) -> None:
        print(f"{CLEAR_LINE}{text}" if self._terminal else text, end="", flush=True)
