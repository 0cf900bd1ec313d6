"""The operator of the demonstration against a stand-in for the controller, in virtual time."""

import math

import pytest

from common import clock
from rig_simulation.control_port import ControlPort

pytest.importorskip("rig_msgs.srv")
import rospy

from kuka_msgs.msg import jointPositions
from kuka_msgs.srv import setGripperControl, setKukaControl
from rig_msgs.msg import KukaStatus

pytestmark = pytest.mark.ros

HOME = [0.1, -0.5, 0.0, 1.4, 0.0, -1.2, 0.3]
POLL_S, REMIND_S, SEEN_S = 0.1, 10.0, 0.1
"""How often the operator looks, and says why it waits; what its look and the publishing of joints take at most."""


class Controller:
    """Has the parameter, the topics and the two services of an arm's controller, whose status comes `status_s` after
    control was switched on; `of`: its namespace with a slash.
    """

    status_s = 0.0

    def __init__(self, of=""):
        self.calls = []
        self.joints = [0.0] * 7
        self.refusals = 0
        rospy.set_param(f"{of}kuka/joints_home", HOME)
        self._publisher = rospy.Publisher(f"{of}kuka/joint_positions", jointPositions, queue_size=1, latch=True)
        self._message = jointPositions
        self._status = rospy.Publisher(f"{of}kuka/status", KukaStatus, queue_size=1, latch=True)
        self._state = KukaStatus()
        self._status.publish(self._state)
        self._services = [
            rospy.Service(f"{of}kuka/gripper_control", setGripperControl, self._answer("gripper")),
            rospy.Service(f"{of}kuka/kuka_control", setKukaControl, self._answer("arm")),
        ]
        self._ended = clock.Event()
        clock.Thread(target=self._publish, daemon=True).start()

    def _answer(self, name):
        def answer(request):
            if self.refusals:
                self.refusals -= 1
                return False, "the arm moves"
            self.calls.append((name, request.data))
            return True, f"{name} control is on"

        return answer

    def _publish(self):
        on_at = math.inf
        while not self._ended.wait(0.05):
            self._publisher.publish(self._message(None, *self.joints))
            if ("arm", True) in self.calls and not self._state.control_on:
                on_at = min(on_at, clock.monotonic() + self.status_s)
                if clock.monotonic() >= on_at:
                    self._state.control_on = True
                    self._status.publish(self._state)

    def close(self):
        self._ended.set()
        for service in self._services:
            service.shutdown()
        self._publisher.unregister()
        self._status.unregister()


@pytest.fixture
def controller(ros):
    controller = Controller()
    yield controller
    controller.close()


@pytest.fixture
def leapd(ros):
    """A control port that notes that it was told to play."""
    played = clock.Event()
    with ControlPort({"play": played.set}) as port:
        port.played = played
        yield port


def test_waits_for_home_then_switches_on_and_plays(ros, controller, leapd):
    controller.refusals = 2
    node = ros.run("rig_simulation", "operator_node.py", f"_leapd_port:={leapd.port}")
    said = lambda: node.log_path.read_text().count("until the arm is at home")  # noqa: E731
    for after, count in ((0.9, 0), (0.4, 1), (REMIND_S - 0.4, 1), (0.4, 2)):
        clock.sleep(after)
        assert said() == count
    assert controller.calls == [] and not leapd.played.is_set()
    controller.joints = HOME
    clock.sleep(5 * POLL_S + SEEN_S)
    assert controller.calls == [("gripper", True), ("arm", True)] and leapd.played.is_set()
    clock.sleep(60.0)
    assert len(controller.calls) == 2 and node.poll() is None, "it lives on: a rig whose nodes end is not well"


def test_no_hand_comes_in_before_the_status_says_that_control_is_on(ros, controller, leapd):
    """leap_kuka hears of it by the status, and a hand that came in before is not followed."""
    controller.joints, controller.status_s = HOME, 3.0
    ros.run("rig_simulation", "operator_node.py", f"_leapd_port:={leapd.port}")
    clock.sleep(3.0)
    assert controller.calls == [("gripper", True), ("arm", True)] and not leapd.played.is_set()
    clock.sleep(3 * POLL_S + SEEN_S)
    assert leapd.played.is_set()


def test_without_auto_start_it_only_starts_the_hand(ros, controller, leapd):
    controller.joints = HOME
    ros.run("rig_simulation", "operator_node.py", f"_leapd_port:={leapd.port}", "_auto_start:=false")
    clock.sleep(2 * POLL_S + SEEN_S)
    assert leapd.played.is_set() and controller.calls == []


def test_a_hand_that_comes_late_is_waited_for(ros, controller):
    controller.joints = HOME
    node = ros.run("rig_simulation", "operator_node.py", "_leapd_port:=16437")
    clock.sleep(5.0)
    assert "until the simulated Leap service plays: The control port 127.0.0.1:16437" in node.log_path.read_text()
    played = clock.Event()
    with ControlPort({"play": played.set}, port=16437):
        clock.sleep(2 * POLL_S)
        assert played.is_set()


def test_ends_with_a_sentence_when_the_controller_never_comes(ros):
    node = ros.run("rig_simulation", "operator_node.py", "_time_out:=0.5")
    clock.sleep(0.5)
    assert node.poll() is None
    assert node.wait(2 * POLL_S + SEEN_S) == 1
    log = node.log_path.read_text()
    assert "0.5 s" in log and "Traceback" not in log


def test_ends_with_a_sentence_when_control_is_refused(ros, controller, leapd):
    controller.joints, controller.refusals = HOME, 10**6
    node = ros.run("rig_simulation", "operator_node.py", f"_leapd_port:={leapd.port}", "_time_out:=8.0")
    clock.sleep(8.0)
    assert node.poll() is None
    assert node.wait(4 * POLL_S) == 1
    assert "the arm moves" in node.log_path.read_text() and not leapd.played.is_set()


def test_of_several_arms_each_is_at_home_and_switched_on_before_the_hands_come(ros, leapd):
    arms = {name: Controller(f"{name}/") for name in ("left", "right")}
    rospy.set_param("/operator_node/arms", list(arms))
    arms["left"].joints = HOME
    ros.run("rig_simulation", "operator_node.py", "__name:=operator_node", f"_leapd_port:={leapd.port}")
    clock.sleep(30.0)
    assert arms["left"].calls == [("gripper", True), ("arm", True)] and arms["right"].calls == []
    assert not leapd.played.is_set()
    arms["right"].joints = HOME
    clock.sleep(2 * POLL_S + SEEN_S)
    assert arms["left"].calls == arms["right"].calls and leapd.played.is_set()
    for arm in arms.values():
        arm.close()


def test_a_scenario_of_one_arm_is_refused_for_several(ros):
    rospy.set_param("/operator_node/arms", ["left", "right"])
    node = ros.run("rig_simulation", "operator_node.py", "__name:=operator_node", "_scenario:=pick_cup")
    assert node.wait(1.0) == 1
    assert "scenario is pick_cup, which is for one arm, but arms are left, right" in node.log_path.read_text()
