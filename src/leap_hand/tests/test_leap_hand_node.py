"""The node leap_hand_node in virtual time, with hands made by hand and a driver that only listens."""

import math
import signal
from pathlib import Path

import numpy as np
import pytest
import yaml

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from sensor_msgs.msg import TimeReference
from std_msgs.msg import Bool
from std_srvs.srv import Empty, EmptyResponse

from leap_motion.msg import Human
from reflex_msgs.msg import RadianServoCommands
from rig_msgs.msg import KukaStatus, PolicyActions, TeleopState
from rig_msgs.srv import ChooseOperator
from tools import launched

pytestmark = pytest.mark.ros

PACKAGE = Path(__file__).parents[1]
SETTLING_S = 2.0
LIMITS = yaml.safe_load((PACKAGE / "config" / "leap_hand.yaml").read_text())
FIST = np.radians([115.0, 115.0, 100.0, 0.0])


class Driver:
    """What the hand's driver offers, and the order in which its services were called.

    It publishes the state of a hand that stands at 1 rad, with what presses on a taxel of the index finger.
    """

    def __init__(self):
        from reflex_msgs.msg import Hand

        self.calls = []
        self.commands_at_calls = []
        self.commands = []
        self._services = [
            rospy.Service(f"reflex_takktile/{name}", Empty, self._answer(name))
            for name in ("calibrate_fingers", "calibrate_tactile")
        ]
        self.pressure = 0.0
        self._states = rospy.Publisher("reflex_takktile/hand_state", Hand, queue_size=10)
        self._stop = clock.Event()
        self._thread = clock.Thread(target=self._publish, daemon=True)
        self._thread.start()

    def fall_silent(self):
        self._stop.set()
        self._thread.join()

    def _publish(self):
        from reflex_msgs.msg import Hand

        while not self._stop.wait(0.025):
            hand = Hand()
            for motor in hand.motor:
                motor.joint_angle = 1.0
            hand.finger[0].pressure[3] = self.pressure
            self._states.publish(hand)

    def _answer(self, name):
        def answer(_):
            self.calls.append(name)
            self.called_at = clock.monotonic()
            self.commands_at_calls.append(len(self.commands))
            return EmptyResponse()

        return answer

    def end(self):
        self.fall_silent()
        self._states.unregister()
        for service in self._services:
            service.shutdown()


class Tracker:
    """Publishes Human messages at 50 Hz with the hand that was shown last."""

    def __init__(self):
        self._publisher = rospy.Publisher("leap_motion/leap_device", Human, queue_size=10)
        self._hand = None
        self._number = 0
        self.start()

    def start(self):
        self._stop = clock.Event()
        self._thread = clock.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def show(self, hand):
        self._hand = hand

    def stop(self):
        self._stop.set()
        self._thread.join()

    def end(self):
        self.stop()
        self._publisher.unregister()

    def _loop(self):
        while not self._stop.wait(0.02):
            self._number += 1
            human = Human(lmc_frame_id=self._number)
            human.header.stamp = rospy.Time.now()
            if self._hand is not None:
                human.right_hand = self._hand
            self._publisher.publish(human)


def make_hand(angle, fingers=5):
    """A right hand 7 whose fingers stand at `angle` [deg] from the palm normal, with index and middle side by side."""
    from leap_motion.msg import Bone, Finger, Hand

    a = math.radians(angle)
    hand = Hand(lmc_hand_id=7, is_present=True, confidence=1.0, normal=Vector3(0, -1, 0), direction=Vector3(0, 0, -1))
    hand.palm_center = Point(0.0, 0.35, 0.0)
    for kind in range(fingers):
        bones = [Bone(type=i) for i in range(4)]
        bones[2].center = [0.001 * kind, 0.35, -0.07]
        bones[3].bone_end.position = Point(0.0, 0.35 - 0.09 * math.cos(a), -0.09 * math.sin(a))
        hand.finger_list.append(Finger(type=kind, bone_list=bones))
    return hand


@pytest.fixture
def driver(ros):
    driver = Driver()
    driver.commands = ros.record("reflex_takktile/radian_hand_command", RadianServoCommands)
    yield driver
    driver.end()


@pytest.fixture
def tracker(ros):
    tracker = Tracker()
    yield tracker
    tracker.end()


def newest(driver):
    return np.array(driver.commands[-1].radian_commands) if driver.commands else np.full(4, np.nan)


def is_near(driver, command):
    return np.allclose(newest(driver), command, atol=1e-5)


def test_the_hand_calibrates_then_follows_and_opens(ros, driver, tracker):
    times = ros.record("rig/stage_times", TimeReference)
    diagnostics = ros.record("/diagnostics", DiagnosticArray)
    tracker.show(make_hand(20.0))
    process = ros.launch("leap_hand", "leap_hand_solo.launch")
    ros.wait_until(lambda: driver.commands, 5.0, "a command", poll=0.001)
    assert clock.monotonic() - driver.called_at >= SETTLING_S, "a command would fight the calibration"
    ros.wait_until(lambda: is_near(driver, FIST), 1.0, "the fist")
    assert "Force limit" not in process.log_path.read_text()
    assert driver.calls == ["calibrate_fingers", "calibrate_tactile"]
    assert driver.commands_at_calls == [0, 0]
    ros.wait_until(lambda: times, 5.0, "a stage time")
    assert times[-1].source == "leap_hand"

    tracker.show(make_hand(20.0, fingers=4))
    ros.wait_until(lambda: is_near(driver, np.zeros(4)), 10.0, "the open pose for four fingers")
    tracker.show(None)
    ros.wait_until(lambda: is_near(driver, np.zeros(4)), 10.0, "the open pose without a hand")
    ros.wait_until(lambda: diagnostics and "no hand" in diagnostics[-1].status[0].message, 10.0, "diagnostics")
    status = diagnostics[-1].status[0]
    assert status.name == "leap_hand" and int({v.key: v.value for v in status.values}["commands_sent"]) > 0


def test_a_finger_that_presses_stops_and_follows_again(ros, driver, tracker):
    def status():
        return {v.key: v.value for v in diagnostics[-1].status[0].values} if diagnostics else {}

    diagnostics = ros.record("/diagnostics", DiagnosticArray)
    rospy.set_param("leap_hand", LIMITS)
    tracker.show(make_hand(20.0))
    process = ros.run("leap_hand", "leap_hand_node.py")
    ros.wait_until(lambda: is_near(driver, FIST), 5.0, "the fist")
    driver.pressure = 90.0
    clock.sleep(0.1)
    assert is_near(driver, [1.0, *FIST[1:]]), "the index finger stops where it stands"
    clock.sleep(0.5)
    assert status()["limited"] == "index (taxel 3: 90 counts)"
    driver.pressure = 45.0
    clock.sleep(1.0)
    assert is_near(driver, [1.0, *FIST[1:]])
    driver.pressure = 0.0
    clock.sleep(0.1)
    assert is_near(driver, FIST)
    clock.sleep(0.6)
    assert (status()["limited"], status()["limit_trips"]) == ("", "1")
    assert b"The index is not closed further (taxel 3: 90 counts)." in process.log_path.read_bytes()


def test_a_pressing_finger_stops_without_a_new_tracking_frame(ros, driver, tracker):
    rospy.set_param("leap_hand", LIMITS)
    tracker.show(make_hand(20.0))
    ros.run("leap_hand", "leap_hand_node.py")
    ros.wait_until(lambda: is_near(driver, FIST), 5.0, "the fist")
    tracker.stop()
    clock.sleep(0.01)  # the last frame is there
    driver.pressure = 90.0
    clock.sleep(0.05)
    assert is_near(driver, [1.0, *FIST[1:]])


def test_a_silent_tracker_opens_the_hand_after_half_a_second(ros, driver, tracker):
    rospy.set_param("leap_hand", LIMITS)
    tracker.show(make_hand(20.0))
    process = ros.run("leap_hand", "leap_hand_node.py")
    ros.wait_until(lambda: is_near(driver, FIST), 5.0, "the fist")
    tracker.stop()
    stopped = clock.monotonic()
    ros.wait_until(lambda: is_near(driver, np.zeros(4)), 5.0, "the open pose", poll=0.001)
    assert clock.monotonic() - stopped + 0.02 >= 0.5 and clock.monotonic() - stopped <= 0.5 + 0.1 + 0.01
    assert "no tracking frames come in" in process.log_path.read_text()


SOURCES = ("limits", "overrides", "operator")
"""The files of leap_hand.launch; each stands above those before it."""


def test_a_hand_whose_state_never_comes_is_complained_of(ros, driver, tracker):
    rospy.set_param("leap_hand", LIMITS)
    driver.fall_silent()
    tracker.show(make_hand(20.0))
    process = ros.run("leap_hand", "leap_hand_node.py")
    words = "Force limit: no state of the robot hand came yet: no finger closes."
    ros.wait_until(lambda: words in process.log_path.read_text(), 40.0, "the complaint")
    ros.wait_until(lambda: len(driver.commands) > 20, 10.0, "commands")
    assert is_near(driver, np.zeros(4))


@pytest.mark.parametrize("simulated", SOURCES)
def test_a_real_robot_hand_refuses_a_simulated_mapping_whichever_file_says_so(ros, driver, tmp_path, simulated):
    files = {name: tmp_path / f"{name}.yaml" for name in SOURCES}
    for name, file in files.items():
        values = {**(LIMITS if name == "limits" else {}), "simulated": name == simulated}
        file.write_text(yaml.safe_dump(values))
    process = launch_with(ros, files)
    ros.wait_until(lambda: process.poll() is not None, 20.0, "the node's end")
    where = "operators/anna.yaml of operator:=" if simulated == "operator" else f"The hand's file of {simulated}:="
    assert f"{where} was measured with simulated devices" in process.log_path.read_text() and not driver.calls


def launch_with(ros, files):
    """Launches the node with the files; an operator's is loaded as the launch file does, whose check is a process."""
    loaded = {name: file for name, file in files.items() if name != "operator"}
    if "operator" not in files:
        return ros.launch("leap_hand", "leap_hand.launch", **loaded)
    ros.launch("leap_hand", "leap_hand.launch", node="false", **loaded)
    values = yaml.safe_load(files["operator"].read_text())
    rospy.set_param("leap_hand/files/operator", values)
    for name, value in values.items():
        rospy.set_param(f"leap_hand/{name}", value)
    return ros.run("leap_hand", "leap_hand_node.py", "_operator:=anna")


@pytest.mark.parametrize("said", [{}, {"simulated": False}])
def test_an_operators_file_that_does_not_say_how_it_was_measured_is_doubted(ros, driver, tmp_path, said):
    (tmp_path / "anna.yaml").write_text(yaml.safe_dump({"thumb_human": [77.5, 32.5], **said}))
    process = launch_with(ros, {"operator": tmp_path / "anna.yaml"})
    ros.wait_until(lambda: driver.calls, 5.0, "the calibration")
    log = process.log_path.read_text()
    assert ("operators/anna.yaml of operator:= does not say whether" in log) is not said
    assert log.count("does not say whether") == int(not said), "the shipped file is no measurement"


def test_nothing_of_an_earlier_launch_stays(ros, driver, tmp_path):
    (tmp_path / "a.yaml").write_text("simulated: true\n")
    rospy.set_param("leap_hand_node/operator", "maybe")
    rospy.set_param("leap_hand/files/operator", {"simulated": True})
    ros.launch("leap_hand", "leap_hand.launch", overrides=tmp_path / "a.yaml", node="false")
    process = ros.launch("leap_hand", "leap_hand.launch")
    ros.wait_until(lambda: driver.calls, 5.0, "the calibration")
    assert "The finger mapping is that of" not in process.log_path.read_text()


@pytest.mark.real  # the launch file runs the wizard
def test_the_launch_file_loads_the_stored_hand_of_an_operator(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    stored = tmp_path / ".config" / "leap_rig" / "operators" / "anna.yaml"
    stored.parent.mkdir(parents=True)
    stored.write_text("thumb_human: [77.5, 32.5]")
    params = launched.parameters("leap_hand", "leap_hand.launch", "operator:=anna")
    assert params["/leap_hand/thumb_human"] == [77.5, 32.5] and params["/leap_hand/simulated"] is False
    stored.write_text("simulated: true")
    assert launched.parameters("leap_hand", "leap_hand.launch", "operator:=anna")["/leap_hand/simulated"] is True
    assert params["/leap_hand/thumb_robot"] == LIMITS["thumb_robot"] and params["/leap_hand_node/operator"] == "anna"
    stored.write_text("simulated: false\nindex_human: [85, 40]\n")
    (tmp_path / "over.yaml").write_text("simulated: true\n")
    params = launched.parameters("leap_hand", "leap_hand.launch", "operator:=anna", f"overrides:={tmp_path}/over.yaml")
    assert [params[f"/leap_hand/files/{name}/simulated"] for name in SOURCES[1:]] == [True, False]
    assert params["/leap_hand/files/operator/index_human"] == [85, 40]


def test_the_wizard_stores_a_hand(ros, tracker, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    process = ros.run("leap_hand", "hand_wizard.py", "anna", "--timeout", "300")

    def hand_goes(angle, percent):
        tracker.show(make_hand(angle))
        ros.wait_until(lambda: f" {percent} %" in process.log_path.read_text(), 30.0, f"{percent} %")

    for angle, percent in ((80.0, 25), (30.0, 50), (80.0, 75)):
        hand_goes(angle, percent)
    tracker.show(make_hand(30.0))
    assert process.wait(20.0) == 0
    stored = yaml.safe_load((tmp_path / ".config" / "leap_rig" / "operators" / "anna.yaml").read_text())
    assert stored["thumb_human"] == pytest.approx([77.5, 32.5], abs=0.2)
    assert "simulated" not in stored, "no driver says whether the tracker is"
    unknown = ros.run("leap_hand", "hand_wizard.py", "--check", "bob")
    again = ros.run("leap_hand", "hand_wizard.py", "anna")
    folder = tmp_path / ".config" / "leap_rig" / "operators"
    assert unknown.wait(20.0) == 1 and again.wait(20.0) == 1
    sentence = f"There is no file {folder}/bob.yaml for operator:=bob; known: anna."
    assert sentence in unknown.log_path.read_text() and "--force replaces it" in again.log_path.read_text()
    status = rospy.Publisher("kuka/status", KukaStatus, queue_size=1, latch=True)
    status.publish(KukaStatus(control_on=True))
    moving = ros.run("leap_hand", "hand_wizard.py", "anna", "--force")
    assert moving.wait(20.0) == 1 and "The arm would follow the hand" in moving.log_path.read_text()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("simulated: maybe\n", "anna.yaml: simulated is 'maybe', but must be true or false"),
        ("thumb: [1, 2]\n", "anna.yaml: thumb is not a known key"),
        ("- 1\n", "is [1], but must be a mapping"),
        ("# nothing\n", "anna"),
    ],
)
def test_the_launch_files_check_refuses_a_file_that_roslaunch_or_the_node_could_not_use(
    ros, tmp_path, monkeypatch, content, words
):
    monkeypatch.setenv("HOME", str(tmp_path))
    stored = tmp_path / ".config" / "leap_rig" / "operators" / "anna.yaml"
    stored.parent.mkdir(parents=True)
    stored.write_text(content)
    program = ros.run("leap_hand", "hand_wizard.py", "--check", "anna")
    assert program.wait(20.0) == int(words != "anna")
    log = program.log_path.read_text()
    assert words in log and log.count("anna") == 1 and "Traceback" not in log


def test_another_operator_is_chosen_while_the_gripper_is_off(ros, driver, tracker, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    folder = tmp_path / ".config" / "leap_rig" / "operators"
    folder.mkdir(parents=True)
    (folder / "anna.yaml").write_text("thumb_human: [40.0, 20.0]\nsimulated: false")
    (folder / "far.yaml").write_text("simulated: true")
    (folder / "more.yaml").write_text("force_limit: false")
    ros.launch("leap_hand", "leap_hand.launch", hand_only="false")
    gripper = rospy.Publisher("kuka/gripper_control", Bool, queue_size=1, latch=True)
    gripper.publish(True)
    tracker.show(make_hand(30.0))
    fist = driver_at_rest(ros, driver)
    choose = rospy.ServiceProxy("leap_hand/choose_operator", ChooseOperator)
    assert "switch the control of the gripper off" in choose("anna").message
    gripper.publish(False)
    ros.wait_until(lambda: is_near(driver, np.zeros(4)), 5.0, "the open hand")
    for name in ("far", "more", "nobody", "../anna", "", "x" * 500, "\0"):
        assert choose(name).success is (name == ""), name
    assert choose("anna").success
    assert rospy.get_param("leap_hand/thumb_human") == [40.0, 20.0]
    assert rospy.get_param("leap_hand_node/operator") == "anna"
    clock.sleep(1.0)
    assert is_near(driver, np.zeros(4)), "the choice moves nothing"
    gripper.publish(True)
    assert driver_at_rest(ros, driver)[2] < fist[2] - 0.1, "the thumb is mapped from anna's"
    gripper.publish(False)
    ros.wait_until(lambda: is_near(driver, np.zeros(4)), 5.0, "the open hand")
    assert choose("").success
    assert rospy.get_param("leap_hand/thumb_human") == LIMITS["thumb_human"]
    assert rospy.get_param("leap_hand/simulated") is False
    gripper.publish(True)
    assert np.allclose(driver_at_rest(ros, driver), fist)


def driver_at_rest(ros, driver):
    """Returns the command that the hand gets after its fingers have moved."""
    ros.wait_until(lambda: driver.commands and not is_near(driver, np.zeros(4)), 9.0, "the fingers")
    clock.sleep(0.5)
    return np.array(newest(driver))


@pytest.mark.parametrize(
    "limits, private, words",
    [
        ({}, {"hand": "both"}, "~hand is 'both'"),
        ({"simulated": True}, {"operator": "anna"}, "operators/anna.yaml of operator:= was measured with simulated"),
    ],
)
def test_bad_parameters_end_the_node_with_a_sentence(ros, driver, limits, private, words):
    rospy.set_param("leap_hand", {**LIMITS, **limits})
    for name, value in private.items():
        rospy.set_param(f"leap_hand_node/{name}", value)
    process = ros.run("leap_hand", "leap_hand_node.py")
    ros.wait_until(lambda: process.poll() is not None, 20.0, "the node's end")
    log = process.log_path.read_text()
    assert process.returncode == 1 and words in log and "Traceback" not in log
    assert not driver.calls and not driver.commands


def test_with_the_simulated_robot_hand_a_simulated_operators_mapping_counts(ros, driver, tracker):
    rospy.set_param("leap_hand", {**LIMITS, "simulated": True})
    rospy.set_param("reflex_takktile_driver/network_interface", "lo")
    tracker.show(make_hand(20.0))
    ros.run("leap_hand", "leap_hand_node.py")
    ros.wait_until(lambda: is_near(driver, FIST), 5.0, "the fist")


def test_without_the_hands_driver_the_node_ends_with_a_sentence(ros):
    rospy.set_param("leap_hand", LIMITS)
    process = ros.run("leap_hand", "leap_hand_node.py", "_service_timeout:=0.5")
    ros.wait_until(lambda: process.poll() is not None, 20.0, "the node's end")
    log = process.log_path.read_text()
    assert process.returncode == 1 and "Traceback" not in log
    assert "reflex_takktile/calibrate_fingers is not there after 0.5 s" in log


def test_a_node_that_is_interrupted_while_the_hand_calibrates_ends_at_once(ros, driver):
    rospy.set_param("leap_hand", LIMITS)
    process = ros.run("leap_hand", "leap_hand_node.py")
    ros.wait_until(lambda: len(driver.calls) == 2, 20.0, "the calibrations")
    process.send_signal(signal.SIGINT)
    assert process.wait(1.0) == 0


def test_a_policy_moves_the_fingers_while_it_steers_the_arm(ros, driver, tracker):
    rospy.Publisher("kuka/gripper_control", Bool, queue_size=1, latch=True).publish(True)
    state = rospy.Publisher("leap_kuka/state", TeleopState, queue_size=1)
    actions = rospy.Publisher("leap_kuka/policy_actions", PolicyActions, queue_size=1)
    ros.launch("leap_hand", "leap_hand.launch")
    ros.wait_until(lambda: driver.calls, 5.0, "the node")
    clock.sleep(SETTLING_S + 0.5)
    command = [0.5, 0.6, 0.7, 0.2]

    def act(hold):
        for _ in range(5):
            state.publish(TeleopState(state="holding", hold=hold, keep_grip=True))
            message = PolicyActions(period=0.2, tool=[Pose(orientation=Quaternion(w=1.0))], fingers=command)
            message.header.stamp, message.header.frame_id = rospy.Time.now(), "kuka/base_frame"
            actions.publish(message)
            clock.sleep(0.1)
        return [sent for sent in driver.commands if np.allclose(sent.radian_commands, command, atol=1e-5)]

    assert not act("kept")
    assert act("led") and is_near(driver, command)
