"""What the launch files of the rig start and hand over, without starting it."""

from __future__ import annotations

import subprocess

import pytest
import yaml

pytestmark = pytest.mark.ros


def parameters(*arguments: str) -> dict:
    """Returns the parameters that the demo would set."""
    command = ["roslaunch", "--dump-params", "leap_rig", "demo.launch", *arguments]
    return yaml.safe_load(subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout)


def nodes(*arguments: str) -> set[str]:
    """Returns the names of the nodes that the demo would start."""
    command = ["roslaunch", "--nodes", "leap_rig", "demo.launch", *arguments]
    return set(subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout.split())


CAMERA = {f"/camera/{name}" for name in ("driver", "frames", "watchdog", "register_rgbd")} | {"/camera_truth"}
NETWORK = {"/ggcnn", "/grasp_execution"}


@pytest.mark.parametrize(
    ("arguments", "there", "missing"),
    [
        (["rviz:=true"], CAMERA, NETWORK),
        (["rviz:=false"], set(), CAMERA | NETWORK),
        (["rviz:=true", "camera:=false"], set(), CAMERA | NETWORK),
        (["rviz:=true", "world:=false"], set(), CAMERA | NETWORK),
        (["rviz:=false", "camera:=true"], CAMERA, NETWORK),
        (["rviz:=false", "scenario:=assisted_grasp"], CAMERA | NETWORK, set()),
        (["rviz:=true", "sim:=false"], set(), CAMERA | NETWORK),
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
    asked = [values[f"/simulation_faults/{device}_port"] for device in ("arm", "leap", "hand", "camera")]
    assert asked == [5000, 5001, 5002, 5003]
    assert values["/camera/driver/control_port"] == 5003


def test_faults_of_the_camera_reach_it_from_the_command_line():
    values = parameters("grasping:=true", "camera_fault:=slow garbled:5:0.2")
    assert values["/camera/driver/fault"] == "slow garbled:5:0.2"
    values = parameters("grasping:=true")
    assert values["/camera/driver/fault"] == ""
    assert values["/camera/driver/control_port"] == values["/simulation_faults/camera_port"]
