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
