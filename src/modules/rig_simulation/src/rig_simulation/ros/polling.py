"""Polls the control port of a simulated device: at a rate while it answers, slowly while it does not."""

from __future__ import annotations

import time
from collections.abc import Callable

import rospy
from std_srvs.srv import TriggerRequest, TriggerResponse

from common.errors import DeviceError
from rig_simulation.control_port import ControlClient

RETRY_PERIOD_S = 0.5
REMIND_S = 10.0
START_S = 5.0
"""Time in which a device may start or restart without a warning."""


def poll(publish: Callable[[], None], period: float) -> None:
    """Calls `publish` until ROS shuts down.

    Args:
        publish: asks the device and publishes its answer; raises DeviceError while the device does not answer.
        period: of the calls while it answers [s].
    """
    due = answered = time.monotonic()
    while not rospy.is_shutdown():
        try:
            publish()
        except DeviceError as error:
            if time.monotonic() - answered > START_S:
                rospy.logwarn_throttle(REMIND_S, "%s", error)
            due = time.monotonic() + RETRY_PERIOD_S
        else:
            answered = time.monotonic()
            due = max(due + period, answered)
        time.sleep(max(0.0, due - time.monotonic()))


def trigger(client: ControlClient, request: str, done: str) -> Callable[[TriggerRequest], TriggerResponse]:
    """Returns the handler of a Trigger service that sends a request; its reply is `done`, or the refusal."""

    def handle(_: TriggerRequest) -> TriggerResponse:
        try:
            client.ask(request)
        except DeviceError as error:
            return TriggerResponse(False, str(error))
        return TriggerResponse(True, done)

    return handle
