"""What the teleoperation of an arm reports: leap_kuka/state, leap_kuka/stream made from it, and the interaction box."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, Quaternion
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from common import clock
from common.hand_tracking import LEFT, RIGHT
from common.numbers import LABEL_M
from leap_kuka.numbers import HEARTBEAT_S, STATE_PERIOD_S
from leap_kuka.start_gate import CONDITIONS, InteractionBox
from leap_kuka.teleop_result import StreamState, TeleopResult
from leap_kuka.tool_hold import HoldState
from rig_msgs.msg import TeleopState


class Repetition:
    """When a topic is due: at once with a change of its `key`, at a flush with another `text` or after `period` [s]."""

    def __init__(
        self, period: float, key: Callable[[TeleopResult], tuple], text: Callable[[TeleopResult], str] = lambda _: ""
    ) -> None:
        self._period = period
        self._key = key
        self._text = text
        self._published: TeleopResult | None = None
        self._published_at = 0.0

    def changed(self, result: TeleopResult) -> bool:
        return self._published is None or self._key(self._published) != self._key(result)

    def due(self, result: TeleopResult) -> bool:
        if self._published is None or clock.monotonic() - self._published_at >= self._period:
            return True
        return self._text(self._published) != self._text(result)

    def done(self, result: TeleopResult) -> None:
        self._published, self._published_at = result, clock.monotonic()


class TeleopReport:
    """Publishes what the operator switches and steers at once, and all of it again and again. The reason may change
    with every frame (the distance to the box), faster than anybody can read: on leap_kuka/stream it waits for a
    `flush`. `of`: namespace of the arm with a slash, in a node for several."""

    def __init__(
        self, engagement: str, enabling_needed: bool, box: InteractionBox, frame_id: str, of: str = ""
    ) -> None:
        self._engagement = engagement
        self._enabling_needed = enabling_needed
        self._box = box
        self._frame_id = frame_id
        self._whose = f"{of[:-1]}: " if of else ""
        self._lock = clock.Lock()
        self._newest: TeleopResult | None = None
        self._state = rospy.Publisher(f"{of}leap_kuka/state", TeleopState, queue_size=10, latch=True)
        self._stream = rospy.Publisher(f"{of}leap_kuka/stream", DiagnosticStatus, queue_size=10, latch=True)
        self._markers = rospy.Publisher(f"{of}leap_kuka/interaction_box", MarkerArray, queue_size=10, latch=True)
        self._of_state = Repetition(STATE_PERIOD_S, _switched_and_steered)
        self._of_stream = Repetition(
            HEARTBEAT_S, lambda result: (result.state, result.hold, result.owner), lambda result: result.reason
        )

    @property
    def text(self) -> tuple[int, str, str]:
        result = self._newest
        if result is None:
            return DiagnosticStatus.WARN, "starting", StreamState.WAITING.value
        return _level(result.follows), result.reason, result.state.value

    def update(self, result: TeleopResult) -> None:
        """Sets the newest result; publishes it if it brings a change."""
        with self._lock:
            self._newest = result
            stream = self._of_stream.changed(result)
            if stream:
                held = ", the tool is held" if result.hold in (HoldState.HELD, HoldState.KEPT) else ""
                rospy.loginfo("%sStream %s%s: %s.", self._whose, result.state.value, held, result.reason)
            self._publish(result, self._of_state.changed(result), stream)

    def flush(self) -> None:
        """Publishes the newest result where it is due."""
        with self._lock:
            result = self._newest
            if result is not None:
                self._publish(result, self._of_state.due(result), self._of_stream.due(result))

    def _publish(self, result: TeleopResult, state: bool, stream: bool) -> None:
        if not (state or stream):
            return
        message = state_message(result, self._engagement, self._enabling_needed)
        if state:
            self._of_state.done(result)
            self._state.publish(message)
        if stream:
            self._of_stream.done(result)
            self._stream.publish(stream_message(message))
            green = (0.2, 0.8, 0.3)
            amber = (1.0, 0.7, 0.1)
            colour = green if message.follows else amber
            self._markers.publish(MarkerArray([self._box_marker(colour), self._text_marker(colour, result.reason)]))

    def _box_marker(self, colour: tuple[float, float, float]) -> Marker:
        """The edges of the box: faces would hide the robot hand that works in it."""
        marker = self._marker(Marker.LINE_LIST, 0, self._box.center, colour)
        marker.scale.x = 0.004  # width of the edges [m]
        corners = [self._box.size / 2.0 * signs for signs in itertools.product((-1.0, 1.0), repeat=3)]
        marker.points = [
            Point(*corner)
            for ends in itertools.combinations(corners, 2)
            if np.count_nonzero(ends[0] != ends[1]) == 1
            for corner in ends
        ]
        return marker

    def _text_marker(self, colour: tuple[float, float, float], text: str) -> Marker:
        above = self._box.center + np.array([0.0, self._box.size[1] / 2.0 + LABEL_M, 0.0])
        marker = self._marker(Marker.TEXT_VIEW_FACING, 1, above, colour)
        marker.ns, marker.scale.z = "reason", LABEL_M
        marker.text = text
        return marker

    def _marker(self, kind: int, number: int, position: np.ndarray, colour: tuple[float, float, float]) -> Marker:
        """Returns a marker at `position`, shape (3,) [m]; its zero stamp lets it follow the newest frame."""
        marker = Marker(ns="interaction_box", id=number, type=kind, action=Marker.ADD, frame_locked=True)
        marker.header.frame_id = self._frame_id
        marker.pose = Pose(Point(*position), Quaternion(w=1.0))
        marker.color = ColorRGBA(*colour, 1.0)
        return marker


def _switched_and_steered(result: TeleopResult) -> tuple:
    switches = result.follows, result.enabled, result.clutched
    return _state(result), result.hold, result.keep_grip, result.owner, switches, result.unmet, result.limits


def state_message(result: TeleopResult, engagement: str, enabling_needed: bool) -> TeleopState:
    message = TeleopState(engagement=engagement, state=_state(result), reason=result.reason, follows=result.follows)
    message.header.stamp = rospy.Time.now()
    if result.owner is not None:
        message.hand_id, message.hand_side = result.owner[0], LEFT if result.owner[1] else RIGHT
    message.enabling_needed, message.enabled = enabling_needed, result.enabled
    message.clutched, message.source, message.hold_left = result.clutched, result.source, result.hold_left
    message.conditions = list(CONDITIONS)
    message.fulfilled = [condition not in result.unmet for condition in CONDITIONS]
    message.limits = list(result.limits)
    message.reason_codes = [code.value for code in result.codes]
    message.hold, message.keep_grip = result.hold.value, result.keep_grip
    return message


def stream_message(state: TeleopState) -> DiagnosticStatus:
    """Returns the message of leap_kuka/stream: the state as texts, which programs of before it read."""
    running = state.state == TeleopState.RUNNING
    values = {
        "state": (StreamState.RUNNING if running else StreamState.WAITING).value,
        "hold": state.hold,
        "keep_grip": str(state.keep_grip).lower(),
        "hand_id": str(state.hand_id) if state.hand_side else "",
        "hand_side": state.hand_side,
    }
    pairs = [KeyValue(key, value) for key, value in values.items()]
    return DiagnosticStatus(level=_level(state.follows), name="leap_kuka", message=state.reason, values=pairs)


def _state(result: TeleopResult) -> str:
    if result.state is StreamState.RUNNING:
        return TeleopState.RUNNING
    if result.hold is HoldState.NONE:
        return TeleopState.WAITING
    return TeleopState.CLUTCHED if result.hold is HoldState.KEPT and result.clutched else TeleopState.HOLDING


def _level(follows: bool) -> int:
    return DiagnosticStatus.OK if follows else DiagnosticStatus.WARN
