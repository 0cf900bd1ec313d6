"""Simulated devices on the ROS master of a real arm or hand, in virtual time: what could move it ends."""

from __future__ import annotations

import itertools

import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
from std_msgs.msg import String

from reflex.ros import driver
from reflex_msgs.msg import Hand
from simulated.hand_wire import HandWire
from simulated.leap_wire import LeapWire

pytestmark = pytest.mark.ros

TOPIC = "/simulated_devices"
LATCHED_S, WAIT_S = 3.0, 1.0
"""How long a node waits for what others have announced; what an announcement takes at most."""
SENTENCE = (
    "The node /operator belongs to simulated devices, and on the same ROS master they could move the real hand on lo"
)


@pytest.fixture
def announce(ros):
    """Announces a node of simulated devices, as itself."""
    publisher = rospy.Publisher(TOPIC, String, queue_size=1, latch=True)
    yield lambda: publisher.publish("/operator")
    publisher.unregister()


def simulation(ros, wire):
    ros.run("rig_simulation", "simulation_node.py", "__name:=it")


def operator(ros, wire):
    ros.run("rig_simulation", "operator_node.py", "__name:=it")


def leap_driver(ros, wire):
    def talk(service, connection):
        connection.send('{"version":6,"simulated":true}')
        service.ended.wait()

    ros.run("leap_motion", "leap_driver.py", f"_port:={wire.serve(talk).port}", "__name:=it")


@pytest.mark.parametrize("start", [simulation, operator, leap_driver])
def test_the_nodes_of_simulated_devices_announce_them(ros, start):
    announced = ros.record(TOPIC, String)
    with LeapWire() as wire:
        start(ros, wire)
        announced.wait(1, WAIT_S)
    assert [message.data for message in announced] == ["/it"]


@pytest.fixture
def real_hand(ros, monkeypatch, tmp_path):
    """Starts the hand's driver on an interface that is not loopback, for all it knows."""
    monkeypatch.setattr(driver, "LOOPBACK", "none")
    with HandWire():
        yield lambda: ros.launch("reflex", "reflex_takktile.launch", eth="lo", calibration_folder=tmp_path)


def test_the_driver_of_a_real_hand_refuses_simulated_devices_that_are_there(ros, announce, real_hand):
    states = ros.record("/reflex_takktile/hand_state", Hand)
    announce()
    driver = real_hand()
    ros.wait_until(lambda: driver.poll() is not None, LATCHED_S + WAIT_S, "the end")
    said = driver.read_text()
    assert SENTENCE in said and "Traceback" not in said
    assert not states, "the hand was connected"


def test_the_driver_of_a_real_hand_ends_when_simulated_devices_come(ros, announce, real_hand):
    states = ros.record("/reflex_takktile/hand_state", Hand)
    driver = real_hand()
    states.wait(1, 10.0)
    announce()
    ros.wait_until(lambda: driver.poll() is not None, WAIT_S, "the end")
    assert SENTENCE in driver.read_text()


def test_a_tracker_that_comes_in_place_of_a_simulated_one_is_announced_no_more(ros):
    said = itertools.chain(['{"version":6,"simulated":true}'], itertools.repeat('{"version":6}'))

    def talk(service, connection):
        connection.send(next(said))
        service.ended.wait(2.0)

    announced = ros.record(TOPIC, String)
    with LeapWire() as wire:
        ros.run("leap_motion", "leap_driver.py", f"_port:={wire.serve(talk).port}", "__name:=it")
        clock.sleep(1.0)
        assert TOPIC in ros.names("/it")["publishes"]
        ros.wait_until(lambda: TOPIC not in ros.names("/it")["publishes"], 10.0, "the real tracker")
        clock.sleep(1.0)
    assert [message.data for message in announced] == ["/it"]
