"""The node operator_input_node: a pedal or key, a gamepad on joy, and two services; leap_kuka/operator_input out."""

from __future__ import annotations

import contextlib
import os
import select

import rospy
from sensor_msgs.msg import Joy
from std_msgs.msg import Header
from std_srvs.srv import SetBool, SetBoolRequest

from common import clock
from common.config import parse
from common.ros.node import run, while_running
from leap_kuka.config import OPERATOR_INPUT
from leap_kuka.numbers import DEVICE_PERIOD_S, DEVICE_POLL_S, DEVICE_RETRY_S
from leap_kuka.operator_devices import CLUTCH, ENABLE, EVENT, OperatorInput, OperatorInputConfig
from rig_msgs.msg import OperatorInput as OperatorInputMessage


class OperatorInputNode:
    """Reads the device without waiting for it, and publishes each change at once."""

    def __init__(self, config: OperatorInputConfig) -> None:
        self._path = config.device
        self._input = OperatorInput(config)
        self._file: int | None = None
        self._retry_at = 0.0
        self._failure = ""
        self._lock = clock.Lock()
        self._sent: tuple[bool, bool, str] | None = None
        self._sent_at = 0.0
        self._publisher = rospy.Publisher(
            "leap_kuka/operator_input", OperatorInputMessage, queue_size=10, tcp_nodelay=True
        )
        rospy.Subscriber("joy", Joy, self._on_joy, queue_size=10, tcp_nodelay=True)
        for service, name in (("leap_kuka/set_enable", ENABLE), ("leap_kuka/set_clutch", CLUTCH)):
            rospy.Service(service, SetBool, lambda request, name=name: self._on_request(name, request))

    def run(self) -> None:
        while not rospy.is_shutdown():
            self._read()
            self._publish()
        self._close()

    def _read(self) -> None:
        if self._file is None and self._path and clock.monotonic() >= self._retry_at:
            self._open()
        if self._file is None:
            clock.sleep(DEVICE_POLL_S)
            return
        if not select.select([self._file], [], [], DEVICE_POLL_S)[0]:
            return
        try:
            data = os.read(self._file, 64 * EVENT.size)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(error.strerror or str(error))
            return
        if not data:
            self._lost("it has ended")
            return
        with self._lock:
            self._input.device.read(data, clock.monotonic())

    def _open(self) -> None:
        try:
            self._file = os.open(self._path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            self._lost(error.strerror or str(error))
            return
        self._failure = ""
        rospy.loginfo("Input device %s is open; press and release its clutch once, if it has one.", self._path)

    def _lost(self, why: str) -> None:
        if self._file is not None:
            self._close()
            with self._lock:
                self._input.device.lost(clock.monotonic())
        self._retry_at = clock.monotonic() + DEVICE_RETRY_S
        if why != self._failure:
            rospy.logwarn(
                "Input device %s cannot be read: %s; enabling by it is released, and its clutch is pressed until it is "
                "pressed and released once.",
                self._path,
                why,
            )
        self._failure = why

    def _close(self) -> None:
        if self._file is not None:
            with contextlib.suppress(OSError):
                os.close(self._file)
            self._file = None

    def _on_joy(self, message: Joy) -> None:
        with while_running():
            with self._lock:
                self._input.gamepad.take(list(message.buttons), clock.monotonic())
            self._publish()

    def _on_request(self, name: str, request: SetBoolRequest) -> tuple[bool, str]:
        with self._lock:
            fault = self._input.request(name, request.data, clock.monotonic())
        self._publish()
        if fault:
            return False, fault
        what = {ENABLE: "Enabling", CLUTCH: "The clutch"}[name]
        return True, f"{what} is {'pressed' if request.data else 'released'} by the service."

    def _publish(self) -> None:
        with self._lock:
            now = clock.monotonic()
            state = self._input.state(now)
            if state == self._sent and now - self._sent_at < DEVICE_PERIOD_S:
                return
            self._sent, self._sent_at = state, now
            enabled, clutch, source = state
            self._publisher.publish(OperatorInputMessage(Header(0, rospy.Time.now(), ""), source, enabled, clutch))


def _run() -> None:
    values = rospy.get_param(f"leap/{OPERATOR_INPUT}", {})
    OperatorInputNode(parse(OperatorInputConfig, values, f"leap/{OPERATOR_INPUT}/")).run()


def main() -> None:
    run("operator_input_node", _run)
