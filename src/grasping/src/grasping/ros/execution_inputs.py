"""Inputs of the node grasp_execution: proposals, the arm's controller, leap_kuka, the robot hand, and tf."""

from __future__ import annotations

import time

import numpy as np
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticStatus

from common.frames import BASE, FLANGE_MEASURED
from common.ros.conversions import pose_from_transform, pose_in
from grasp_msgs.msg import Grasp, GraspList
from grasping.execution.execution import NONE, ExecutionObservation
from grasping.execution.execution_request import ControllerState, ProposalList, ProposedPose
from grasping.execution.grasp_watch import HandMeasurement
from reflex_msgs.msg import Hand
from rig_msgs.msg import KukaStatus


class ExecutionInputs:
    """The newest of each.

    Args:
        T_flange_tool: the tool, shape (4, 4) [m].
        silence: a state that is older than this is unknown [s].
    """

    def __init__(self, T_flange_tool: np.ndarray, silence: float) -> None:
        self._T_flange_tool, self._silence = T_flange_tool, silence
        self._grasps: GraspList | None = None
        self._controller: tuple[KukaStatus, float] | None = None
        self._hand: tuple[Hand, float] | None = None
        self._hold, self._hold_reason, self.hand_followed = NONE, "leap_kuka has not published yet", False
        self._tf = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._tf)
        rospy.Subscriber("ggcnn/out/grasps", GraspList, self._on_grasps, queue_size=1)
        rospy.Subscriber("kuka/status", KukaStatus, self._on_controller, queue_size=1)
        rospy.Subscriber("leap_kuka/stream", DiagnosticStatus, self._on_stream, queue_size=10)
        rospy.Subscriber("reflex_takktile/hand_state", Hand, self._on_hand, queue_size=1, tcp_nodelay=True)

    @property
    def grasps(self) -> GraspList | None:
        """The newest list of grasps, None if none came yet."""
        return self._grasps

    @property
    def controller(self) -> ControllerState | None:
        """The newest state of the arm's controller, None if it is silent."""
        status = self._fresh(self._controller)
        return None if status is None else ControllerState(status.control_on, status.mode, status.reason)

    def observe(self) -> ExecutionObservation:
        """Returns the observed state of the rig."""
        hand = self._fresh(self._hand)
        return ExecutionObservation(
            clock=rospy.get_time(),
            controller=self.controller,
            hold=self._hold,
            hold_reason=self._hold_reason,
            T_base_tool=self._tool(),
            hand=None if hand is None else _hand_state(hand),
        )

    def _fresh(self, heard):
        return heard[0] if heard is not None and time.monotonic() - heard[1] <= self._silence else None

    def _tool(self) -> np.ndarray | None:
        try:
            found = self._tf.lookup_transform(BASE, FLANGE_MEASURED, rospy.Time(0))
            if abs((rospy.Time.now() - found.header.stamp).to_sec()) > self._silence:
                return None
            return pose_from_transform(found.transform) @ self._T_flange_tool
        except (ValueError, tf2_ros.TransformException):
            return None

    def _on_grasps(self, message: GraspList) -> None:
        self._grasps = message

    def _on_controller(self, message: KukaStatus) -> None:
        self._controller = message, time.monotonic()

    def _on_hand(self, message: Hand) -> None:
        self._hand = message, time.monotonic()

    def _on_stream(self, message: DiagnosticStatus) -> None:
        values = {value.key: value.value for value in message.values}
        self._hold, self._hold_reason = values.get("hold", NONE), message.message
        self.hand_followed = values.get("state") == "running"


def proposals_from(message: GraspList, now: rospy.Time) -> ProposalList:
    """Returns the proposals of a message."""
    grasps = [_proposal(grasp) for grasp in message.grasps]
    return ProposalList((now - message.header.stamp).to_sec(), grasps, message.reason)


def _proposal(grasp: Grasp) -> ProposedPose:
    if not grasp.pose_base.header.frame_id:
        return ProposedPose(grasp.id, None)
    try:
        return ProposedPose(grasp.id, pose_in(BASE, grasp.pose_base))
    except ValueError as error:
        return ProposedPose(grasp.id, None, f"its pose is invalid: {error}")


def _hand_state(hand: Hand) -> HandMeasurement:
    motors = hand.motor[: len(hand.finger)]
    return HandMeasurement(
        np.array([motor.joint_angle for motor in motors]),
        np.array([finger.pressure for finger in hand.finger]),
        np.array([motor.load for motor in motors]),
    )
