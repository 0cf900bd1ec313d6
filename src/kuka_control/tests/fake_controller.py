"""A controller of the arm without an arm, for the tests of the control panel: the services and kuka/status.

SIGUSR1 stops the status and starts it again, as if the control loop hung while the services still answer.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket

import rospy

from common import clock
from kuka_control.model.switches import Switches
from kuka_control.ros.services import Services
from rig_msgs.msg import KukaStatus

PERIOD_S = 0.05


class SlowSwitches(Switches):
    """Takes its time before it changes the scaling factor."""

    def __init__(self, delay: float) -> None:
        super().__init__()
        self._delay = delay

    def set_scale(self, factor):
        clock.sleep(self._delay)
        return super().set_scale(factor)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--host", default=socket.gethostname(), help="machine that the status names")
    parser.add_argument("--pid", type=int, default=os.getpid(), help="process that the status names")
    parser.add_argument("--delay", type=float, default=0.0, help="time before a new scaling factor is taken [s]")
    arguments = parser.parse_args(rospy.myargv()[1:])
    rospy.init_node("fake_controller")
    silent = [False]
    signal.signal(signal.SIGUSR1, lambda *_: silent.__setitem__(0, not silent[0]))
    switches = SlowSwitches(arguments.delay)
    switches.report("home", None)
    services = Services(switches)
    publisher = rospy.Publisher("kuka/status", KukaStatus, queue_size=10, latch=True)
    while not rospy.is_shutdown():
        now = switches.now
        status = KukaStatus(
            host=arguments.host, pid=arguments.pid, control_on=now.control_on, gripper_on=now.gripper_on,
            scaling_factor=now.scale, mode="home", reason="The arm is at home.",
        )  # fmt: skip
        if not silent[0]:
            publisher.publish(status)
        clock.sleep(PERIOD_S)
    del services


if __name__ == "__main__":
    main()
