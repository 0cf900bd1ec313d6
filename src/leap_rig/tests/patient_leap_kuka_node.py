#!/usr/bin/env python3
"""The node leap_kuka_node for tests on a busy machine: late frames do not end a stream.

What the limits of the node as shipped do is tested in leap_kuka, where the test has the clock.
"""

from common import hand_tracking
from leap_kuka import teleop
from leap_kuka.ros.teleop_node import main

if __name__ == "__main__":
    teleop.MAX_SILENCE_S = 1.0
    teleop.MIN_RATE_HZ = teleop.ENOUGH_RATE_HZ = 2.0
    hand_tracking.MAX_SKEW_S = 2.0
    # An outlier is one whenever it comes, and a hand may move far between two frames.
    hand_tracking.MAX_STEP_M = 0.18
    hand_tracking.MAX_SPEED_M_S = hand_tracking.LONG_GAP_SPEED_M_S = 0.0
    main()
