"""The delay from the hand to the arm, for /diagnostics: the palm's motion, and that of the measured tool on tf."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import rospy

from common import clock
from common.frames import BASE, FLANGE_MEASURED, ONE_ARM, ArmFrames
from common.hand_delay import DelayMeter
from common.ros.raw_tf import RawTransform, TransformSearch, callbacks_of, publisher_of
from leap_kuka.numbers import READ_S, REST_S


class DelayMonitor:
    """Measures the delay. `T_tool_flange`: pose of the flange in the tool frame, shape (4, 4).

    Attributes:
        palm: track of the hand that steers, in the Leap frame."""

    _looked: ClassVar[dict[str, float]] = {}  # by publisher [s]; of all monitors of the process, which rest together

    def __init__(self, T_tool_flange: np.ndarray, frames: ArmFrames = ONE_ARM) -> None:
        self._find_flange = TransformSearch(frames(BASE), frames(FLANGE_MEASURED))
        self._meter = DelayMeter()
        self._tool_in_flange = (-T_tool_flange[:3, :3].T @ T_tool_flange[:3, 3]).tolist()
        self.palm = self._meter.palm
        self._subscriber: rospy.Subscriber | None = None
        self._subscriber = rospy.Subscriber("/tf", rospy.AnyMsg, self._take, buff_size=2**20, tcp_nodelay=True)

    def values(self) -> dict[str, str]:
        """Returns the delay and its 10th and 90th percentile [ms]; empty while too little moves to tell."""
        delay = self._meter.at(rospy.get_time())
        numbers = (None,) * 3 if delay is None else (delay.median, delay.low, delay.high)
        names = ("hand_to_arm_ms", "hand_to_arm_p10_ms", "hand_to_arm_p90_ms")
        return {name: "" if value is None else f"{1e3 * value:.0f}" for name, value in zip(names, numbers)}

    def _take(self, message: rospy.AnyMsg) -> None:
        """Takes a message of tf, as bytes. Each publisher has a thread here, which rests, so that several messages
        are read at once; not where this process subscribes to tf for something else, which rospy calls in the same
        thread."""
        publisher, now = publisher_of(message), clock.monotonic()
        callbacks = [] if self._subscriber is None else callbacks_of(self._subscriber)
        alone = bool(callbacks) and all(isinstance(getattr(f, "__self__", None), DelayMonitor) for f in callbacks)
        if alone and now - self._looked.get(publisher, 0.0) > READ_S:
            clock.sleep(REST_S)
            self._looked[publisher] = clock.monotonic()
        flange = self._find_flange(message)
        if flange is not None:
            self._meter.tool.add(flange.time, self._tool(flange))

    def _tool(self, flange: RawTransform) -> tuple[float, ...]:
        """Returns the position of the tool [m]."""
        px, py, pz, x, y, z, w = flange.numbers
        a, b, c = self._tool_in_flange
        tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
        return px + a + w * tx + y * tz - z * ty, py + b + w * ty + z * tx - x * tz, pz + c + w * tz + x * ty - y * tx
