"""The node operator_view: what the operator sees, for RViz, the control panel and the headset's page, and hears. It
listens only while somebody looks, or with sounds, and reads no more messages than it shows: a callback that takes its
period makes rospy skip those in between."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields

import rospy
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from common import clock
from common.config import parse
from common.frames import VIRTUAL_LEAP
from common.hand_tracking import ANY, LEFT, RIGHT
from common.robot_hand import HAND, hand_state
from common.ros.node import repeat, while_running
from common.ros.on_demand import OnDemand
from common.ros.params import arm_frames, private_config
from common.teleop_record import teleop_record
from leap_motion.frames import TrackingFrame
from leap_motion.ros.hand_markers import hand_markers
from leap_motion.ros.tracking import ReceivedSkeletons, subscribe
from leap_rig.cockpit.cloud import CloudFault, thinned
from leap_rig.operator.cues import Sounds
from leap_rig.operator.ros.markers import LIFETIME, cloud_message, view_markers
from leap_rig.operator.ros.speaker import Speaker
from leap_rig.operator.view import (
    ArmView,
    DelayView,
    GripView,
    GuardedPair,
    OperatorView,
    OperatorViewConfig,
    Record,
    TouchConfig,
)
from reflex_msgs.msg import Hand
from rig_msgs.msg import GuardState, KukaStatus, OperatorRow, TeleopState
from rig_msgs.msg import OperatorView as OperatorViewMessage

PERIOD_S = 0.1
CLOUD = "camera/depth_registered/points"
CLOUD_PERIOD_S, MOST_POINTS = 1.0, 20_000  # whole ones are too much without a graphics card
HEARTBEAT_S = 0.5  # longest time between two messages with the same rows
HAND_TO_ARM = "hand_to_arm_ms"  # key of the measured delay in /diagnostics


class OperatorViewNode:
    """The topics of the view; `hand`: of the operator, which is shown: left, right or any."""

    def __init__(self, config: OperatorViewConfig, touch: TouchConfig, hand: str = ANY) -> None:
        self._frames, self._hand = arm_frames(), hand
        self._view, self._lock = OperatorView(touch.force_limit_pressure), clock.Lock()
        self._sounds, self._speaker = Sounds(), Speaker() if config.sounds else None
        self._listen = OnDemand(self._input_subscribers)
        self._watch_hands = OnDemand(lambda: [subscribe(self._skeletons, ReceivedSkeletons)])
        self._watch_cloud = OnDemand(lambda: [rospy.Subscriber(CLOUD, PointCloud2, self._take_cloud, queue_size=1)])
        self._next_cloud = -math.inf
        self._published: tuple[object, float] = None, -math.inf
        self._rows = rospy.Publisher("operator_view/rows", OperatorViewMessage, queue_size=2)
        self._markers = rospy.Publisher("operator_view/markers", MarkerArray, queue_size=2)
        self._hands = rospy.Publisher("operator_view/hands", MarkerArray, queue_size=2)
        self._cloud = rospy.Publisher("operator_view/cloud", PointCloud2, queue_size=1)
        repeat(self._follow, PERIOD_S, "topics")  # beside the view: rospy waits for a master that hangs

    def step(self) -> None:
        """Publishes what the operator sees now, to those who look."""
        now = clock.monotonic()
        with self._lock:
            rows, cue, taxels = self._view.rows(now), self._view.cue(now), self._view.taxels(now)
        sound = self._sounds.step(cue, now)
        if sound is not None and self._speaker is not None:
            self._speaker.play(sound)
        shown, at = self._published
        if not self._looks or (rows == shown and now - at < HEARTBEAT_S):
            return
        self._published = rows, now
        if self._markers.get_num_connections():
            self._markers.publish(view_markers(rows, taxels, self._frames))
        if self._rows.get_num_connections():
            lines = [OperatorRow(r.name, r.text, r.tone.value, r.kind, r.labels, r.values) for r in rows]
            self._rows.publish(OperatorViewMessage(Header(stamp=rospy.Time.now()), lines))

    @property
    def _looks(self) -> bool:
        return any(publisher.get_num_connections() for publisher in (self._rows, self._markers))

    def _follow(self) -> None:
        self._listen.follow(self._looks or self._speaker is not None)
        self._watch_hands.follow(self._hands.get_num_connections() > 0)
        # One at a time: its node computes none that nobody wants.
        self._watch_cloud.follow(self._cloud.get_num_connections() > 0 and clock.monotonic() >= self._next_cloud)

    def _input_subscribers(self) -> list[rospy.Subscriber]:
        return [
            self._subscribe("leap_kuka/state", TeleopState, lambda message: self._take(teleop_record(message))),
            self._subscribe("kuka/status", KukaStatus, self._record(ArmView)),
            self._subscribe("kuka/guard", GuardState, self._record(GuardedPair)),
            self._subscribe(HAND.state, Hand, self._grip),
            rospy.Subscriber("/diagnostics", DiagnosticArray, self._diagnostics, queue_size=20),
        ]

    @staticmethod
    def _subscribe(topic: str, kind: type, take: Callable) -> rospy.Subscriber:
        buffer_bytes = 2**18  # room for the messages of a period, so that all but the newest are skipped unread

        def callback(message) -> None:
            take(message)
            clock.sleep(PERIOD_S)

        return rospy.Subscriber(topic, kind, callback, queue_size=1, buff_size=buffer_bytes)

    def _record(self, kind: type[Record]) -> Callable:
        names = [field.name for field in fields(kind)]
        return lambda message: self._take(kind(*(getattr(message, name) for name in names)))

    def _take(self, record) -> None:
        with self._lock:
            self._view.take(record, clock.monotonic())

    def _grip(self, message: Hand) -> None:
        hand = hand_state(message)
        angles = hand.angles[: len(HAND.fingers)].tolist()
        self._take(GripView(angles, hand.pressures.tolist(), hand.contacts.any(axis=1).tolist()))

    def _diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.rpartition("/")[0] != self._frames.tf_prefix:
                continue  # of another arm
            for item in status.values:
                if item.key == HAND_TO_ARM:
                    try:
                        self._take(DelayView(float(item.value)))
                    except ValueError:  # nothing was measured yet
                        continue

    def _take_cloud(self, cloud: PointCloud2) -> None:
        now = clock.monotonic()
        if now < self._next_cloud:
            return
        self._next_cloud = now + CLOUD_PERIOD_S
        try:
            self._cloud.publish(cloud_message(cloud.header, *thinned(cloud, MOST_POINTS)))
        except CloudFault as fault:
            rospy.logwarn_throttle(10.0, "The point cloud is not shown: %s.", fault)

    def _skeletons(self, frame: TrackingFrame, _stamp: rospy.Time) -> None:
        skeleton_period_s = 1.0 / 15.0
        hands = [hand for hand in frame.hands if self._hand in (ANY, LEFT if hand.is_left else RIGHT)]
        self._hands.publish(MarkerArray(hand_markers(hands, self._frames(VIRTUAL_LEAP), LIFETIME)))
        clock.sleep(skeleton_period_s)


def main() -> None:
    hand = rospy.get_param("leap_hand", {})
    touch = parse(TouchConfig, hand, "leap_hand/", others=hand)
    node = OperatorViewNode(private_config(OperatorViewConfig), touch, rospy.get_param("leap/hand", ANY))
    while not rospy.is_shutdown():
        with while_running():
            node.step()
        clock.sleep(PERIOD_S)
