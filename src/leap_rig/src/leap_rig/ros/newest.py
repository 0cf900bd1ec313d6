"""What the rig has published last, for programs that act on it; the arm is that of the program's namespace."""

from __future__ import annotations

from functools import partial
from typing import Any

import rospy
from tf2_msgs.msg import TFMessage

from common import clock
from common.errors import DeviceError
from common.frames import BASE
from common.ros.params import arm_frames
from leap_rig.cockpit.frame_poses import FramePoses, Pose7

READ_BYTES = 2**22  # of a subscriber's buffer: rospy's own is smaller than an image


class NewestMessages:
    """The newest message of each topic that is heard, and of tf."""

    def __init__(self) -> None:
        self.frames = arm_frames()
        self._lock = clock.Lock()
        self._newest: dict[str, tuple[float, Any]] = {}
        self._poses = FramePoses()
        for topic in ("/tf", "/tf_static"):
            rospy.Subscriber(topic, TFMessage, partial(self._transforms, topic), queue_size=100, tcp_nodelay=True)

    def hear(self, topic: str, kind: type, name: str = "") -> None:
        """Keeps the messages of a topic from now on, by a `name` if it is not to be that of the topic."""
        keep = partial(self._keep, name or topic)
        rospy.Subscriber(topic, kind, keep, queue_size=1, buff_size=READ_BYTES, tcp_nodelay=True)

    def of(self, name: str, oldest: float) -> Any:
        """Returns the newest message; raises DeviceError if none has come for `oldest` [s]."""
        with self._lock:
            at, message = self._newest.get(name, (float("-inf"), None))
        age = clock.monotonic() - at
        if message is None or age > oldest:
            raise DeviceError(f"{name} has said nothing {'yet' if message is None else f'for {age:.1f} s'}.")
        return message

    def pose(self, frame: str, oldest: float) -> Pose7 | None:
        """Returns the pose of a frame in the arm's base; None if it is unknown, or has not come for `oldest` [s]."""
        with self._lock:
            fresh = clock.monotonic() - self._poses.received(frame) < oldest
            return self._poses.between(self.frames(BASE), frame) if fresh else None

    def _keep(self, name: str, message: Any) -> None:
        with self._lock:
            self._newest[name] = clock.monotonic(), message

    def _transforms(self, topic: str, message: TFMessage) -> None:
        received = float("inf") if topic == "/tf_static" else clock.monotonic()
        with self._lock:
            self._poses.take(message.transforms, received)
