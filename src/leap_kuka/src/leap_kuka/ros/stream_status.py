"""The state of the stream for the operator: on leap_kuka/stream, and beside the interaction box in RViz."""

from __future__ import annotations

import abc
import itertools

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, Quaternion
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from common import clock
from common.hand_tracking import LEFT, RIGHT
from leap_kuka.numbers import HEARTBEAT_S
from leap_kuka.start_gate import InteractionBox
from leap_kuka.teleop_result import StreamState, TeleopResult
from leap_kuka.tool_hold import HoldState

GREEN = (0.2, 0.8, 0.3)
AMBER = (1.0, 0.7, 0.1)
EDGE_WIDTH_M = 0.004
TEXT_HEIGHT_M = 0.025


class NewestResult(abc.ABC):
    """Publishes a result with a change at once, and the newest one again at a `flush` after `period` [s].

    Classes that derive from it say what a change is (`_key`), and publish.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._lock = clock.Lock()
        self._newest: TeleopResult | None = None
        self._published: TeleopResult | None = None
        self._published_at = 0.0

    def update(self, result: TeleopResult) -> None:
        """Sets the newest result; publishes it if it brings a change."""
        with self._lock:
            self._newest, before = result, self._published
            if before is None or self._key(before) != self._key(result):
                self._changed(result)
                self._send(result)

    def flush(self) -> None:
        """Publishes the newest result if its text differs from the published one, or that one is a period old."""
        with self._lock:
            result, published = self._newest, self._published
            if result is None or published is None:
                return
            if self._text(result) != self._text(published) or clock.monotonic() - self._published_at >= self._period:
                self._send(result)

    def _send(self, result: TeleopResult) -> None:
        self._published, self._published_at = result, clock.monotonic()
        self._publish(result)

    @abc.abstractmethod
    def _key(self, result: TeleopResult) -> tuple:
        """Returns what is published at once."""

    def _text(self, result: TeleopResult) -> str:
        """Returns what is published at the next flush."""
        return ""

    def _changed(self, result: TeleopResult) -> None:  # noqa: B027 - who has nothing to add leaves it out
        """Is called before a change is published."""

    @abc.abstractmethod
    def _publish(self, result: TeleopResult) -> None:
        """Publishes a result."""


class StreamStatus(NewestResult):
    """Publishes a change of the state or of the hold at once, and a new reason at the next `flush`.

    Without either it publishes every HEARTBEAT_S.

    The reason may change with every frame (the distance to the box), faster than anybody can read. `of`: namespace of
    the arm with a slash, in a node for several.
    """

    def __init__(self, box: InteractionBox, frame_id: str, of: str = "") -> None:
        super().__init__(HEARTBEAT_S)
        self._box, self._frame_id, self._whose = box, frame_id, f"{of[:-1]}: " if of else ""
        self._status = rospy.Publisher(f"{of}leap_kuka/stream", DiagnosticStatus, queue_size=10, latch=True)
        self._markers = rospy.Publisher(f"{of}leap_kuka/interaction_box", MarkerArray, queue_size=10, latch=True)

    def _key(self, result: TeleopResult) -> tuple:
        return result.state, result.hold, result.owner

    def _text(self, result: TeleopResult) -> str:
        return result.reason

    def _changed(self, result: TeleopResult) -> None:
        held = ", the tool is held" if result.hold in (HoldState.HELD, HoldState.KEPT) else ""
        rospy.loginfo("%sStream %s%s: %s.", self._whose, result.state.value, held, result.reason)

    @property
    def text(self) -> tuple[int, str, str]:
        """Level, reason and state for diagnostics."""
        result = self._newest
        if result is None:
            return DiagnosticStatus.WARN, "starting", StreamState.WAITING.value
        return _level(result), result.reason, result.state.value

    def _publish(self, result: TeleopResult) -> None:
        number, side = ("", "") if result.owner is None else (str(result.owner[0]), LEFT if result.owner[1] else RIGHT)
        values = [
            KeyValue("state", result.state.value),
            KeyValue("hold", result.hold.value),
            KeyValue("keep_grip", str(result.keep_grip).lower()),
            KeyValue("hand_id", number),
            KeyValue("hand_side", side),
        ]
        self._status.publish(
            DiagnosticStatus(level=_level(result), name="leap_kuka", message=result.reason, values=values)
        )
        colour = GREEN if _level(result) == DiagnosticStatus.OK else AMBER
        self._markers.publish(MarkerArray([self._box_marker(colour), self._text_marker(colour, result.reason)]))

    def _box_marker(self, colour: tuple[float, float, float]) -> Marker:
        """The edges of the box: faces would hide the robot hand that works in it."""
        marker = self._marker(Marker.LINE_LIST, 0, self._box.center, colour)
        marker.scale.x = EDGE_WIDTH_M
        corners = [self._box.size / 2.0 * signs for signs in itertools.product((-1.0, 1.0), repeat=3)]
        marker.points = [
            Point(*corner)
            for ends in itertools.combinations(corners, 2)
            if np.count_nonzero(ends[0] != ends[1]) == 1
            for corner in ends
        ]
        return marker

    def _text_marker(self, colour: tuple[float, float, float], text: str) -> Marker:
        above = self._box.center + np.array([0.0, self._box.size[1] / 2.0 + 2.0 * TEXT_HEIGHT_M, 0.0])
        marker = self._marker(Marker.TEXT_VIEW_FACING, 1, above, colour)
        marker.scale.z = TEXT_HEIGHT_M
        marker.text = text
        return marker

    def _marker(self, kind: int, number: int, position: np.ndarray, colour: tuple[float, float, float]) -> Marker:
        """Returns a marker at `position`, shape (3,) [m]; its zero stamp lets it follow the newest frame."""
        marker = Marker(ns="interaction_box", id=number, type=kind, action=Marker.ADD, frame_locked=True)
        marker.header.frame_id = self._frame_id
        marker.pose = Pose(Point(*position), Quaternion(w=1.0))
        marker.color = ColorRGBA(*colour, 1.0)
        return marker


def _level(result: TeleopResult) -> int:
    return DiagnosticStatus.OK if result.follows else DiagnosticStatus.WARN
