"""Readings of the hand as ROS messages."""

from __future__ import annotations

import rospy
from sensor_msgs.msg import JointState

from reflex.reading import JOINT_NAMES, HandReading, joint_positions
from reflex_msgs.msg import Finger, Hand, Motor


def hand_message(reading: HandReading) -> Hand:
    """Returns the message of /reflex_takktile/hand_state."""
    fingers = [
        Finger(
            proximal=reading.proximal[i],
            distal_approx=reading.distal[i],
            contact=list(reading.contact[i]),
            pressure=[float(p) for p in reading.pressure[i]],
        )
        for i in range(3)
    ]
    packet = reading.packet
    motors = [
        Motor(
            joint_angle=reading.joint_angles[i],
            raw_angle=packet.positions[i],
            velocity=packet.speeds[i],
            load=reading.loads[i],
            voltage=packet.voltages[i],
            temperature=packet.temperatures[i],
            error_state=f"0x{packet.errors[i]:02x}",
        )
        for i in range(4)
    ]
    return Hand(finger=fingers, motor=motors)


def joint_state(reading: HandReading, stamp: rospy.Time) -> JointState:
    """Returns the hand's joints for robot_state_publisher."""
    message = JointState(name=list(JOINT_NAMES), position=list(joint_positions(reading)))
    message.header.stamp = stamp
    return message
