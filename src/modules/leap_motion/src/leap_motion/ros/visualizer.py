"""The node leap_motion_visualizer: the hands on leap_motion/leap_device as markers, while somebody looks."""

from __future__ import annotations

import rospy
from visualization_msgs.msg import MarkerArray

from common import clock
from common.ros.node import run
from common.ros.on_demand import OnDemand
from common.ros.params import private_config
from leap_motion.frames import TrackingFrame
from leap_motion.ros.hand_markers import hand_markers
from leap_motion.ros.parameters import VisualizerConfig
from leap_motion.ros.tracking import ReceivedSkeletons, subscribe

SILENT_S = 3.0
LIFETIME = rospy.Duration.from_sec(0.3)  # a hand that the tracker has lost vanishes


class Visualizer:
    """Publishes markers in `frame`."""

    def __init__(self, config: VisualizerConfig) -> None:
        self._frame = config.frame
        self._drawn_at = 0.0
        self._markers = rospy.Publisher("leap_motion/visualization_marker_array", MarkerArray, queue_size=2)
        self._watch = OnDemand(lambda: [subscribe(self._draw, ReceivedSkeletons)])

    def run(self) -> None:
        """Listens while somebody looks, until ROS shuts down; says so where no frames come."""
        poll_s = 0.1
        remind_s = 10.0
        while not rospy.is_shutdown():
            looks, now = self._markers.get_num_connections() > 0, clock.monotonic()
            self._watch(looks)
            if not looks:
                self._drawn_at = now
            elif now - self._drawn_at > SILENT_S:
                missing = f"Nothing comes on {rospy.resolve_name('leap_motion/leap_device')}"
                start = "start the driver: roslaunch leap_motion leap_driver.launch"
                rospy.logwarn_throttle(remind_s, f"{missing}; {start}.")
            clock.sleep(poll_s)

    def _draw(self, frame: TrackingFrame, _stamp: rospy.Time) -> None:
        period_s = 1.0 / 30.0  # between two frames that are drawn
        self._drawn_at = clock.monotonic()
        self._markers.publish(MarkerArray(hand_markers(frame.hands, self._frame, LIFETIME, details=True)))
        clock.sleep(period_s)  # rospy skips the frames that come meanwhile


def main() -> None:
    run("leap_motion_visualizer", lambda: Visualizer(private_config(VisualizerConfig)).run())
