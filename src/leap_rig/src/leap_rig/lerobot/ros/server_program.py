"""The program lerobot_server.py: lets LeRobot's programs see the rig, and with --moves move it.

In a namespace, __ns, it serves the arm of that namespace."""

from __future__ import annotations

import argparse
import math
import os
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import rospy
from geometry_msgs.msg import Point, Pose, Quaternion
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from std_srvs.srv import SetBool

from common import clock
from common.command_line import whole
from common.errors import DeviceError, RigError
from common.frames import BASE, TOOL_DESIRED, TOOL_MEASURED
from common.robot_hand import HAND, hand_state
from common.ros.compressed_images import jpeg_from_image
from common.ros.files import home
from common.ros.node import join, run_program
from common.ros.policy_input import POLICY_ACTIONS, refuse_second_program
from common.ros.service_calls import call
from common.rotations import steady_quaternion
from common.teleop_record import LED
from kuka_msgs.msg import jointPositions, jointTorquesExternal
from leap_rig.cockpit.frame_poses import Pose7
from leap_rig.lerobot.actions import ACTION, FINGERS, HOLDS_S, JOINTS, POSE, SILENT_S, SLOW_S, action_fault
from leap_rig.lerobot.server import LerobotServer
from leap_rig.recording.dataset import camera_name
from leap_rig.recording.topics import COLOR
from leap_rig.ros.newest import NewestMessages
from reflex_msgs.msg import Hand, RadianServoCommands
from rig_msgs.msg import PolicyActions, TeleopState

ANOTHER_S = 1.0  # without an action for so long, the program that moves the tool gives way to another one
LED_S = 0.5  # after the first action leap_kuka has said whether it leads the tool
RUN_POLICY = "leap_kuka/run_policy"
ANSWER_S, THERE_S, POLL_S = 2.0, 10.0, 0.1


class RigDesk:
    """Answers requests by what the rig has published last."""

    def __init__(self, cameras: Mapping[str, str], quality: int, moves: bool) -> None:
        self._cameras, self._quality, self._moves = cameras, quality, moves
        self._lock = clock.Lock()
        self._newest = NewestMessages()
        self._acted = self._acts_since = self._steered = float("-inf")
        self._steers = self._asked = 0  # connections: the one that moves the tool, the newest that asked to
        if moves:
            self._actions = rospy.Publisher(POLICY_ACTIONS, PolicyActions, queue_size=1, tcp_nodelay=True)
        for topic, kind in (
            ("kuka/joint_positions", jointPositions),
            ("kuka/joint_torques_external", jointTorquesExternal),
            (HAND.state, Hand),
            (HAND.commands[0], RadianServoCommands),
            ("leap_kuka/state", TeleopState),
        ):
            self._newest.hear(topic, kind)
        for name, topic in cameras.items():
            self._newest.hear(topic, Image, name)

    def answer(self, request: Mapping[str, Any], client: int) -> tuple[Mapping[str, Any], Mapping[str, bytes]]:
        """Answers one request of a client, by the number of its connection; raises RigError where it cannot."""
        what = request.get("do")
        if what == "hello":
            return {"moves": self._moves, "action": ACTION, "cameras": list(self._cameras)}, {}
        if what == "observe":
            return {"state": self._state()}, {name: self._image(name) for name in self._cameras}
        if what == "intent":
            return {"action": self._intent()}, {}
        if what == "act" and isinstance(request.get("action"), dict):
            return {"refused": self._act(request["action"], client)}, {}
        raise DeviceError(f"The request is {what!r}, but must be hello, observe, intent, or act with an action.")

    def _state(self) -> dict[str, float]:
        joints = self._newest.of("kuka/joint_positions", SILENT_S)
        torques = self._newest.of("kuka/joint_torques_external", SLOW_S)
        tool = self._tool(TOOL_MEASURED)
        if tool is None:
            raise DeviceError(f"{self._newest.frames(TOOL_MEASURED)} has said nothing, so there is no observation.")
        state = {f"{name}.pos": getattr(joints, f"joint_{i}") for i, name in enumerate(JOINTS, 1)}
        state.update({f"{name}.torque": getattr(torques, f"joint_{i}") for i, name in enumerate(JOINTS, 1)})
        return {**state, **dict(zip(FINGERS, self._angles())), **dict(zip(POSE, tool))}

    def _angles(self) -> list[float]:
        return hand_state(self._newest.of(HAND.state, SILENT_S)).angles.tolist()

    def _image(self, name: str) -> bytes:
        try:
            return bytes(jpeg_from_image(self._newest.of(name, SLOW_S), self._quality).data)
        except ValueError as error:
            raise DeviceError(f"The image of {name} cannot be read: {error}.") from error

    def _tool(self, frame: str) -> Pose7 | None:
        found = self._newest.pose(self._newest.frames(frame), SILENT_S)
        return None if found is None else (*found[:3], *steady_quaternion(found[3:]).tolist())

    def _intent(self) -> dict[str, float]:
        """Returns what the operator wants: the desired tool and the commanded fingers; without, where they are."""
        tool = self._tool(TOOL_DESIRED) or self._tool(TOOL_MEASURED)
        if tool is None:
            raise DeviceError("Nothing says where the tool is, so there is no action.")
        try:
            fingers = list(self._newest.of(HAND.commands[0], SILENT_S).radian_commands)
        except RigError:
            fingers = self._angles()
        return {**dict(zip(POSE, tool)), **dict(zip(FINGERS, fingers))}

    def _act(self, action: Mapping[str, Any], client: int) -> str:
        """Takes an action; returns why it does not, a sentence, or nothing."""
        if not self._moves:
            return "lerobot_server.py runs without --moves, so no action is taken."
        fault = action_fault(action)
        if fault:
            return fault
        x, y, z, *q = (float(action[name]) for name in POSE)
        length = math.hypot(*q)
        pose = Pose(Point(x, y, z), Quaternion(*(part / length for part in q)))
        fingers = [float(action[name]) for name in FINGERS]
        refused = self._refused(client)
        if refused:
            return refused
        header = Header(0, rospy.Time.now(), self._newest.frames(BASE))
        self._actions.publish(PolicyActions(header, HOLDS_S, [pose], fingers))
        return self._not_led()

    def _refused(self, client: int) -> str:
        """Returns why a connection may not move the tool, a sentence; empty if it may. It asks once, at its first
        action: whoever was stopped, or had to wait, connects again."""
        again = "connect again to move it."
        with self._lock:
            if client == self._steers:
                self._steered = clock.monotonic()
                return ""
            if client <= self._asked:
                return f"This program does not move the tool: {again}"
            self._asked = client
            if clock.monotonic() - self._steered < ANOTHER_S:
                return f"Another LeRobot program moves the tool: stop it, then {again}"
        answer = call(RUN_POLICY, SetBool, True, timeout=ANSWER_S)
        if not answer.success:
            return answer.message
        with self._lock:
            if client != self._asked:
                return f"Another LeRobot program moves the tool: {again}"
            self._steers, self._steered = client, clock.monotonic()
        return ""

    def left(self, client: int) -> None:
        """A connection has ended."""
        with self._lock:
            if client == self._steers:
                self._steered = float("-inf")

    def _not_led(self) -> str:
        """Returns why leap_kuka does not lead the tool by the actions that come, a sentence; empty if it does."""
        now = clock.monotonic()
        with self._lock:
            if now - self._acted > HOLDS_S:
                self._acts_since = now
            self._acted = now
            if now - self._acts_since < LED_S:
                return ""
        try:
            state = self._newest.of("leap_kuka/state", SLOW_S)
        except DeviceError:
            return "The action moves nothing: leap_kuka says nothing."
        return "" if state.hold == LED else f"The action moves nothing: {state.reason}."


def main() -> None:
    options = _parser().parse_args(rospy.myargv()[1:])
    run_program("lerobot_server", lambda: serve(options), "Interrupted.")


def serve(options: argparse.Namespace) -> int:
    """Serves until it is interrupted; returns the exit code."""
    join("lerobot_server", anonymous=True)
    if options.moves:
        refuse_second_program()
    interrupted = clock.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: interrupted.set())
    desk = RigDesk({camera_name(topic): topic for topic in options.camera}, options.quality, options.moves)
    name = "_".join(["lerobot", *filter(None, rospy.get_namespace().split("/"))])  # one for each arm
    path = options.socket or Path(os.environ.get("ROS_HOME") or home() / ".ros") / "leap_rig" / f"{name}.sock"
    server = LerobotServer(path, desk.answer, desk.left)
    may = "may move the tool" if options.moves else "only reads"
    print(f"LeRobot {may}, by {path}.", flush=True)
    try:
        if options.moves:
            answer = call(RUN_POLICY, SetBool, True, timeout=ANSWER_S, wait=THERE_S)
            if not answer.success:
                raise DeviceError(answer.message)
        while not interrupted.wait(POLL_S) and not rospy.is_shutdown():
            pass
    finally:
        server.close()
        if options.moves and not rospy.is_shutdown():
            call(RUN_POLICY, SetBool, False, timeout=ANSWER_S)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="lerobot_server.py", description=__doc__.partition("\n")[0])
    parser.add_argument("--moves", action="store_true", help="actions bring the tool where no hand steers it")
    where = "file of the socket (default: ~/.ros/leap_rig/lerobot.sock; lerobot_left.sock in the namespace left)"
    parser.add_argument("--socket", type=Path, metavar="FILE", help=where)
    images = f"topics of its images (default: {COLOR}); none: no images"
    parser.add_argument("--camera", nargs="*", default=[COLOR], metavar="TOPIC", help=images)
    parser.add_argument("--quality", type=whole(10, 100), default=90, help="of the JPEG images [%%], default 90")
    return parser
