"""Publishes the state of the arm and its controller from a separate thread, so that a slow subscriber never delays
the stream of servo goals; and the workspace as markers for RViz."""

from __future__ import annotations

import os
import socket
from collections import deque
from dataclasses import dataclass

import numpy as np
import rospy
import tf2_ros
from geometry_msgs.msg import Point, Vector3, Vector3Stamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, ColorRGBA, Header, String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from common import clock
from common.frames import (
    BASE,
    FLANGE_HOME,
    FLANGE_MEASURED,
    ONE_ARM,
    TOOL_COMMANDED,
    TOOL_HOME,
    TOOL_MEASURED,
    WORLD,
    ArmFrames,
)
from common.ros.conversions import stamped_transform
from common.ros.publishing import DirectPublisher
from kuka_control.loop.arm import ArmState
from kuka_control.loop.commands import Step
from kuka_control.model.config import ControllerConfig
from kuka_control.model.rig import Rig
from kuka_control.model.switches import SwitchState
from kuka_control.model.target import MotionScaling
from kuka_control.model.workspace import Workspace, boundary_lines
from kuka_msgs.msg import jointPositions, jointTorquesExternal, jointTorquesMeasured
from rig_msgs.msg import KukaStatus, SentGoals

JOINT_NAMES = [f"kuka/joint_{i}" for i in range(1, 8)]


@dataclass(frozen=True)
class Snapshot:
    arm: ArmState
    step: Step
    switched: SwitchState
    moving_ptp: bool
    moving_rt: bool
    round_trip: float | None
    reckoned: tuple[bool, float] = (False, 0.0)  # as Arm.reckoned
    server: str = ""  # as Arm.server
    abilities: frozenset[str] = frozenset()  # as Arm.abilities
    guided: bool = False  # whether a hand may guide the arm


class GoalPublisher:
    """Publishes what was sent to the robot, while somebody listens."""

    def __init__(self) -> None:
        rate_goals = 1000  # the most goals in a second
        self._publisher = DirectPublisher("kuka/sent_goals", SentGoals, queue_size=100)
        self._goals: deque[tuple[rospy.Time, list[float], float]] = deque(maxlen=10 * rate_goals)

    def sent(self, q: np.ndarray, velocity: float) -> None:
        """Notes a goal, shape (7,) [rad], that was sent now; `velocity` of a PTP motion, else 0. Waits for nothing."""
        if self._publisher.get_num_connections():
            self._goals.append((rospy.Time.now(), q.tolist(), velocity))

    def publish(self) -> None:
        """Publishes the noted goals, from another thread."""
        goals = [self._goals.popleft() for _ in range(len(self._goals))]
        if goals:
            sent, joints, velocity = zip(*goals)
            self._publisher.publish(sent, [angle for q in joints for angle in q], velocity)


class StatePublisher:
    """Publishes kuka/joint_positions at each reading, and everything else at the configured rates."""

    def __init__(self, rig: Rig, config: ControllerConfig, goals: GoalPublisher, frames: ArmFrames = ONE_ARM) -> None:
        self._rig = rig
        self._goals = goals
        self._frames = frames
        self._base, self._flange, self._tool = map(frames, (BASE, FLANGE_MEASURED, TOOL_MEASURED))
        self._raw_force = config.flange_force_raw
        self._period = 1.0 / config.rate_joints
        self._state_period = 1.0 / config.rate_state
        self._newest: Snapshot | None = None
        self._read = clock.Event()
        self._published_joints: np.ndarray | None = None
        self._published = ArmState()
        self._target = None
        self._mode = None
        self._host = socket.gethostname()
        self._pid = os.getpid()
        self._tf = DirectPublisher("/tf", TFMessage, queue_size=100)
        self._static = tf2_ros.StaticTransformBroadcaster()
        self._joint_states = DirectPublisher("joint_states", JointState, queue_size=10)
        self._joints = DirectPublisher("kuka/joint_positions", jointPositions, queue_size=10)
        self._torques_external = DirectPublisher("kuka/joint_torques_external", jointTorquesExternal, queue_size=10)
        self._torques_contact = DirectPublisher("kuka/joint_torques_contact", jointTorquesExternal, queue_size=10)
        self._torques_measured = DirectPublisher("kuka/joint_torques_measured", jointTorquesMeasured, queue_size=10)
        self._force = DirectPublisher("kuka/flange_force", Vector3Stamped, queue_size=10)
        self._torque = DirectPublisher("kuka/flange_torque", Vector3Stamped, queue_size=10)
        # These too, for the last state: rospy's own publisher leaves it to threads, which the exit may cut off.
        self._gripper = DirectPublisher("kuka/gripper_control", Bool, queue_size=10, latch=True)
        self._moving_rt = DirectPublisher("kuka/moving_rt", Bool, queue_size=10, latch=True)
        self._moving_ptp = DirectPublisher("kuka/moving_ptp", Bool, queue_size=10, latch=True)
        self._modes = DirectPublisher("kuka/mode", String, queue_size=50, latch=True)
        self._status = DirectPublisher("kuka/status", KukaStatus, queue_size=10, latch=True)
        self._stop = clock.Event()
        self._thread = clock.Thread(target=self._loop, name="state", daemon=True)

    def start(self, T_world_base: np.ndarray | None = None) -> None:
        """Publishes the home frames once, and the base in world if it is given; starts the publishing thread."""
        home, now = self._rig.home, rospy.Time.now()
        poses = ((home.T_base_flange, FLANGE_HOME), (home.T_base_tool, TOOL_HOME))
        edges = [stamped_transform(T, self._base, self._frames(name), now) for T, name in poses]
        if T_world_base is not None:
            edges.append(stamped_transform(T_world_base, WORLD, self._base, now))
        self._static.sendTransform(edges)
        self._thread.start()

    def show(self, snapshot: Snapshot) -> None:
        """Passes the newest snapshot to the thread and returns immediately; publishes a new mode itself."""
        before, self._newest = self._newest, snapshot
        if (before is None or snapshot.arm.joints is not before.arm.joints) and self._joints.get_num_connections():
            self._read.set()
        if snapshot.step.mode != self._mode:
            self._mode = snapshot.step.mode
            self._modes.publish(self._mode.value)

    def stop(self) -> None:
        """Publishes the last state and stops the thread."""
        self._stop.set()
        self._read.set()
        if self._thread.is_alive():
            self._thread.join(1.0)

    def _loop(self) -> None:
        try:
            self._publish()
        except rospy.ROSException:
            if not rospy.core.is_shutdown_requested():  # during a shutdown the topics close while this thread runs
                raise

    def _publish(self) -> None:
        due = next_state = 0.0
        while not self._stop.is_set():
            self._read.wait(max(due - clock.monotonic(), 0.0))
            self._read.clear()
            snapshot, now = self._newest, clock.monotonic()
            if snapshot is not None:
                self._publish_positions(snapshot.arm.joints)
                if now >= due:
                    self._goals.publish()
                    self._publish_readings(snapshot)
                    if now >= next_state:
                        next_state = now + self._state_period - self._period / 2.0
                        self._publish_state(snapshot)
            if now >= due:
                due = max(due + self._period, now)
        if self._newest is not None:
            self._publish_state(self._newest)

    def _publish_positions(self, joints: np.ndarray) -> None:
        if joints is not self._published_joints:
            self._published_joints = joints
            if self._joints.get_num_connections():
                self._joints.publish(jointPositions(Header(0, rospy.Time.now(), self._base), *joints.tolist()))

    def _publish_readings(self, snapshot: Snapshot) -> None:
        """Publishes joints, frames, torques and forces, each only after a new reading and to a subscriber."""
        arm, before, now, transforms = snapshot.arm, self._published, rospy.Time.now(), []
        self._published = arm
        if arm.joints is not before.joints and self._joint_states.get_num_connections():
            self._joint_states.publish(JointState(Header(0, now, ""), JOINT_NAMES, arm.joints.tolist(), [], []))
        if self._tf.get_num_connections():
            # In motion the robot's controller reports the pose rarely or not, and it does not know the calibration.
            moving = snapshot.moving_rt or snapshot.moving_ptp
            if arm.T_base_tool is None or moving or self._rig.kinematics.calibrated:
                T_base_tool = None if arm.joints is before.joints else self._rig.kinematics.forward(arm.joints)
            else:
                T_base_tool = None if arm.T_base_tool is before.T_base_tool else arm.T_base_tool
            if T_base_tool is not None:
                T_base_flange = self._rig.T_base_flange(T_base_tool)
                transforms.append(stamped_transform(T_base_flange, self._base, self._flange, now))
                transforms.append(stamped_transform(T_base_tool, self._base, self._tool, now))
            target = snapshot.step.target
            if target is not None and target is not self._target:
                self._target = target
                commanded = self._frames(TOOL_COMMANDED)
                transforms.append(stamped_transform(target.T_base_tool, self._base, commanded, now))
            if transforms:
                self._tf.publish(TFMessage(transforms))
        self._publish_forces(snapshot, before, now)

    def _publish_forces(self, snapshot: Snapshot, before: ArmState, now: rospy.Time) -> None:
        """Publishes torques as the robot's controller tells them; contact torques, force and moment without the
        weight of the tool and of what the hand holds, which that controller takes for a force from outside. With
        `flange_force_raw` force and moment keep it."""
        arm, rig = snapshot.arm, self._rig
        known, carried = snapshot.reckoned
        load, payload = rig.load.unknown(known), snapshot.switched.payload - carried
        for publisher, kind, new, old in (
            (self._torques_external, jointTorquesExternal, arm.torques_external, before.torques_external),
            (self._torques_contact, jointTorquesExternal, arm.torques_external, before.torques_external),
            (self._torques_measured, jointTorquesMeasured, arm.torques_measured, before.torques_measured),
        ):
            if new is not None and new is not old and publisher.get_num_connections():
                if publisher is self._torques_contact:
                    new = new - load.torques(arm.joints, payload)
                publisher.publish(kind(Header(0, now, self._base), *new.tolist()))
        for i, publisher, new, old in (
            (0, self._force, arm.force, before.force),
            (1, self._torque, arm.moment, before.moment),
        ):
            if new is not None and new is not old and publisher.get_num_connections():
                if not self._raw_force:
                    new = new - load.wrench(arm.joints, payload)[i]
                vector = rig.T_flange_tool[:3, :3] @ new  # the toolbox reports both in the tool's axes
                publisher.publish(Vector3Stamped(Header(0, now, self._flange), Vector3(*vector.tolist())))

    def _publish_state(self, snapshot: Snapshot) -> None:
        switched, step = snapshot.switched, snapshot.step
        self._gripper.publish(switched.gripper_on)
        self._moving_rt.publish(snapshot.moving_rt)
        self._moving_ptp.publish(snapshot.moving_ptp)
        status = KukaStatus(host=self._host, pid=self._pid, control_on=switched.control_on)
        scaling = step.scaling or MotionScaling(switched.scale)
        status.gripper_on, status.scaling_factor = switched.gripper_on, scaling.factor
        status.scaling_offset = Vector3(*scaling.offset.tolist())
        status.mode, status.reason = step.mode.value, step.reason
        status.limited_by = [limit.value for limit in step.limited_by]
        status.round_trip = snapshot.round_trip or 0.0
        status.robot_server, status.robot_abilities = snapshot.server, sorted(snapshot.abilities)
        status.paused, status.guided, status.soft = switched.paused, snapshot.guided, switched.soft
        status.header.stamp = rospy.Time.now()
        self._status.publish(status)


def publish_workspace(workspace: Workspace, centre, frames: ArmFrames = ONE_ARM) -> rospy.Publisher:
    """Publishes the boundary lines, unless they do not act, and the centre, once and latched; the publisher is to be
    kept."""
    line_width_m = 0.003
    centre_diameter_m = 0.02
    publisher = rospy.Publisher("kuka/workspace", MarkerArray, queue_size=1, latch=True)
    lines = [
        _marker(i, Marker.LINE_STRIP, line_width_m, [Point(*p) for p in line])
        for i, line in enumerate([] if workspace.lifted else boundary_lines(workspace))
    ]
    middle = _marker(len(lines), Marker.SPHERE_LIST, centre_diameter_m, [Point(*centre)])
    markers = [*lines, middle]
    for marker in markers:
        marker.header.frame_id = frames(BASE)
    publisher.publish(MarkerArray(markers))
    return publisher


def _marker(number: int, kind: int, size: float, points: list) -> Marker:
    marker = Marker(ns="workspace", id=number, type=kind, action=Marker.ADD, points=points, frame_locked=True)
    marker.pose.orientation.w = 1.0
    marker.scale = Vector3(size, size, size)
    marker.color = ColorRGBA(0.2, 0.7, 1.0, 0.8)
    return marker
