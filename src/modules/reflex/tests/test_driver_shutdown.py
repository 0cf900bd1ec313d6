"""The driver node at the shutdown of ROS, without a master."""

import pytest

pytest.importorskip("reflex_msgs.msg")
import rospy

from reflex.ros import driver

pytestmark = pytest.mark.ros


class StubHand:
    """A hand whose receive thread ends with the connection, as that of ReflexHand."""

    def __init__(self):
        self.listening = False

    def connect(self):
        self.listening = True

    def disconnect(self):
        self.listening = False


@pytest.fixture
def node(monkeypatch):
    """The driver without its topics and services; `rospy.on_shutdown` leaves its callback in `callbacks`."""
    node = object.__new__(driver.HandDriver)
    node._hand, node._beside, node.callbacks = StubHand(), None, []
    monkeypatch.setattr(node, "_offer", lambda: None)
    monkeypatch.setattr(driver.rospy, "on_shutdown", node.callbacks.append)
    return node


def test_the_time_between_callbacks_and_shutdown_is_no_fault(node, monkeypatch):
    """is_shutdown() turns true only after the callbacks and after the node was unregistered at the master."""

    def shut_down(_):
        monkeypatch.setattr(rospy.core, "_in_shutdown", True)
        for callback in node.callbacks:
            callback()
        monkeypatch.setattr(driver.clock, "sleep", unregistered)

    def unregistered(_):
        monkeypatch.setattr(driver.rospy, "is_shutdown", lambda: True)

    monkeypatch.setattr(driver.rospy, "is_shutdown", lambda: False)
    monkeypatch.setattr(driver.clock, "sleep", shut_down)
    node.run()


def test_a_receive_thread_that_ends_by_itself_is_a_defect(node, monkeypatch):
    monkeypatch.setattr(driver.rospy, "is_shutdown", lambda: False)
    monkeypatch.setattr(driver.clock, "sleep", lambda _: node._hand.disconnect())
    with pytest.raises(RuntimeError):
        node.run()
