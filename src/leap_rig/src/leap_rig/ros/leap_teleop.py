"""The node leap_teleop: leap_driver, leap_kuka_node and leap_hand_node in one process, with their topics and services.

A tracking frame is read once and wakes one process instead of three; the messages go out for whoever listens.
Without a robot hand the arm's teleoperation runs alone, as with three nodes.
"""

from __future__ import annotations

import sys
from functools import partial

from common.ros.node import dispensable, run, run_together
from common.ros.params import private_config
from leap_hand.config import NodeConfig
from leap_hand.ros import teleop_node as hand
from leap_kuka.ros import teleop_node as arm
from leap_motion.ros import driver
from leap_motion.ros.parameters import DriverConfig
from leap_motion.ros.tracking import FramesHere

SWITCH_INTERVAL_S = 5e-4  # a frame waits at most this long for another thread of this process [s]
DRIVER, HAND = "driver", "hand"
"""The sections of the private parameters: those of leap_driver and of leap_hand_node."""


def _start() -> None:
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    driver_config, hand_config = private_config(DriverConfig, DRIVER), private_config(NodeConfig, HAND)
    frames = FramesHere()
    run_together(
        partial(driver.start, driver_config, frames.pass_on),
        partial(arm.start, partial(frames.subscribe, first=True)),
        partial(dispensable, partial(hand.start, hand_config, frames.subscribe)),
    )


def main() -> None:
    """Runs the node until ROS shuts down."""
    run("leap_teleop", _start)
