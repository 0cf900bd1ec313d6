"""The program replay.py: a recording to look at, as a tracker for the whole chain, or as a motion of the robot."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import genpy
import numpy as np
import rosgraph
import roslib.message
import rospy
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from common import clock
from common.command_line import real, whole
from common.errors import RigError
from common.frames import BASE
from common.robot_hand import HAND
from common.ros.conversions import stamped_pose
from common.ros.files import file_hash, read_yaml
from common.ros.node import join, run_program
from kuka_control.model.rig import Rig
from kuka_control.numbers import LEAST_PTP
from kuka_control.ros.move_program import carry_out
from kuka_control.ros.parameter_server import dh_deviations, guard_obstacles, master_of_this_graph, parameters
from kuka_msgs.msg import MoveGoal
from leap_motion.codec import DeviceEvent, LeapProtocolError, read_message
from leap_motion.service.server import LeapService, LeapServiceError
from leap_rig.recording.fingerprint import controller_config, differences, fingerprint, moved_away, started_with
from leap_rig.recording.recording_files import PARAMETERS, RecordingFault, StoredMessage, between, folder_of, verify
from leap_rig.recording.run import MessageDecoders, RecordedRun, read
from leap_rig.recording.topics import CAMERA, DRIVING, RECORDED, SENT_GOALS, VIEW
from leap_rig.recording.waypoints import StreamedMotion, lines_along, streamed_motions

LONGEST_WAIT_S = 3600.0  # between two frames
KIND = re.compile(r"(geometry_msgs|sensor_msgs|std_msgs|tf2_msgs|visualization_msgs)/\w+", re.ASCII)
MOVERS = ("/kuka/kuka_control", "/kuka/exit_app", "/kuka/exit_app_emergency", f"/{HAND.driver}/disable_torque")
"""Services of what moves an arm or a hand; of several arms behind their namespaces."""
STEERING = tuple(f"/{frame}" for frame in DRIVING)  # ends of their names, of several arms behind a prefix
DESCRIPTION = "robot_description"
AGREED = "yes"


def main() -> None:
    options = _parser().parse_args(rospy.myargv()[1:])
    run_program("replay", lambda: replay(options), "The replay was interrupted.", (RigError, LeapServiceError))


def replay(options: argparse.Namespace) -> int:
    """Checks the files and plays; returns the exit code."""
    folder = folder_of(options.name)
    manifest, remark = verify(folder)
    if remark:
        print(remark, file=sys.stderr)
    if options.view:
        return view(folder, options)
    if options.tracker:
        return serve(folder, options)
    return move(folder, manifest, options)


# RViz


def view(folder: Path, options: argparse.Namespace) -> int:
    """Publishes what RViz draws, where nothing can move."""
    check_s = 0.5  # a controller that starts during --view is seen after this time
    master = master_of_this_graph()
    _refuse_movers(master)
    join("leap_rig_replay", anonymous=True)
    _describe(folder)
    player = _Player(options.rate)
    rviz, browser = "rviz -d $(rospack find leap_rig)/rviz/rig.rviz", "rosrun leap_rig cockpit_node.py"
    print(f"Plays {folder}; look with: {rviz}, or in a browser with: {browser}")
    checked, shown = clock.monotonic(), False
    images = [topic for topics in CAMERA.values() for topic in topics]
    for message, due in _paced(between(folder, (*VIEW, *images), options.start, options.end), options.rate):
        while True:
            now = clock.monotonic()
            if now - checked > check_s:
                checked = now
                _refuse_movers(master)
            if due <= now:
                break
            clock.sleep(min(due - now, check_s))
        player.publish(message)
        shown |= not message.kind.is_latched
    if not shown:
        raise RecordingFault(f"{folder} has nothing that RViz draws from {options.start:g} to {options.end:g} s.")
    return 0


def _paced(messages: Iterable[StoredMessage], rate: float) -> Iterator[tuple[StoredMessage, float]]:
    """Yields messages with their times [s, monotonic]; what a latched topic said before the start comes first."""
    began, first = clock.monotonic(), None
    for message in messages:
        if not message.kind.is_latched:
            first = message.received if first is None else first
        yield message, began + (0.0 if first is None else 1e-9 * (message.received - first) / rate)


def _refuse_movers(master: rosgraph.Master) -> None:
    """Raises RecordingFault where a controller or a driver runs: a view belongs on a master without a rig."""
    try:
        _, _, offered = master.getSystemState()
    except (OSError, rosgraph.MasterException) as error:
        raise RecordingFault("The ROS master is gone, so nothing is shown any more.") from error
    services = {name: nodes for name, nodes in offered if name.endswith(MOVERS)}
    if services:
        nodes = ", ".join(sorted({node for names in services.values() for node in names}))
        raise RecordingFault(
            f"{nodes} runs on this ROS master, so nothing is shown here: the view would mix with the real state. "
            "Use a master of its own: ROS_MASTER_URI=http://localhost:11312 for roscore -p 11312, RViz and replay.py."
        )


def _describe(folder: Path) -> None:
    """Sets the robot description of the recording for RViz, unless one is set already."""
    if not rospy.has_param(DESCRIPTION):
        recorded = read_yaml(folder / PARAMETERS)
        if isinstance(recorded, dict) and isinstance(recorded.get(DESCRIPTION), str):
            rospy.set_param(DESCRIPTION, recorded[DESCRIPTION])


class _Player:
    """Publishes recorded messages with stamps of now; frames that steer an arm get another name."""

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._first: rospy.Time | None = None
        self._begin = rospy.Time.now()
        self._publishers: dict[str, rospy.Publisher | None] = {}
        self._static: dict[str, object] = {}

    def publish(self, message: StoredMessage) -> None:
        """Publishes one message; a topic whose type is not this workspace's is left out, with a sentence."""
        topic, kind = message.topic, message.kind
        if topic not in self._publishers:
            found = self._class(kind.name)
            if found is None or found._md5sum != kind.md5sum:
                self._leave_out(topic, f"{kind.name} is another message here")
            else:
                publisher = rospy.Publisher(topic, found, latch=kind.is_latched, queue_size=100)
                self._publishers[topic] = publisher
        publisher = self._publishers[topic]
        if publisher is None:
            return
        try:
            value = publisher.data_class().deserialize(message.data)
        except genpy.DeserializationError as error:
            self._leave_out(topic, f"a message cannot be read: {error}")
            return
        self._restamp(value)
        if isinstance(value, TFMessage):
            for transform in value.transforms:
                transform.child_frame_id = _harmless(transform.child_frame_id)
                transform.header.frame_id = _harmless(transform.header.frame_id)
            if kind.is_latched:  # one latched message holds what several nodes sent
                self._static.update((t.child_frame_id, t) for t in value.transforms)
                value = TFMessage(list(self._static.values()))
        publisher.publish(value)

    def _class(self, kind: str) -> type | None:
        """Returns the class of a message that RViz draws. The library would import a module of any name."""
        return roslib.message.get_message_class(kind) if KIND.fullmatch(kind) else None

    def _leave_out(self, topic: str, reason: str) -> None:
        print(f"replay: {topic} is left out: {reason}.", file=sys.stderr)
        self._publishers[topic] = None

    def _restamp(self, value: object) -> None:
        latest_ns = (2**32 - 1) * 10**9  # of ROS time
        if isinstance(value, Header):
            if value.stamp:
                self._first = self._first or value.stamp
                after = (value.stamp - self._first).to_nsec() / self._rate
                value.stamp = rospy.Time(0, min(max(self._begin.to_nsec() + round(after), 1), latest_ns))
        elif isinstance(value, list):
            if value and hasattr(value[0], "__slots__"):
                for item in value:
                    self._restamp(item)
        elif hasattr(value, "__slots__"):
            for slot in value.__slots__:
                self._restamp(getattr(value, slot))


def _harmless(frame: str) -> str:
    name = frame.strip("/")  # tf takes /a for a
    return RECORDED + name if f"/{name}".endswith(STEERING) else frame


# Tracker


def serve(folder: Path, options: argparse.Namespace) -> int:
    """Serves the raw frames as the Leap service did, at their pace, to the driver."""
    client_s = 60.0  # a driver is waited for so long
    after_s = 0.5  # the service sends nothing for so long before it ends
    poll_s = 0.05
    run = read(folder, options.start, options.end)
    if not run.frames:
        raise RecordingFault(f"{folder} has no tracker frames in this time.")
    version, serial = _service(folder)
    protocol = "2.3" if version.startswith("2") else "gemini"
    service = LeapService("127.0.0.1", options.port, protocol, version, serial, simulated=True)
    thread = clock.Thread(target=service.run, name="service", daemon=True)
    thread.start()
    try:
        print(f"Serves {len(run.frames)} frames on 127.0.0.1:{service.port}; the arm follows them if control is on.")
        deadline = clock.monotonic() + client_s
        while not service.clients:
            if clock.monotonic() > deadline:
                raise RecordingFault(f"Nobody connected to port {service.port} within {client_s:g} s.")
            clock.sleep(poll_s)
        clock.sleep(after_s)
        _send(run, service, options.rate)
        clock.sleep(after_s)
    finally:
        service.stop()
        thread.join(2.0)
    print(f"Sent {service.sent} frames; {service.lost} were not taken in time.")
    return 0


def _send(run: RecordedRun, service: LeapService, rate: float) -> None:
    due = clock.monotonic()
    for text, step in zip(run.frames, np.diff(run.frame_times, prepend=run.frame_times[0])):
        due += min(max(float(step), 0.0), LONGEST_WAIT_S) / rate  # a clock that was set back makes no burst
        clock.sleep(max(due - clock.monotonic(), 0.0))
        event = _event(text)
        if event is not None:
            service.plug(event.attached)
        else:
            service.offer(text if rate == 1.0 else _at_pace(text, rate))


def _event(text: str) -> DeviceEvent | None:
    if '"event"' not in text:
        return None
    try:
        message = read_message(text)
    except LeapProtocolError:
        return None
    return message if isinstance(message, DeviceEvent) else None


def _at_pace(text: str, rate: float) -> str:
    """Returns the frame with its device time slowed; a text that is no frame as it is."""
    try:
        frame = json.loads(text)
        if type(frame["timestamp"]) not in (int, float):
            return text
        return json.dumps({**frame, "timestamp": int(frame["timestamp"] / rate)}, separators=(",", ":"))
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return text


def _service(folder: Path) -> tuple[str, str]:
    """Returns version and serial of the service, as the driver reported them; empty where it did not know."""
    decode, known = MessageDecoders(), {}
    for message in between(folder, ["/diagnostics"], 0.0, float("inf")):
        try:
            for status in decode(message)["status"]:
                if status["name"] == "leap_motion":
                    known.update((pair["key"], str(pair["value"])) for pair in status["values"])
        except (KeyError, TypeError) as error:
            raise RecordingFault(f"A message on /diagnostics is not one of this rig: {error!r}.") from error
    version, serial = known.get("service_version", ""), known.get("serial", "")
    return version if re.match(r"\d", version) else "", "" if serial == "unknown" else serial


# Robot


def move(folder: Path, manifest: dict, options: argparse.Namespace) -> int:
    """Moves the robot along the recorded path by kuka/move: first slowly, then at the rate; each pass is agreed to."""
    slowly = 0.2  # rate of the first pass on the robot
    share = 0.95  # of tcp_speed, for the fastest line
    lost = manifest.get("dropped", {}).get(SENT_GOALS, 0)
    if lost:
        raise RecordingFault(
            f"Nothing moves: {lost} messages with goals are missing, because the disk was too slow for the recording; "
            "the arm would take short cuts."
        )
    values = parameters("kuka")
    started = values.get("running")
    if started is None:
        raise RecordingFault("Nothing moves: no controller of the arm has started on this ROS master.")
    running, files = started_with(values)
    found = differences(manifest.get("robot"), fingerprint(running, lambda path: files.get(path, "")))
    found += [f"{path} was changed after the controller read it." for path in files if file_hash(path) != files[path]]
    if found:
        raise RecordingFault("\n".join(["Nothing moves, because this is not the robot of the recording:", *found]))
    config = controller_config(running)
    fastest = share * getattr(config, "tcp_speed", 0.0)
    if not fastest:
        raise RecordingFault("Nothing moves: straight lines need the real-time controller.")
    usual = config.velocity_ptp_slow
    run = read(folder, options.start, options.end)
    kinematics = Rig.of(config, dh_deviations(config), guard_obstacles(config)).kinematics
    motions = streamed_motions(run.goal_times, run.goals, run.goal_velocities, kinematics.forward)
    if not motions:
        raise RecordingFault(f"{folder} has no goals of a moving arm in this time.")
    join("leap_rig_replay", anonymous=True)
    print("Robot model, tool, mounting and limits agree with the recording. The hand stays as it is.")
    if elsewhere := moved_away(manifest["robot"], running):
        print(elsewhere)
    for rate in sorted({min(slowly, options.rate), min(options.rate, 1.0)}):
        goals = [goal for motion in motions for goal in _move_goals(motion, rate, fastest, usual)]
        print(
            f"The arm carries out {len(goals)} motions, at {rate:g} of the recorded pace; PTP to where a stream began."
        )
        if not _agrees(f"Is the space around the arm free, and is a hand at the stop? Type {AGREED}: "):
            print("Cancelled; nothing moved.")
            return 1
        if parameters("kuka").get("running") != started:
            raise RecordingFault("Nothing moves: another controller was started meanwhile.")
        for number, goal in enumerate(goals, 1):
            result, interrupted = carry_out(goal)
            if interrupted:
                raise KeyboardInterrupt
            if not result.success:
                raise RecordingFault(f"The replay ends before motion {number} of {len(goals)}: {result.message}")
    print("The arm is at the end of the recording.")
    return 0


def _agrees(question: str) -> bool:
    """Returns whether the operator agrees; at the end of the input, as without a terminal, nobody does."""
    try:
        return input(question).strip() == AGREED
    except EOFError:
        print()
        return False


def _move_goals(motion: StreamedMotion, rate: float, fastest: float, usual: float) -> list[MoveGoal]:
    """Returns the motion to where a stream began, at the `rate` of the `usual` fraction of the joint speed, since
    nothing can stop it, and the lines along it."""
    velocity = max(rate * usual, min(LEAST_PTP, usual))
    goals = [MoveGoal(kind=MoveGoal.JOINTS, joints=motion.q_start.tolist(), velocity=velocity)]
    for line in lines_along(motion.times, motion.poses, rate, fastest):
        pose = stamped_pose(line.T_base_tool, BASE, rospy.Time(0))
        goals.append(MoveGoal(kind=MoveGoal.POSE, pose=pose, straight=True, velocity=line.velocity))
    return goals


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="replay.py", description="Plays a recording; its hashes are checked first.")
    parser.add_argument("name", help="of the recording in ~/.ros/leap_rig/recordings; or a path, with a slash")
    how = parser.add_mutually_exclusive_group(required=True)
    how.add_argument("--view", action="store_true", help="in RViz or the cockpit, on a ROS master without a rig")
    how.add_argument("--tracker", action="store_true", help="as a Leap service, for leap_driver and the whole chain")
    how.add_argument("--robot", action="store_true", help="the arm's motion, first slowly; asks before each pass")
    parser.add_argument(
        "--rate", type=real(0.1, 10.0), default=1.0, metavar="FACTOR", help="pace, 0.1 to 10; --robot at most 1"
    )
    parser.add_argument(
        "--from", dest="start", type=float, default=0.0, metavar="S", help="begin so long after the start"
    )
    parser.add_argument(
        "--to", dest="end", type=float, default=float("inf"), metavar="S", help="end there, seconds after the start"
    )
    parser.add_argument("--port", type=whole(0, 65535), default=6437, help="of --tracker; 0: any free one")
    return parser
