"""The node leap_teleop: leap_driver, leap_kuka_node and leap_hand_node in one process, with their topics and services.
A tracking frame is read once and wakes one process instead of three; the messages go out for whoever listens. Without a
robot hand the arm's teleoperation runs alone, as with three nodes. The teleoperations of several arms run here beside
each other, each with the names of its namespace; and what chooses the arm that one hand steers."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from common.hand_tracking import ANY
from common.numbers import SWITCH_INTERVAL_S
from common.ros.node import dispensable, run, run_together
from common.ros.params import private_config, wait_for_param
from leap_hand.config import NodeConfig
from leap_hand.ros import teleop_node as hand
from leap_kuka.ros import arm_choice_node as choices
from leap_kuka.ros import teleop_node as arm
from leap_motion.ros import driver
from leap_motion.ros.parameters import DriverConfig
from leap_motion.ros.tracking import FramesHere
from leap_rig.teleop_config import DRIVER, HAND, LeapTeleopConfig


def _start() -> None:
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    arms = private_config(LeapTeleopConfig, others=(DRIVER, HAND)).arms
    driver_config, hand_config = private_config(DriverConfig, DRIVER), private_config(NodeConfig, HAND)
    frames = FramesHere()
    jobs: list[Callable[[], None]] = [partial(driver.start, driver_config, frames.pass_on)]
    choice = choices.arm_choice(arms) if arms else None
    if choice is not None:
        jobs.append(partial(choices.start, choice, partial(frames.subscribe, first=True)))
    for of in [f"{name}/" for name in arms] or [""]:
        side = ANY if choice is not None else wait_for_param(f"{of}leap/hand") if of else hand_config.hand
        follows = replace(hand_config, hand=side)
        jobs.append(partial(arm.start, partial(frames.subscribe, first=True), of))
        jobs.append(partial(dispensable, partial(hand.start, follows, frames.subscribe, of)))
    run_together(*jobs)


def main() -> None:
    """Runs the node until ROS shuts down."""
    run("leap_teleop", _start)
