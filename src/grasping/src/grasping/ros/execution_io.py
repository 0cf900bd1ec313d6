"""Inputs of the node grasp_execution (proposals, controller, leap_kuka, hand, tf), and what it publishes."""

from __future__ import annotations

import numpy as np
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from common import clock
from common.frames import BASE
from common.modes import ExecutionState
from common.numbers import LABEL_M
from common.poses import translation
from common.robot_hand import HAND, hand_state
from common.ros.conversions import message_from_pose, pose_in, stamped_pose
from common.ros.inputs import NodeInputs
from common.ros.publishing import DirectPublisher
from common.teleop_record import WAITING, TeleopRecord, teleop_record
from grasp_msgs.msg import Grasp, GraspList, GraspOutcome
from grasping.execution.execution import (
    ControllerState,
    Execution,
    ExecutionObservation,
    ExecutionOutcome,
    ProposalList,
    ProposedPose,
    ToolGoal,
)
from grasping.execution.grasp_watch import HandMeasurement
from grasping.ros.pose_lookup import PoseLookup
from reflex_msgs.msg import Hand
from rig_msgs.msg import KukaStatus, TeleopState

GHOST = ColorRGBA(0.2, 0.5, 1.0, 0.5)
NO_GRASP = Grasp()


class ExecutionInputs:
    """The newest of each; a state older than `silence` [s] is unknown. T_flange_tool: the tool, shape (4, 4) [m]."""

    def __init__(self, T_flange_tool: np.ndarray, silence: float) -> None:
        self._T_flange_tool = T_flange_tool
        self._silence = silence
        self.grasps: GraspList | None = None  # the newest, None if none came yet
        self._controller: tuple[KukaStatus, float] | None = None
        self._hand: tuple[Hand, float] | None = None
        self._teleop = TeleopRecord(WAITING, "leap_kuka has not published yet")
        self._poses = PoseLookup()
        topics = {
            "ggcnn/out/grasps": (GraspList, self._on_grasps, 1),
            "kuka/status": (KukaStatus, self._on_controller, 1),
            "leap_kuka/state": (TeleopState, self._on_teleop, 10),
            HAND.state: (Hand, self._on_hand, 1),
        }
        inputs = NodeInputs(topics, silent=silence)
        self.missing = inputs.missing  # returns which of them do not come, a clause
        for topic, (kind, callback, queue_size) in topics.items():
            inputs.subscribe(topic, kind, callback, queue_size)

    @property
    def controller(self) -> ControllerState | None:
        """The newest state of the arm's controller, None if it is silent."""
        status = self._fresh(self._controller)
        return None if status is None else ControllerState(status.control_on, status.mode, status.reason)

    @property
    def hand_followed(self) -> bool:
        return self._teleop.running

    def observe(self) -> ExecutionObservation:
        hand, teleop = self._fresh(self._hand), self._teleop
        return ExecutionObservation(
            clock=rospy.get_time(),
            controller=self.controller,
            hold=teleop.hold,
            hold_reason=teleop.reason,
            T_base_tool=self._tool(),
            hand=None if hand is None else hand_measurement(hand),
        )

    def _fresh(self, heard):
        return heard[0] if heard is not None and clock.monotonic() - heard[1] <= self._silence else None

    def _tool(self) -> np.ndarray | None:
        try:
            return self._poses.flange(self._silence) @ self._T_flange_tool
        except (ValueError, tf2_ros.TransformException):
            return None

    def _on_grasps(self, message: GraspList) -> None:
        self.grasps = message

    def _on_controller(self, message: KukaStatus) -> None:
        self._controller = message, clock.monotonic()

    def _on_hand(self, message: Hand) -> None:
        self._hand = message, clock.monotonic()

    def _on_teleop(self, message: TeleopState) -> None:
        self._teleop = teleop_record(message)


def proposals_from(message: GraspList, now: rospy.Time) -> ProposalList:
    grasps = [_proposal(grasp) for grasp in message.grasps]
    return ProposalList((now - message.header.stamp).to_sec(), grasps, message.reason)


def _proposal(grasp: Grasp) -> ProposedPose:
    if not grasp.pose_base.header.frame_id:
        return ProposedPose(grasp.id, None)
    try:
        return ProposedPose(grasp.id, pose_in(BASE, grasp.pose_base), own_approach=grasp.own_approach)
    except ValueError as error:
        return ProposedPose(grasp.id, None, f"its pose is invalid: {error}")


def hand_measurement(hand: Hand) -> HandMeasurement:
    """Returns the state of index, middle and thumb in a message."""
    state, fingers = hand_state(hand), slice(len(HAND.fingers))
    return HandMeasurement(state.angles[fingers], state.pressures, state.loads[fingers])


class ExecutionDisplay:
    """Publishes each change of the state once, each outcome, and a ghost of the grasp while it is executed."""

    def __init__(self) -> None:
        self._state = rospy.Publisher("grasping/state", DiagnosticStatus, queue_size=10, latch=True)
        # An outcome that the end of the node brings is not left to a thread that no longer comes to send it.
        self._outcome = DirectPublisher("grasping/outcome", GraspOutcome, queue_size=10)
        self._marker = rospy.Publisher("grasping/proposal_marker", MarkerArray, queue_size=10, latch=True)
        self._shown: tuple[int, str, str] | None = None

    def show(self, execution: Execution, grasp: Grasp, goal: ToolGoal | None) -> None:
        """Publishes the state if it or its reason changed; `goal` is None before the first execution."""
        state = execution.state.value
        shown = execution.episode, state, execution.reason
        if self._shown == shown:
            return
        self._shown = shown
        rospy.loginfo("Execution %d is %s: %s", *shown)
        keys = "state", "proposal", "episode", "reason"
        values = state, str(grasp.id), str(execution.episode), execution.reason
        pairs = [KeyValue(key, value) for key, value in zip(keys, values)]
        self._state.publish(DiagnosticStatus(DiagnosticStatus.OK, "grasp_execution", execution.reason, "", pairs))
        shapes = [] if goal is None or execution.state is ExecutionState.OVER else _ghost(grasp, goal, execution.reason)
        self._marker.publish(MarkerArray([Marker(ns="execution", action=Marker.DELETEALL), *shapes]))

    def publish(self, outcome: ExecutionOutcome, grasp: Grasp) -> None:
        message = GraspOutcome(episode=outcome.episode, proposal=grasp, held=outcome.held, reason=outcome.reason)
        message.header.frame_id = BASE
        message.header.stamp = rospy.Time.now()
        if outcome.closed is not None:
            message.header.stamp = rospy.Time.from_sec(outcome.closed.time)
            message.tool = stamped_pose(outcome.closed.T_base_tool, BASE, message.header.stamp)
        self._outcome.publish(message)


def _ghost(grasp: Grasp, goal: ToolGoal, text: str) -> list[Marker]:
    """Returns fingers and palm around the grasp, an arrow to it, and what happens."""
    finger_m = (0.012, 0.02, 0.06)  # a finger along x, y and z
    palm_m = (0.08, 0.02)  # the palm along y and z
    arrow_m = 0.008
    half, up = 0.5 * (grasp.width + finger_m[0]), 0.5 * finger_m[2]
    palm = (grasp.width + 2.0 * finger_m[0], *palm_m)
    shapes = [
        *(
            _shape(Marker.CUBE, i, goal.T_base_grip @ translation(x, 0.0, -up), finger_m)
            for i, x in enumerate((half, -half))
        ),
        _shape(Marker.CUBE, 2, goal.T_base_grip @ translation(0.0, 0.0, -finger_m[2] - 0.5 * palm_m[1]), palm),
        _shape(Marker.ARROW, 3, np.eye(4), (arrow_m, 2.0 * arrow_m, 2.0 * arrow_m)),
        _shape(Marker.TEXT_VIEW_FACING, 4, goal.T_base_above, (0.0, 0.0, LABEL_M)),
    ]
    shapes[3].points = [Point(*goal.T_base_above[:3, 3]), Point(*goal.T_base_tool[:3, 3])]
    shapes[4].text = text
    return shapes


def _shape(kind: int, number: int, T_base_shape: np.ndarray, size: tuple[float, float, float]) -> Marker:
    marker = Marker(ns="execution", id=number, type=kind, action=Marker.ADD, color=GHOST)
    marker.header.frame_id = BASE
    marker.pose = message_from_pose(T_base_shape)
    marker.scale.x, marker.scale.y, marker.scale.z = size
    return marker
