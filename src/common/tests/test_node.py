"""The life of a node: how it ends when it is interrupted."""

from __future__ import annotations

import signal
import sys

import pytest

pytestmark = pytest.mark.ros

PUBLISHING = """
import os, signal, sys
import rospy
from std_msgs.msg import String
from common.ros.node import run

class InterruptedQueue(list):
    def append(self, item):  # called while the lock of the queue is held
        super().append(item)
        os.kill(os.getpid(), {signal})

def main():
    publisher = rospy.Publisher("chatter", String, queue_size=10)
    while publisher.get_num_connections() == 0:
        rospy.sleep(0.01)
    for connection in publisher.impl.connections:
        connection._queue = InterruptedQueue()
    while not rospy.is_shutdown():
        publisher.publish("again")

run("talker", main)
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_node_that_is_interrupted_while_it_publishes_ends(ros, processes, wait_until, name):
    from std_msgs.msg import String

    ros.record("chatter", String)
    process = processes.start(sys.executable, "-c", PUBLISHING.format(signal=int(getattr(signal, name))))
    wait_until(lambda: process.poll() is not None, 20.0, "the end of the node")
    log = process.log_path.read_text()
    assert process.returncode == 0 and "Traceback" not in log, log
