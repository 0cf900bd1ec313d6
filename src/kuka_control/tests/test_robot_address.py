"""The robot of a program, out of a controller's parameters and what was given beside them."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from common.errors import ConfigError
from common.poses import pose, translation
from common.rotations import rotation_about
from kuka_control.model.config import OPTIONS, robot_address

CONFIG = Path(__file__).parents[1] / "config"


def values(name="kuka_params_rt.yaml"):
    return yaml.safe_load((CONFIG / name).read_text())


@pytest.mark.parametrize("name", ["kuka_params_rt.yaml", "kuka_params_ptp.yaml"])
def test_the_parameters_of_either_controller_do(name):
    address = robot_address({**values(name), "ws_center": [0.4, 0.4, 0.4], "joints_home": [0.0] * 7}, {})
    assert (address.ip, address.port, address.robot) == ("172.31.1.147", 30001, "LBR7R800")


def test_what_is_given_stands_above_the_parameters():
    given = {**dict.fromkeys(OPTIONS), "ip": "127.0.0.1", "port": 4711, "tool_length": 0.0}
    address = robot_address(values(), given)
    assert (address.robot, address.flange, address.ip) == ("LBR7R800", "MF_elektrisch", "127.0.0.1")
    assert (address.port, address.tool_length) == (4711, 0.0)


def test_the_tool_is_the_controllers():
    T = pose(rotation_about(1, 0.4), (0.1, 0.0, 0.5))
    turned = {**values(), "use_tool_transform": True, "tool_transform": T.ravel().tolist()}
    np.testing.assert_array_equal(robot_address(turned, {}).T_flange_tool, T)
    np.testing.assert_array_equal(robot_address(values(), {}).T_flange_tool, translation(0.0, 0.0, 0.106))
    given = robot_address(turned, {"tool_length": 0.2})
    np.testing.assert_array_equal(given.T_flange_tool, translation(0.0, 0.0, 0.2))


def test_all_faults_are_said_with_their_keys():
    with pytest.raises(ConfigError) as caught:
        robot_address({**values(), "robot": "UR5", "colour": 1}, {"port": 0, "tool_length": -1.0}, "kuka/")
    assert [fault.split()[0] for fault in caught.value.faults] == [
        "kuka/colour",
        "kuka/tool_length",
        "kuka/robot",
        "kuka/port",
    ]
    with pytest.raises(ConfigError, match="must be a mapping"):
        robot_address(None, {})


@pytest.mark.parametrize(
    ("ip", "here"),
    [("127.0.0.1", True), ("127.1.2.3", True), ("::1", True), ("localhost", True), ("172.31.1.147", False),
     ("0.0.0.0", False), ("robot", False), ("127.0.0.1.example.org", False)],
)  # fmt: skip
def test_only_loopback_addresses_are_on_this_machine(ip, here):
    assert robot_address({**values(), "ip": ip}, {}).on_this_machine is here
