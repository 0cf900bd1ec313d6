"""The state of the teleoperation for the operator, on leap_kuka/state."""

from __future__ import annotations

import rospy

from common.hand_tracking import LEFT, RIGHT
from leap_kuka.ros.stream_status import NewestResult
from leap_kuka.start_gate import CONDITIONS
from leap_kuka.teleop_result import StreamState, TeleopResult
from leap_kuka.tool_hold import HoldState
from rig_msgs.msg import TeleopState

PERIOD_S = 0.2


class TeleopStatePublisher(NewestResult):
    """Publishes a change of what the operator switches and steers at once, and the whole state every PERIOD_S.

    `of`: namespace of the arm with a slash, in a node for several.
    """

    def __init__(self, engagement: str, enabling_needed: bool, of: str = "") -> None:
        super().__init__(PERIOD_S)
        self._engagement, self._enabling_needed = engagement, enabling_needed
        self._publisher = rospy.Publisher(f"{of}leap_kuka/state", TeleopState, queue_size=10, latch=True)

    def _key(self, result: TeleopResult) -> tuple:
        switches = result.follows, result.enabled, result.clutched
        return _state(result), result.hold, result.keep_grip, result.owner, switches, result.unmet, result.limits

    def _publish(self, result: TeleopResult) -> None:
        message = TeleopState(engagement=self._engagement, state=_state(result), reason=result.reason)
        message.follows = result.follows
        message.header.stamp = rospy.Time.now()
        message.hand_side = "" if result.owner is None else LEFT if result.owner[1] else RIGHT
        message.enabling_needed, message.enabled = self._enabling_needed, result.enabled
        message.clutched, message.source, message.hold_left = result.clutched, result.source, result.hold_left
        message.conditions = list(CONDITIONS)
        message.fulfilled = [condition not in result.unmet for condition in CONDITIONS]
        message.limits = list(result.limits)
        message.reason_codes = [code.value for code in result.codes]
        message.hand_id = 0 if result.owner is None else result.owner[0]
        message.hold, message.keep_grip = result.hold.value, result.keep_grip
        self._publisher.publish(message)


def _state(result: TeleopResult) -> str:
    if result.state is StreamState.RUNNING:
        return TeleopState.RUNNING
    if result.hold is HoldState.NONE:
        return TeleopState.WAITING
    return TeleopState.CLUTCHED if result.hold is HoldState.KEPT and result.clutched else TeleopState.HOLDING
