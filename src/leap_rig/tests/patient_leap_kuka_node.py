#!/usr/bin/env python3
"""The node leap_kuka_node for tests on a busy machine: late frames do not end a stream.

What the limits of the node as shipped do is tested in leap_kuka, where the test has the clock. After the signal
SIGUSR1 each tracking frame raises an exception in the node's callback, and after the next one none does.
"""

import signal

from common import hand_tracking
from leap_kuka import teleop
from leap_kuka.ros.teleop_node import main


class PlantedFault:
    """Takes the place of ArmTeleop.step, which it calls while `on` is false."""

    def __init__(self) -> None:
        self.on = False
        self._step = teleop.ArmTeleop.step

    def toggle(self, *_) -> None:
        self.on = not self.on

    def step(self, *arguments):
        if self.on:
            raise RuntimeError("planted")
        return self._step(*arguments)


if __name__ == "__main__":
    fault = PlantedFault()
    teleop.ArmTeleop.step = lambda *arguments: fault.step(*arguments)
    signal.signal(signal.SIGUSR1, fault.toggle)
    teleop.MAX_SILENCE_S = 1.0
    teleop.MIN_RATE_HZ = teleop.ENOUGH_RATE_HZ = 2.0
    hand_tracking.MAX_SKEW_S = 2.0
    # An outlier is one whenever it comes, and a hand may move far between two frames.
    hand_tracking.MAX_STEP_M = 0.18
    hand_tracking.MAX_SPEED_M_S = hand_tracking.LONG_GAP_SPEED_M_S = 0.0
    main()
