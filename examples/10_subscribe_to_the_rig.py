"""Prints the joints that the running rig publishes, once a second; start the rig with `make demo` first."""

import argparse

import rospy
from sensor_msgs.msg import JointState

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--topic", default="joint_states")
parser.add_argument("--seconds", type=float, default=10.0)
options = parser.parse_args(rospy.myargv()[1:])


def show(message: JointState) -> None:
    joints = ", ".join(f"{name} {position:.3f}" for name, position in zip(message.name, message.position))
    rospy.loginfo_throttle(1.0, f"joints [rad]: {joints}")


rospy.init_node("joint_printer", anonymous=True)
rospy.Subscriber(options.topic, JointState, show)
rospy.Timer(rospy.Duration(options.seconds), lambda _: rospy.signal_shutdown("time is up"), oneshot=True)
rospy.spin()  # rospy.sleep would go on sleeping after Ctrl-C
