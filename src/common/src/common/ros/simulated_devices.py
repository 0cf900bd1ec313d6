"""Simulated devices on the ROS master of a real arm or hand: their nodes announce them, and what moves it ends."""

from __future__ import annotations

import rospy
from std_msgs.msg import String

from common import clock
from common.errors import DeviceError
from common.ros.service_calls import ask_master

TOPIC = "/simulated_devices"
REFUSED = (
    "The node {node} belongs to simulated devices, and on the same ROS master they could move the real {device}, so "
    "this node ends. End one of the two rigs."
)


def announce() -> rospy.Publisher:
    """Tells all on this ROS master that this node belongs to simulated devices, until it ends or the returned publisher
    is unregistered."""
    publisher = rospy.Publisher(TOPIC, String, queue_size=1, latch=True)
    publisher.publish(rospy.get_name())
    return publisher


class SimulatedDevices:
    """Those on the ROS master of a real device; `device` ends the part of a sentence."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._node = ""
        self._heard = clock.Event()
        rospy.Subscriber(TOPIC, String, self._take, queue_size=1)

    def refuse(self) -> None:
        """Waits for what nodes have announced already; raises DeviceError as `check`."""
        latched_s = 3.0  # a node that lives delivers what it announced within this time [s]
        if TOPIC in dict(ask_master("getSystemState")[0]):  # perhaps of a node that was killed: then nothing comes
            self._heard.wait(latched_s)
        self.check()

    def check(self) -> None:
        """Raises DeviceError once a node has announced simulated devices."""
        if self._node:
            raise DeviceError(REFUSED.format(node=self._node, device=self._device))

    def _take(self, message: String) -> None:
        self._node = message.data
        self._heard.set()
