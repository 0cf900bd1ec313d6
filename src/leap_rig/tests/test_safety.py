"""The safety features of the rig, each on the whole simulated rig: hand on the Leap's wire, arm behind the toolbox's.

Nothing here looks into a node. How the arm moves is the simulated arm's own word, sampled on its control port. All but
one run in virtual time, with the parameters as shipped.
"""

from __future__ import annotations

import signal
import socket

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("kuka_msgs.srv")
import rospy

from common import clock
from common.poses import pose
from common.ros.service_calls import ServiceClient
from common.rotations import rotation_about, rotation_angle
from kuka_control.ros import emergency
from kuka_msgs.srv import exitAppEmergency, setScalingFactor
from rig_msgs.msg import KukaStatus
from rig_simulation.control_port import ControlClient
from tools import launched

pytestmark = pytest.mark.ros

CONTROLLER = "kuka_real_time_node"
FULL_SPEED = np.radians([98, 98, 100, 130, 140, 180, 180])
"""Joint speeds of the 7 R800 [rad/s]."""

STILL = 1e-5
"""What a standing arm may move [rad]: the end of the motion before."""

TURN = np.radians(40.0)
TOOL = pose(rotation_about(2, -np.pi / 4.0 + TURN) @ np.diag([-1.0, 1.0, -1.0]), (0.45, -0.40, 0.32))
"""Where the tool waits for a hand."""


def axes_turned(R_from, R_to) -> np.ndarray:
    """Returns the size of the rotation vector between two attitudes, axis by axis [deg]."""
    return np.degrees(np.abs(pin.log3(R_from.T @ R_to)))


def when(rig, text) -> float:
    """Returns when a node first logged something with this text, since the rig was calm [s]."""
    return next(at for at, who, said in rig.said if who == "rosout" and text in said)


def highest_share_of_joint_speed(samples) -> float:
    return max(float(np.max(np.abs(sample.v) / FULL_SPEED)) for sample in samples)


@pytest.mark.hazard(1)
def test_control_is_off_until_it_is_switched_on(rig):
    goals = rig.arm.now.goals
    angles = np.array(rig.robot_hand.ask("state")["angles"])
    rig.hand.show(right=0.06, curl=0.9)
    rig.wait(lambda: len(rig.desired) > 100, "a stream of desired tool frames")
    assert rig.arm.way() < STILL and rig.arm.now.goals == goals and rig.mode == "home"
    np.testing.assert_allclose(rig.robot_hand.ask("state")["angles"], angles, atol=0.02)

    assert rig.gripper(True).success
    rig.wait(lambda: max(rig.robot_hand.ask("state")["angles"]) > 0.5, "the robot hand to close")
    assert rig.arm.way() < STILL, "the arm stands while only the gripper is on"
    assert rig.control(True).success
    rig.wait(lambda: "take the hand out of the box" in rig.status.reason, "the reason")
    assert rig.arm.way() < STILL, "a hand that was there before does not count"
    rig.hand.show(right=0.06, curl=0.9)
    rig.wait_for_mode("servo")
    rig.wait(lambda: rig.arm.way() > 0.05, "the arm to move")


@pytest.mark.hazard(21)
def test_a_hand_starts_only_inside_the_box_level_and_well_seen(rig):
    assert rig.control(True).success
    for at, reason in (
        ({"right": 0.15}, "the palm is 50 mm right of the box"),
        ({"up": -0.12}, "the palm is 20 mm below the box"),
        ({"back": 0.11}, "the palm is 10 mm in front of the box"),
        ({"pitch": 22.0}, "the pitch is 22.0 deg and must be within 20 deg"),
        ({"roll": -22.0}, "22.0 deg and must be within 20 deg"),
        ({"confidence": 0.02}, "the confidence is 0.02 and must be above 0.05"),
    ):
        rig.hand.show(**at)
        rig.wait(lambda reason=reason: any(reason in said for _, said in rig.stream), reason)
        rig.see(30)
        assert {state for state, _ in rig.stream} == {"waiting"} and not rig.desired
    assert rig.mode == "home" and rig.arm.way() < STILL

    rig.hand.show(right=0.09, pitch=18.0, roll=-18.0, confidence=0.1)
    rig.wait(lambda: rig.desired, "the stream of a hand just inside the box")
    rig.hand.glide(0.1, confidence=0.02)
    rig.wait(lambda: rig.stream_state == "waiting", "the end of the stream of a badly seen hand")


@pytest.mark.hazard(1)
def test_a_hand_that_is_found_in_the_box_starts_nothing_and_one_that_comes_in_does(rig):
    rig.hand.show()
    rig.wait(lambda: rig.stream_state == "running", "a first stream")
    rig.hand.hide()
    rig.wait(lambda: rig.stream_state == "waiting", "its end")
    rig.desired.clear()
    humans = rig.listen_to_hands()
    rig.hand.flash(60)
    rig.wait(lambda: rig.hand.still, "the end of the hand")
    assert len(humans) == 60
    assert not rig.desired and any("out of the box and back in" in said for _, said in rig.stream)
    rig.hand.show()
    rig.wait(lambda: rig.desired, "the desired tool frames of a hand that comes in")


@pytest.mark.hazard(6)
def test_outliers_make_no_step_and_each_angle_is_clipped_by_itself(rig):
    T_home = rig.arm.now.T_base_tool
    rig.follow(yaw=60.0)
    np.testing.assert_allclose(rig.desired[-1], T_home, atol=2e-3, err_msg="a hand that comes in turned starts level")
    np.testing.assert_allclose(rig.arm.now.T_base_tool, T_home, atol=2e-3)

    left_out = rig.count("leap_kuka", "samples_left_out")
    since, tool = rig.arm.now.time, rig.arm.now.T_base_tool[:3, 3]
    rig.desired.clear()
    for outlier in ({"right": 0.2}, {"up": -0.2}, {"back": 0.2}):
        rig.hand.glitch(**outlier)
        rig.see(15)
    rig.watch(1.1)  # /diagnostics come each second
    assert rig.count("leap_kuka", "samples_left_out") == left_out + 3
    desired = np.array(rig.desired)[:, :3, 3]
    assert np.max(np.linalg.norm(desired - desired[0], axis=1)) < 1e-4
    assert max(np.linalg.norm(s.T_base_tool[:3, 3] - tool) for s in rig.arm.since(since)) < 1e-4
    assert not any("at the limit" in reason for _, reason in rig.stream)

    assert rig.modes.count("servo") == 1 and rig.mode == "servo", rig.stream

    def glide_and_compare(expected, **angles):
        rig.hand.glide(1.0, **angles)
        rig.settle()
        np.testing.assert_allclose(axes_turned(T_home[:3, :3], rig.desired[-1][:3, :3]), expected, atol=0.1)
        np.testing.assert_allclose(axes_turned(T_home[:3, :3], rig.arm.now.T_base_tool[:3, :3]), expected, atol=0.1)

    glide_and_compare([0.0, 0.0, 15.0], yaw=45.0)
    glide_and_compare([0.0, 0.0, 25.0], yaw=10.0)
    rig.modes.clear()
    rig.hand.show()
    rig.wait_for_modes("servo")
    glide_and_compare([0.0, 25.0, 0.0], pitch=50.0)
    glide_and_compare([25.0, 0.0, 0.0], pitch=0.0, roll=50.0)
    assert "roll at the limit" in rig.stream[-1][1]


@pytest.fixture
def unlimited_controller(rig):
    """A controller that sends every target as it is, so that only the robot itself limits the speed of the tool."""

    def end_controller():
        rig.signal(CONTROLLER, signal.SIGINT)
        assert rig.exit_code(CONTROLLER) == 0

    end_controller()
    rig.set(shaping="none", servo_law="none", collision_guard=False)
    rig.calm()
    assert rig.call("kuka/scaling_factor", setScalingFactor, 1.5).success
    yield
    end_controller()
    rig.set(shaping="ruckig", servo_law="auto", collision_guard=True)


@pytest.mark.hazard(8)
def test_after_a_fast_tool_the_arm_stands_until_control_goes_off_and_on_and_follows_again(rig, unlimited_controller):
    """Row 8 of the campaign is the stop by an external torque."""
    rig.follow(right=-0.08)
    stops = rig.arm.now.stops
    # Without motion limits the arm closes the last two degrees to the hand as fast as it can.
    rig.hand.sway(0.55, right=0.12)
    rig.wait(lambda: rig.arm.now.safety_stop, "the safety stop")
    assert "m/s (limit 0.8)" in rig.arm.now.safety_stop
    rig.wait(lambda: rig.mode == "stopped", "the controller to notice")
    rig.wait(lambda: "safety stop" in rig.status.reason, "the reason")
    rig.wait(lambda: rig.arm.now.speed == 0.0, "the arm to stand")
    stands = rig.arm.now.time

    rig.hand.sway(2.0, right=0.08)
    rig.arm.ask("release")
    rig.watch(1.0)
    assert not rig.control(True).success, "off and on again is asked for"
    assert rig.control(False).success
    rig.watch(0.5)
    assert rig.arm.way(stands) < STILL and rig.mode == "stopped"

    released = rig.arm.now.time
    rig.modes.clear()
    assert rig.control(True).success
    rig.wait_for_modes("homing", "home")
    rig.hand.show(right=0.08)
    rig.wait_for_mode("servo")
    rig.hand.glide(1.0, right=0.0)
    rig.settle()
    np.testing.assert_allclose(rig.arm.now.T_base_tool[:3, 3], rig.commanded[-1][:3, 3], atol=2e-3)
    assert highest_share_of_joint_speed(rig.arm.since(released)) < 0.3
    assert rig.modes == ["homing", "home", "pick_up", "servo"]
    assert rig.arm.now.stops == stops + 1


@pytest.mark.hazard(5)
def test_a_lost_hand_sends_the_arm_home_and_another_one_is_picked_up_without_a_jump(rig):
    home = rig.arm.now.q
    rig.follow(right=-0.08)
    hidden = clock.monotonic()
    rig.hand.hide()
    rig.wait_for_modes("returning")
    assert when(rig, "was lost") - hidden == pytest.approx(0.22, abs=0.02)
    assert when(rig, "The arm brakes.") - hidden == pytest.approx(0.2, abs=0.02)
    assert when(rig, "leaves servo mode.") - hidden == pytest.approx(0.4, abs=0.03)
    rig.wait_for_modes("returning", "home")
    rig.wait_until_at(home)
    assert any(state == "waiting" and "was lost" in said for state, said in rig.stream)

    rig.modes.clear()
    since = rig.arm.now.time
    rig.hand.show(right=0.09, up=0.05)
    rig.wait_for_mode("servo")
    rig.settle()
    rig.hand.show(right=-0.09, up=-0.05)
    rig.wait(lambda: rig.modes.count("pick_up") == 2, "the next hand to be picked up")
    rig.wait_for_mode("servo")
    rig.settle()
    np.testing.assert_allclose(rig.arm.now.T_base_tool[:3, 3], rig.desired[-1][:3, 3], atol=2e-3)
    assert rig.modes == ["pick_up", "servo", "returning", "home", "pick_up", "servo"]
    assert highest_share_of_joint_speed(rig.arm.since(since)) == pytest.approx(0.25), "of the motions to pick up"


def is_at_the_pose(rig):
    T = rig.arm.now.T_base_tool
    turned = rotation_angle(T[:3, :3].T @ TOOL[:3, :3])
    return np.linalg.norm(T[:3, 3] - TOOL[:3, 3]) < 2e-3 and turned < np.radians(0.5)


def test_a_hand_takes_the_arm_over_where_it_waits(rig):
    assert "control of the arm is off" in rig.hold_tool(TOOL, 60.0).message
    assert rig.control(True).success
    rig.wait(lambda: rig.hold_tool(TOOL, 60.0).success, "the hold", 10.0)
    rig.wait(lambda: rig.mode == "servo" and is_at_the_pose(rig), "the arm at the pose", 15.0)
    assert rig.modes == ["pick_up", "servo"] and rig.stream_state == "waiting"

    start = rig.arm.now.time
    rig.hand.show(right=0.05, up=-0.03, back=0.02, yaw=25.0, pitch=10.0, roll=-8.0)
    rig.wait(lambda: rig.stream_state == "running", "the hand that takes over")
    rig.watch(1.5)
    samples = rig.arm.since(start)
    positions = np.array([s.T_base_tool[:3, 3] for s in samples])
    # The hand comes to rest while it takes over, slower than 0.3 m/s; the tool goes the rest of its way along.
    assert np.linalg.norm(positions - TOOL[:3, 3], axis=1).max() < 0.04
    assert max(s.tool_speed for s in samples) < 0.3
    rig.hand.glide(1.5, up=-0.08)
    rig.settle()
    assert rig.arm.now.T_base_tool[2, 3] == pytest.approx(TOOL[2, 3] - 0.05, abs=5e-3)
    assert rig.modes == ["pick_up", "servo"]

    rig.hand.hide()
    rig.wait_for_modes("returning", "home")
    assert rig.arm.now.safety_stop is None


def test_without_a_hand_the_arm_goes_home_again(rig):
    assert rig.control(True).success
    rig.wait(lambda: rig.hold_tool(TOOL, 8.0).success, "the hold", 10.0)
    held = clock.monotonic()
    rig.wait(lambda: rig.mode == "servo" and is_at_the_pose(rig), "the arm at the pose", 15.0)
    rig.wait_for_modes("returning")
    assert "the tool is no longer held: no hand took it over in time" in [why for _, why in rig.stream]
    ended = when(rig, "no hand took it over in time")
    assert ended - held == pytest.approx(8.0, abs=0.03)
    assert when(rig, "The arm brakes.") - ended == pytest.approx(0.2, abs=0.03)
    assert when(rig, "leaves servo mode.") - ended == pytest.approx(0.4, abs=0.03)
    rig.wait_for_modes("returning", "home")


@pytest.mark.hazard(19)
@pytest.mark.parametrize("hangs", [False, True], ids=["it answers", "it hangs"])
def test_the_emergency_stop_ends_the_controller_and_the_arm_stands(rig, hangs, monkeypatch):
    """The button of the control panel calls the service, and kills a controller that does not answer."""
    node = rig.pid(CONTROLLER)
    monkeypatch.setattr(emergency, "runs", rig.runs)
    monkeypatch.setattr(emergency, "kill", lambda node: rig.kill(node, signal.SIGKILL))
    rig.follow(right=-0.06)
    rig.hand.sway(1.0, right=0.06)
    rig.wait(lambda: rig.arm.now.tool_speed > 0.05, "the arm to move")
    if hangs:
        rig.suspend(CONTROLLER)
    at, pressed = rig.arm.now.time, clock.monotonic()
    client = ServiceClient(emergency.SERVICE, exitAppEmergency)
    ended, sentence = emergency.stop(client, node, socket.gethostname())
    assert ended and ("hung" in sentence) == hangs, sentence
    assert clock.monotonic() - pressed == pytest.approx(0.5 if hangs else 0.0, abs=0.1)
    assert rig.exit_code(CONTROLLER) == (-signal.SIGKILL if hangs else 2)
    rig.wait(lambda: rig.arm.now.speed == 0.0, "the arm to stand")
    stands = rig.arm.now.time
    rig.watch(1.0)
    assert rig.arm.way(stands) < STILL and rig.arm.way(at) < 0.02
    assert (rig.arm.now.mode, rig.arm.now.connected, rig.arm.now.safety_stop) == ("idle", False, None)


@pytest.mark.real
def test_a_controller_that_hangs_is_killed_by_its_number_and_the_arm_stands(
    ros, free_port, suspend, wait_until, monkeypatch
):
    monkeypatch.setattr(emergency, "KILL_S", 60.0)
    port, control_port = free_port(), free_port()
    ros.run("rig_simulation", "sunrise_controller.py", "--port", str(port), "--control-port", str(control_port))
    parameters = launched.parameters("kuka_control", "real_time_controller.launch", "ip:=127.0.0.1", f"port:={port}")
    for name, value in parameters.items():
        rospy.set_param(name, value)
    statuses = ros.record("kuka/status", KukaStatus)
    controller = ros.run("kuka_control", "real_time_controller.py")
    # A robot that pauses on its way home stops the arm: also then there is a controller to kill.
    wait_until(lambda: statuses and statuses[-1].mode in ("home", "stopped"), 60.0, "the arm to stand")
    process = emergency.find(statuses[-1].pid)
    suspend(process.pid)
    ended, sentence = emergency.stop(ServiceClient(emergency.SERVICE, exitAppEmergency), process, socket.gethostname())
    assert ended and "hung" in sentence, sentence
    assert controller.wait(15.0) == -signal.SIGKILL
    with ControlClient("127.0.0.1", control_port, 60.0) as arm:
        wait_until(lambda: not any(arm.ask("state")["velocities"]), 15.0, "the arm to stand")
