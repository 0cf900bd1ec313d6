"""Publishes an execution: its state, its outcome, and the grasp in RViz."""

from __future__ import annotations

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from common.frames import BASE
from common.poses import translation
from common.ros.conversions import message_from_pose, stamped_pose
from grasp_msgs.msg import Grasp, GraspOutcome
from grasping.execution.execution import OVER, Execution, ExecutionOutcome
from grasping.execution.execution_request import ToolGoal

FINGER_M, PALM_M = (0.012, 0.02, 0.06), (0.08, 0.02)
"""A finger along x, y and z; the palm along y and z."""
ARROW_M, TEXT_M = 0.008, 0.025
GHOST = ColorRGBA(0.2, 0.5, 1.0, 0.5)
NO_GRASP = Grasp()


class ExecutionDisplay:
    """Publishes each change of the state once, each outcome, and a ghost of the grasp while it is executed."""

    def __init__(self) -> None:
        self._state = rospy.Publisher("grasping/state", DiagnosticStatus, queue_size=10, latch=True)
        self._outcome = rospy.Publisher("grasping/outcome", GraspOutcome, queue_size=10)
        self._marker = rospy.Publisher("grasping/proposal_marker", MarkerArray, queue_size=10, latch=True)
        self._shown: tuple[int, str, str] | None = None

    def show(self, execution: Execution, grasp: Grasp, way: ToolGoal | None) -> None:
        """Publishes the state if it or its reason changed.

        Args:
            way: where the tool goes for it; None before the first execution.
        """
        shown = execution.episode, execution.state, execution.reason
        if self._shown == shown:
            return
        self._shown = shown
        rospy.loginfo("Execution %d is %s: %s", execution.episode, execution.state, execution.reason)
        values = {
            "state": execution.state,
            "proposal": grasp.id,
            "episode": execution.episode,
            "reason": execution.reason,
        }
        self._state.publish(
            DiagnosticStatus(
                level=DiagnosticStatus.OK,
                name="grasp_execution",
                message=execution.reason,
                values=[KeyValue(key, str(value)) for key, value in values.items()],
            )
        )
        shapes = [] if way is None or execution.state == OVER else _ghost(grasp, way, execution.reason)
        self._marker.publish(MarkerArray([Marker(ns="execution", action=Marker.DELETEALL), *shapes]))

    def publish(self, outcome: ExecutionOutcome, grasp: Grasp) -> None:
        """Publishes an outcome."""
        message = GraspOutcome(episode=outcome.episode, proposal=grasp, held=outcome.held, reason=outcome.reason)
        message.header.frame_id = BASE
        message.header.stamp = rospy.Time.now()
        if outcome.closed is not None:
            message.header.stamp = rospy.Time.from_sec(outcome.closed.time)
            message.tool = stamped_pose(outcome.closed.T_base_tool, BASE, message.header.stamp)
        self._outcome.publish(message)


def _ghost(grasp: Grasp, way: ToolGoal, text: str) -> list[Marker]:
    """Returns fingers and palm around the grasp, an arrow down to it, and what happens."""
    half, up = 0.5 * (grasp.width + FINGER_M[0]), 0.5 * FINGER_M[2]
    palm = (grasp.width + 2.0 * FINGER_M[0], *PALM_M)
    shapes = [
        _shape(Marker.CUBE, 0, way.T_base_grip @ translation(half, 0.0, -up), FINGER_M),
        _shape(Marker.CUBE, 1, way.T_base_grip @ translation(-half, 0.0, -up), FINGER_M),
        _shape(Marker.CUBE, 2, way.T_base_grip @ translation(0.0, 0.0, -FINGER_M[2] - 0.5 * PALM_M[1]), palm),
        _shape(Marker.ARROW, 3, np.eye(4), (ARROW_M, 2.0 * ARROW_M, 2.0 * ARROW_M)),
        _shape(Marker.TEXT_VIEW_FACING, 4, way.T_base_above, (0.0, 0.0, TEXT_M)),
    ]
    shapes[3].points = [Point(*way.T_base_above[:3, 3]), Point(*way.T_base_tool[:3, 3])]
    shapes[4].text = text
    return shapes


def _shape(kind: int, number: int, T_base_shape: np.ndarray, size: tuple[float, float, float]) -> Marker:
    marker = Marker(ns="execution", id=number, type=kind, action=Marker.ADD, color=GHOST)
    marker.header.frame_id = BASE
    marker.pose = message_from_pose(T_base_shape)
    marker.scale.x, marker.scale.y, marker.scale.z = size
    return marker
