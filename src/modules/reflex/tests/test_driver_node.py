"""The node with the simulated hand; and how it ends."""

from __future__ import annotations

from pathlib import Path

import pytest

pytestmark = pytest.mark.ros

PREFIX = "/reflex_takktile/"


LAUNCH = """<launch>
  <include file="$(find reflex)/launch/reflex_takktile.launch">
    <arg name="eth" value="lo"/>
    <arg name="port" value="{port}"/>
    <arg name="calibration_folder" value="{folder}"/>
  </include>
  <param name="reflex_takktile_driver/silence_time" value="3.0"/>
  <param name="reflex_takktile_driver/calibration_max_time" value="30.0"/>
</launch>
"""
"""A hand or a driver that gets no processor for a second is no silent hand."""


@pytest.fixture
def launch_driver(ros, processes, tmp_path):
    """A function that launches the driver."""

    def launch(port, folder):
        file = tmp_path / "patient.launch"
        file.write_text(LAUNCH.format(port=port, folder=folder))
        return processes.start("roslaunch", "--wait", str(file), env={"LEAP_RIG_NICENESS": "0"})

    return launch


@pytest.fixture
def driver(launch_driver, simulated_hand, tmp_path):
    """Launches hand and driver: (launch process, control client, folder of the calibration)."""
    _, port, control = simulated_hand()
    folder = tmp_path / "calibration"
    return launch_driver(port, folder), control, folder


def call(name, service_type, *args):
    import rospy

    rospy.wait_for_service(PREFIX + name, 20.0)
    return rospy.ServiceProxy(PREFIX + name, service_type)(*args)


def status(ros):
    from diagnostic_msgs.msg import DiagnosticArray

    return ros.record("/diagnostics", DiagnosticArray)


def newest(recording):
    found = [s for array in recording for s in array.status if s.name == "reflex"]
    return found[-1] if found else None


def value(recording, key):
    found = newest(recording)
    return {v.key: v.value for v in found.values}[key] if found else None


def commander(wait_until):
    import rospy

    from reflex_msgs.msg import RadianServoCommands

    publisher = rospy.Publisher(PREFIX + "radian_hand_command", RadianServoCommands, queue_size=1)
    wait_until(lambda: publisher.get_num_connections(), 20.0, "the driver's subscription")
    return publisher


def test_state_commands_services_and_exit(ros, driver, wait_until, processes):
    import rospy
    from sensor_msgs.msg import JointState
    from std_srvs.srv import Empty

    from reflex_msgs.msg import FingerPressure, Hand, RawServoCommands
    from reflex_msgs.srv import SetSpeed, SetTactileThreshold

    launch, control, folder = driver
    states = ros.record(PREFIX + "hand_state", Hand)
    joints = ros.record("joint_states", JointState)
    diagnostics = status(ros)
    states.wait(10, 30.0)
    assert [m.error_state for m in states[-1].motor] == ["0x00"] * 4
    assert joints.wait()[-1].name[:3] == ["reflex/preshape_1", "reflex/preshape_2", "reflex/proximal_joint_1"]

    call("calibrate_fingers", Empty)
    call("calibrate_tactile", Empty)
    wait_until(lambda: value(diagnostics, "calibration") == "succeeded", 15.0, "the calibration")
    wait_until(lambda: len(list(folder.glob("*.yaml"))) == 2, 10.0, "the calibration's files")
    wait_until(lambda: max(abs(p) for f in states[-1].finger for p in f.pressure) < 5, 10.0, "zeroed sensors")

    publisher = commander(wait_until)
    publisher.publish([2.0, 2.0, 1.8, 0.3])
    for motor, angle in enumerate((2.0, 2.0, 1.8)):
        wait_until(lambda m=motor, a=angle: abs(states[-1].motor[m].joint_angle - a) < 0.02, 10.0, "the closed hand")
    wait_until(lambda: abs(joints[-1].position[0] - 0.3) < 0.02, 10.0, "the spread hand")
    publisher.publish([float("nan"), 0.0, 0.0, 0.0])
    wait_until(lambda: value(diagnostics, "refused") == "1", 10.0, "the refusal")
    assert abs(states[-1].motor[1].joint_angle - 2.0) < 0.02

    call("set_speed", SetSpeed, [1.0, 1.0, 1.0, 1.0])
    wait_until(lambda: control.ask("state")["speed_settings"] == [118, 1142, 118, 1149], 5.0, "the speed")
    with pytest.raises(rospy.ServiceException, match="refused"):
        call("set_speed", SetSpeed, [float("inf"), 1.0, 1.0, 1.0])

    call("set_tactile_threshold", SetTactileThreshold, [FingerPressure([5] * 9)] * 3)
    control.ask("press", finger=1, cell=2, value=15)
    wait_until(lambda: states[-1].finger[1].contact[2], 5.0, "the touch")

    raw = rospy.Publisher(PREFIX + "raw_hand_command", RawServoCommands, queue_size=1)
    wait_until(lambda: raw.get_num_connections(), 20.0, "the driver's subscription")
    goals = [position + 1 for position in control.ask("state")["positions"]]
    raw.publish(goals)
    wait_until(lambda: control.ask("state")["goals"] == goals, 5.0, "the raw command")

    call("zero_pose", Empty)
    wait_until(lambda: abs(states[-1].motor[0].joint_angle) < 0.02, 10.0, "the new zero")
    call("disable_torque", Empty)
    wait_until(lambda: control.ask("state")["torque"] == [False] * 4, 5.0, "no torque")
    with pytest.raises(rospy.ServiceException, match="Torque is off"):
        call("calibrate_fingers", Empty)
    call("set_speed", SetSpeed, [3.0, 3.0, 3.0, 2.0])
    assert value(diagnostics, "lost") is not None

    assert processes.end(launch) == 0
    wait_until(lambda: control.ask("state")["mode"] == [0] * 4, 5.0, "the idle hand")
    assert "Traceback" not in launch.log_path.read_text()


def test_a_silent_hand_is_said_once_and_comes_back(ros, driver, wait_until):
    from reflex_msgs.msg import Hand

    launch, control, _ = driver
    states = ros.record(PREFIX + "hand_state", Hand)
    diagnostics = status(ros)
    states.wait(5, 30.0)
    control.ask("set_silent", on=True)
    wait_until(lambda: newest(diagnostics) and newest(diagnostics).message == "The hand is silent.", 10.0, "it")
    assert newest(diagnostics).level == 2
    count = len(states)
    wait_until(lambda: len(diagnostics) > 0 and launch.log_path.read_text().count("The hand is silent") == 1, 5.0, "it")
    assert len(states) <= count + 1
    modes = control.ask("state")["modes_received"]
    control.ask("set_silent", on=False)
    wait_until(lambda: newest(diagnostics).level == 0, 10.0, "the hand's return")
    states.wait(count + 5)
    wait_until(lambda: control.ask("state")["modes_received"] > modes, 5.0, "position mode")


def test_a_failed_calibration_is_a_sentence(ros, driver, wait_until):
    from std_srvs.srv import Empty

    from reflex_msgs.msg import Hand

    launch, control, folder = driver
    ros.record(PREFIX + "hand_state", Hand).wait(5, 30.0)
    diagnostics = status(ros)
    control.ask("stick_encoder", finger=0, on=True)
    call("calibrate_fingers", Empty)
    wait_until(lambda: (value(diagnostics, "calibration") or "").startswith("failed: Finger f1"), 20.0, "the failure")
    assert newest(diagnostics).level == 1
    assert not folder.exists()


def test_a_calibration_that_cannot_be_written_still_holds(ros, launch_driver, simulated_hand, tmp_path, wait_until):
    from std_srvs.srv import Empty

    from reflex_msgs.msg import Hand

    _, port, _ = simulated_hand()
    (tmp_path / "file").write_text("no folder")
    launch = launch_driver(port, tmp_path / "file" / "deeper")
    states = ros.record(PREFIX + "hand_state", Hand).wait(5, 30.0)
    call("calibrate_fingers", Empty)
    wait_until(lambda: "Cannot write" in launch.log_path.read_text(), 15.0, "the sentence")
    commander(wait_until).publish([1.0, 1.0, 1.0, 0.0])
    wait_until(lambda: abs(states[-1].motor[0].joint_angle - 1.0) < 0.02, 10.0, "the command")


@pytest.fixture
def end_of(ros, tmp_path, free_port):
    """Loads the shipped parameters; the function sets and removes some, and lets the driver run to its end."""
    import socket

    import rospy
    import yaml

    values = yaml.safe_load((Path(__file__).parents[1] / "config" / "reflex_takktile.yaml").read_text())
    values.update(network_interface="lo", port=free_port(socket.SOCK_DGRAM), calibration_folder=str(tmp_path))

    def end(**changes) -> tuple[int, str]:
        merged = {k: v for k, v in {**values, **changes}.items() if v is not None}
        rospy.set_param("/reflex_takktile_driver", merged)
        driver = ros.run("reflex", "reflex_takktile_driver.py")
        return driver.wait(20.0), driver.log_path.read_text()

    return end


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"network_interface": "eth77"}, "The network interface 'eth77' does not exist; interfaces with an IPv4"),
        ({"port": "many"}, "reflex_takktile_driver/port is 'many', but must be a whole number in [1, 65535]."),
        ({"loosen_angle": -0.1}, "reflex_takktile_driver/loosen_angle is -0.1, but must be a finite number in (0"),
        ({"travel": [4.0, 3.6, 3.6, 1.75]}, "travel of f1 is 4 rad; the hand has 3.6 rad at most."),
        ({"hot": None}, "reflex_takktile_driver/hot is missing"),
        ({"colour": "blue"}, "reflex_takktile_driver/colour is not a known key"),
    ],
)
def test_ends_with_a_sentence(end_of, changes, sentence):
    code, output = end_of(**changes)
    assert code == 1
    assert sentence in output
    assert "Traceback" not in output


def test_a_torn_calibration_file_ends_it_with_its_name(end_of, tmp_path):
    (tmp_path / "finger_calibrate.yaml").write_text("encoder_zero_reference: [1, 2")
    code, output = end_of()
    assert code == 1
    assert f"{tmp_path}/finger_calibrate.yaml is not yaml" in output
    assert "Traceback" not in output
