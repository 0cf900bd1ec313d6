"""What the collision guard shows, where heard, and the opening of the hand, for speed limits. `kuka/guard`
(rig_msgs/GuardState) at 10 Hz. `kuka/guard_markers` has the namespaces nearest (the nearest pair, green to red by the
scale), distance, around (obstacles) and robot (the bodies that stand for it)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import rospy
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from common import clock
from common.frames import BASE, ONE_ARM, ArmFrames
from common.numbers import LABEL_M
from common.poses import translation
from common.robot_hand import HAND
from common.ros.conversions import message_from_pose
from common.ros.node import repeat, while_running
from kuka_control.limits.moving_arm import GuardError
from kuka_control.loop.assembly import collision_guard
from kuka_control.model.arms import SIDE
from kuka_control.model.config import ControllerConfig
from kuka_control.model.obstacles import ConvexBody
from kuka_control.model.rig import Rig
from kuka_control.model.robot_shape import TABLE, Opening
from reflex_msgs.msg import Hand
from rig_msgs.msg import GuardState

TAKE_S = 0.04  # the opening is taken over this often [s]
SILENT_S = 1.0  # a hand that has not reported for so long may be open as wide as it can [s]
FAILED_S = 10.0  # how often a failure of the guard is said [s]
TEXT_ABOVE_M = 0.3  # over the pair, where the hand does not hide it [m]
AROUND, ROBOT = ColorRGBA(0.9, 0.6, 0.2, 0.5), ColorRGBA(0.3, 0.6, 1.0, 0.3)


class HandOpening:
    """The present opening of the hand; `now` is monotonic [s]."""

    def __init__(self) -> None:
        self._newest: tuple[float, Opening] | None = None
        self._taken: Opening | None = None
        self._next = 0.0
        rospy.Subscriber(HAND.state, Hand, self._take, queue_size=1, tcp_nodelay=True)

    def at(self, now: float) -> Opening | None:
        """Returns the joints of the hand, None if they are not known; the same object until they change."""
        if now < self._next:
            return self._taken
        self._next = now + TAKE_S
        newest = self._newest
        if newest is None or now - newest[0] > SILENT_S:
            self._taken = None
        elif self._taken is None or newest[1].differs(self._taken):
            self._taken = newest[1]
        return self._taken

    def _take(self, hand: Hand) -> None:
        a, b, c = hand.finger
        distal = a.distal_approx, b.distal_approx, c.distal_approx
        opening = Opening((a.proximal, b.proximal, c.proximal), distal, hand.motor[3].joint_angle)
        self._newest = (clock.monotonic(), opening) if np.isfinite(opening.joints).all() else None


class GuardView:
    """Shows what the guard sees, and answers about joints, from bodies of its own. `observe` returns the measured
    joints, shape (7,) [rad], or None before the first, and the scale of the speed."""

    def __init__(
        self,
        config: ControllerConfig,
        rig: Rig,
        observe: Callable[[], tuple[np.ndarray | None, float]],
        frames: ArmFrames = ONE_ARM,
    ) -> None:
        period_s = 0.1
        self._base = frames(BASE)
        self._guard = collision_guard(config, rig)
        self._margin = config.guard_margin
        self._observe = observe
        self._count = 0
        self._lock = clock.Lock()
        self._state = rospy.Publisher("kuka/guard", GuardState, queue_size=2)
        self._markers = rospy.Publisher("kuka/guard_markers", MarkerArray, queue_size=2)
        repeat(self._show, period_s, "guard view")

    def collision(self, q: np.ndarray) -> str | None:
        """Returns which bodies would be too near at the joints q, shape (7,) [rad], a part of a sentence, or None.
        From any thread; a guard that fails has no answer but that."""
        if self._guard is None:
            return None
        try:
            with self._lock:
                return self._guard.fault_at(q)
        except GuardError as error:
            return str(error).rstrip(".")

    def _show(self) -> None:
        with while_running(), self._lock:
            try:
                self._publish()
            except GuardError as error:
                rospy.logwarn_throttle(FAILED_S, str(error))

    def _publish(self) -> None:
        shown = self._markers.get_num_connections() > 0
        if not (shown or self._state.get_num_connections()):
            return
        joints, scale = self._observe()
        header = Header(0, rospy.Time.now(), self._base)
        state = GuardState(header=header, on=self._guard is not None, margin=self._margin, scale=scale)
        state.distance = float("inf")
        if self._guard is not None and joints is not None:
            nearest = self._guard.nearest_at(joints.tolist())
            if nearest is not None:
                state.distance, state.pair = nearest.distance, list(nearest.pair)
                state.points = [Point(*point) for point in nearest.points]
                if shown:
                    self._markers.publish(MarkerArray(self._drawn(header, state, joints)))
        self._state.publish(state)

    def _drawn(self, header: Header, state: GuardState, joints: np.ndarray) -> list[Marker]:
        bodies_every = 5  # of so many times once
        colour = ColorRGBA(1.0 - state.scale, state.scale, 0.1, 1.0)
        line = _marker(header, "nearest", 0, Marker.LINE_LIST, (0.006, 0.0, 0.0), colour, np.eye(4))
        line.points = list(state.points)
        x, y, z = np.mean([(p.x, p.y, p.z) for p in state.points], axis=0)
        above = translation(x, y, z + TEXT_ABOVE_M)
        text = _marker(header, "distance", 0, Marker.TEXT_VIEW_FACING, (0.0, 0.0, LABEL_M), colour, above)
        text.text = f"{state.pair[0]} - {state.pair[1]}: {1e3 * state.distance:.0f} mm"
        markers = [line, text]
        if self._count % bodies_every == 0:
            for number, (body, T) in enumerate(self._guard.placed(joints.tolist())):
                # The robot's description shows the table, and walls between arms would hide both.
                if body.name != TABLE and not body.name.startswith(SIDE):
                    markers += _body(header, number, body, T)
        self._count += 1
        return markers


def _body(header: Header, number: int, body: ConvexBody, T: np.ndarray) -> list[Marker]:
    robot = body.link > 0 or body.name.startswith("base")
    look = Header(0, header.stamp, header.frame_id), "robot" if robot else "around"
    colour, shape = ROBOT if robot else AROUND, body.shape
    if shape.kind == "box":
        return [_marker(*look, 3 * number, Marker.CUBE, shape.size, colour, T)]
    across = 2.0 * shape.size[0]
    ball = (across, across, across)
    if shape.kind == "sphere":
        return [_marker(*look, 3 * number, Marker.SPHERE, ball, colour, T)]
    height = shape.size[1]
    markers = [_marker(*look, 3 * number, Marker.CYLINDER, (across, across, max(height, 1e-3)), colour, T)]
    if shape.kind == "capsule":
        ends = (T @ translation(0.0, 0.0, side * height / 2.0) for side in (-1.0, 1.0))
        markers += [_marker(*look, 3 * number + 1 + i, Marker.SPHERE, ball, colour, end) for i, end in enumerate(ends)]
    return markers


def _marker(header: Header, space: str, number: int, kind: int, size, colour: ColorRGBA, T: np.ndarray) -> Marker:
    marker = Marker(header=header, ns=space, id=number, type=kind, action=Marker.ADD, color=colour)
    marker.header.stamp = rospy.Time()
    marker.pose, marker.scale = message_from_pose(T), Vector3(*size)
    marker.lifetime = rospy.Duration.from_sec(2.0)
    return marker
