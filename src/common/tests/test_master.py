"""A node whose ROS master is gone says so, and exits when another one answers in its place."""

from __future__ import annotations

import os
import sys

import pytest

pytest.importorskip("rig_msgs.srv")
import rosgraph

from common.ros import master
from common.ros.master import NoMaster, check_surroundings

pytestmark = [pytest.mark.ros, pytest.mark.real]

NODE = """
import sys
import rospy
from std_msgs.msg import String
from common.ros import master, node
def lost(sentence):
    print("disengaged")
    if "subscribes" in sys.argv:
        rospy.Subscriber("wanted", String)  # waits for a master
def main():
    print("begun")
    rospy.spin()
master.watch.lost.append(lost)
node.run("lonely", main)
"""


@pytest.mark.parametrize("then", ["waits", "subscribes"])
def test_a_node_disengages_without_its_master_and_exits_when_another_one_answers(
    processes, free_port, wait_until, then
):
    """Also one that subscribes to something while there is no master: rospy tells the other one of that topic alone."""
    port = free_port()
    environment = {**os.environ, "ROS_MASTER_URI": f"http://localhost:{port}"}

    def master():
        core = processes.start("rosmaster", "--core", "-p", str(port), env=environment)
        wait_until(lambda: answers(environment["ROS_MASTER_URI"]), 30.0, "the master")
        return core

    first = master()
    lonely = processes.start(sys.executable, "-c", NODE, then, env=environment)
    wait_until(lambda: "begun" in lonely.log_path.read_text(), 30.0, "the node")
    first.kill()  # one that ends by itself answers for a while
    wait_until(lambda: "disengaged" in lonely.log_path.read_text(), 20.0, "that the master is gone")
    master()
    wait_until(lambda: lonely.poll() is not None, 20.0, "the end of the node")
    log = lonely.log_path.read_text()
    assert lonely.returncode == 1 and "started anew" in log and "Traceback" not in log, log


@pytest.mark.parametrize("busy", [1, 100])
def test_a_node_that_starts_has_patience_with_a_master_that_is_busy(monkeypatch, busy):
    """With the nodes of a whole rig, which begin at once."""
    asked = []

    def ask(method):
        asked.append(method)
        if len(asked) <= busy:
            raise master.MasterLost("The ROS master at http://a:1 does not answer.")

    monkeypatch.setattr(master, "listens", lambda uri: True)
    monkeypatch.setattr(master, "ask_master", ask)
    monkeypatch.setattr(master, "RETRY_S", 0.02)
    if busy == 1:
        master.check_master(5.0)
        return
    with pytest.raises(master.NoMaster, match="or something else listens there"):
        master.check_master(0.1)


def answers(uri):
    try:
        return rosgraph.Master("/test", uri).getPid()
    except OSError:
        return None


@pytest.mark.parametrize(
    ("ipv6", "host", "cure"),
    [("off", "[::1]", "or set ROS_IPV6=on"), ("on", "127.0.0.1", "unset ROS_IPV6"), ("off", "nobody.invalid", "name")],
)
def test_a_masters_address_of_the_other_internet_protocol_is_told(monkeypatch, ipv6, host, cure):
    monkeypatch.setenv("ROS_IPV6", ipv6)
    monkeypatch.setenv("ROS_MASTER_URI", f"http://{host}:11999")
    with pytest.raises(NoMaster, match=rf"has no address: correct .*{cure}\.$"):
        check_surroundings()
