"""What the launch files of the rig start and hand over, without starting it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

pytestmark = pytest.mark.ros


def parameters(*arguments: str) -> dict:
    """Returns the parameters that the demo would set."""
    from tools import launched

    return launched.parameters("leap_rig", "demo.launch", *arguments)


def nodes(*arguments: str) -> set[str]:
    """Returns the names of the nodes that the demo would start."""
    from tools import launched

    return launched.nodes("leap_rig", "demo.launch", *arguments)


ROOT = Path(__file__).resolve().parents[3]
LAUNCH_FILES = ROOT.glob("src/**/launch/*.launch")
SIMULATED = {path for path in LAUNCH_FILES if '<arg name="sim" default="true"' in path.read_text()}
PANEL = "/kuka_panel"


@pytest.mark.parametrize("file", sorted(SIMULATED), ids=lambda path: f"{path.parents[1].name}-{path.stem}")
def test_what_simulates_by_default_says_so_before_anything_else_does(file):
    from tools import launched

    first, *others = launched.prefixes(file.parents[1].name, file.name)
    assert "/simulated.sh " in first
    real = launched.prefixes(file.parents[1].name, file.name, "sim:=false")
    assert real and not any("simulated.sh" in prefix for prefix in real)


def test_the_files_that_simulate_by_default_are_known():
    assert {"demo", "leap_rig", "leap_rig_ptp_debug", "camera", "grasping", "camera_apriltag", "camera_oculus"} <= {
        path.stem for path in SIMULATED
    }


@pytest.mark.parametrize("asked", [False, True])
@pytest.mark.parametrize(
    ("package", "file", "node"),
    [
        ("leap_rig", "demo.launch", "kuka_real_time_node"),
        ("kuka_control", "real_time_controller.launch", "kuka_real_time_node"),
        ("kuka_control", "ptp_controller.launch", "kuka_ptp_node"),
    ],
)
def test_the_workspace_is_lifted_only_where_it_is_asked_for_and_never_on_a_real_robot(package, file, node, asked):
    from tools import launched

    words = launched.command_line(package, file, node, *(["lift_workspace:=true"] if asked else []))
    assert ("--lift-workspace" in words) is asked and "--i-know" not in words


@pytest.mark.parametrize(("what", "said"), [("rig", ("sim:=false", "robot_ip")), ("camera", ("sim:=false", "Xtion"))])
def test_the_first_line_says_what_to_pass_and_the_program_gets_its_arguments(what, said):
    script = ROOT / "src/common/shell/simulated.sh"
    lines = subprocess.run(
        [script, what, "printf", "%s|", "a b", "c"], check=True, capture_output=True, text=True, timeout=30
    ).stdout.splitlines()
    assert len(lines) == 2 and "simulated" in lines[0] and all(word in lines[0] for word in said)
    assert lines[1] == "a b|c|"


@pytest.mark.parametrize(
    ("package", "file"),
    [
        *(("kuka_control", f"{mode}_controller.launch") for mode in ("real_time", "ptp")),
        *(("leap_rig", f"{name}.launch") for name in ("demo", "leap_rig", "leap_rig_ptp_debug")),
    ],
)
def test_the_control_panel_comes_with_each_controller_once(package, file):
    from tools import launched

    assert PANEL in launched.nodes(package, file)
    assert PANEL not in launched.nodes(package, file, "gui:=false")


CAMERA = {f"/camera/{name}" for name in ("driver", "frames", "watchdog", "register_rgbd")} | {"/camera_truth"}
NETWORK = {"/ggcnn", "/grasp_execution"}
VIEW = {"/operator_view"}


@pytest.mark.parametrize(
    ("arguments", "there", "missing"),
    [
        (["rviz:=true"], CAMERA | VIEW, NETWORK),
        (["rviz:=false"], set(), CAMERA | NETWORK | VIEW),
        (["rviz:=true", "camera:=false"], set(), CAMERA | NETWORK),
        (["rviz:=true", "world:=false"], set(), CAMERA | NETWORK),
        (["rviz:=false", "camera:=true"], CAMERA, NETWORK),
        (["rviz:=false", "scenario:=assisted_grasp"], CAMERA | NETWORK, set()),
        (["rviz:=true", "sim:=false"], set(), CAMERA | NETWORK),
        (["rviz:=false", "tracker:=headset"], CAMERA | VIEW | {"/stereo_web", "/operator"}, NETWORK | {"/leapd"}),
        (["rviz:=false", "tracker:=headset", "sim:=false"], VIEW | {"/stereo_web"}, CAMERA | {"/leapd"}),
        (["rviz:=false", "recording:=a.jsonl"], {"/leapd"}, {"/stereo_web"}),
        (["rviz:=false", "sim:=false", "grasping:=true"], (CAMERA - {"/camera_truth"}) | NETWORK, {"/camera_truth"}),
    ],
)
def test_who_looks_at_the_rig_gets_the_camera_and_its_cloud(arguments, there, missing):
    started = nodes("gui:=false", *arguments)
    assert there <= started
    assert not missing & started


def test_the_camera_of_the_demo_takes_few_pictures_of_its_own_world():
    values = parameters("rviz:=true", "world_port:=5000", "camera_rate:=2.5")
    assert (values["/camera/driver/rate"], values["/camera/driver/port"]) == (2.5, 5000)
    assert values["/camera_truth/port"] == 5000
    assert parameters("rviz:=true")["/camera/driver/rate"] == 3.0
    values = parameters("grasping:=true")
    assert values["/camera/driver/rate"] == 6.0
    assert 1.0 / values["/camera/driver/rate"] < values["/camera/watchdog/silence"]


def test_faults_are_asked_of_the_ports_that_the_devices_listen_on():
    ports = ("robot_control_port", "leap_control_port", "hand_control_port", "camera_control_port")
    values = parameters("grasping:=true", *(f"{name}:={5000 + i}" for i, name in enumerate(ports)))
    asked = [values[f"/simulation/{device}_port"] for device in ("arm", "leap", "hand", "camera")]
    assert asked == [5000, 5001, 5002, 5003]
    assert values["/camera/driver/control_port"] == 5003


def test_the_page_serves_the_hands_where_the_driver_looks_for_them():
    values = parameters("tracker:=headset", "rviz:=false", "leap_port:=7000", "web_host:=0.0.0.0")
    assert values["/stereo_web/web/hands"] is True and values["/stereo_web/web/host"] == "0.0.0.0"
    assert values["/stereo_web/web/leap_port"] == values["/leap_driver/port"] == 7000
    assert values["/operator/leapd_port"] == values["/simulation/leap_port"] == 0
    assert parameters("tracker:=headset", "rviz:=false")["/stereo_web/web/host"] == "127.0.0.1"


def test_faults_of_the_camera_reach_it_from_the_command_line():
    values = parameters("grasping:=true", "camera_fault:=slow garbled:5:0.2")
    assert values["/camera/driver/fault"] == "slow garbled:5:0.2"
    values = parameters("grasping:=true")
    assert values["/camera/driver/fault"] == ""
    assert values["/camera/driver/control_port"] == values["/simulation/camera_port"]


def test_the_nodes_of_a_frame_run_in_one_process_with_their_parameters():
    apart = {"/leap_driver", "/leap_kuka_node", "/leap_hand_node"}
    assert apart <= nodes() and "/leap_teleop" not in nodes()
    one = ("one_process:=true", "leap_port:=5001")
    started, values = nodes(*one), parameters(*one)
    assert "/leap_teleop" in started and not apart & started
    assert values["/leap_teleop/driver/port"] == 5001 and values["/leap_teleop/hand/hand_only"] is False
    there = {name for name in parameters() if name.startswith(("/leap/", "/leap_hand/"))}
    assert there <= set(values)


def test_a_webcam_takes_the_place_of_the_simulated_leap_with_limits_of_its_own():
    from tools import launched

    values = parameters("tracker:=webcam")
    assert values["/leap/min_confidence"] > parameters()["/leap/min_confidence"]
    assert parameters("tracker:=webcam", "sim:=false")["/leap/min_confidence"] < values["/leap/min_confidence"]
    assert values["/operator/leapd_port"] == 0 and "/leapd" in nodes("tracker:=webcam")
    of_a_camera = ("leapd", "tracker:=webcam", "camera_device:=/dev/video2", "gui:=false")
    line = " ".join(launched.command_line("leap_rig", "demo.launch", *of_a_camera))
    assert "--headless" in line and "--camera /dev/video2" in line
    of_a_film = ("tracker:=webcam", "video:=/a b.mp4", "leap_args:=--setup above", "leap_port:=7")
    command = ["roslaunch", "--args", "/leapd", "leap_rig", "demo.launch", *of_a_film]
    line = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout
    assert "webcam_leapd.py" in line
    assert all(part in line for part in ("--video /a b.mp4", "--setup above", "--port 7"))
