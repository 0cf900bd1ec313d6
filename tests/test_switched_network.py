"""The two ways to connect arm and hand: the handbook's addresses, the product's defaults, both devices on the wire."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from conftest import ROOT, with_sources

PAGE = (ROOT / "docs" / "handbook" / "hardware.md").read_text()
CONNECTIONS = [
    dict(re.findall(r"(ifname|ipv4\.addresses|ipv4\.never-default|ipv4\.may-fail) (\S+)", line))
    for line in re.findall(r"^nmcli con add .*$", PAGE, re.MULTILINE)
]
ONE_PORT, *TWO_PORTS = ({c["ifname"]: c["ipv4.addresses"].split(",")} for c in CONNECTIONS)
HAND = next(port for connection in TWO_PORTS for port, given in connection.items() if given[0].startswith("10."))
LAUNCH = [*ROOT.glob("src/*/launch/*.launch"), *ROOT.glob("src/modules/*/launch/*.launch")]


def test_the_page_gives_one_port_both_addresses_and_two_ports_one_each():
    assert ONE_PORT == {"eth0": ["10.1.1.10/7", "172.31.1.55/16"]}
    assert TWO_PORTS == [{"eth0": ["10.1.1.10/7"]}, {"eth1": ["172.31.1.55/16"]}]
    assert {c["ipv4.never-default"] for c in CONNECTIONS} == {"yes"}, "internet traffic stays off these ports"


def test_the_default_interface_of_the_hand_is_that_of_both_ways():
    shape = re.compile(r'name="(?:hand_interface|eth)" default="(?:\$\(eval \'lo\' if arg\(\'sim\'\) else \')?(\w+)')
    defaults = {path.name: found[1] for path in LAUNCH for found in shape.finditer(path.read_text())}
    assert {"demo.launch", "leap_rig.launch", "leap_rig_ptp_debug.launch", "reflex_takktile.launch"} <= defaults.keys()
    assert set(defaults.values()) == {HAND} == {*ONE_PORT}


@pytest.mark.real
def test_the_clients_reach_both_devices_in_both_ways():
    own_network = ["unshare", "--net", "--mount", "--map-root-user"]
    try_out = "mount -t tmpfs tmpfs /run && ip netns add other && ip link add one type veth peer name two netns other"
    allowed = shutil.which("ip") and shutil.which("unshare") and not subprocess.run(
        [*own_network, "sh", "-c", f"{try_out} && ip link add plain type bridge && ip netns exec other true"],
        capture_output=True,
    ).returncode  # fmt: skip
    if not allowed:
        pytest.skip("this machine lets nobody make networks joined by wires and a switch (unshare, ip)")
    two_ports = {port: given for connection in TWO_PORTS for port, given in connection.items()}
    ways = [ONE_PORT, {port: given[::-1] for port, given in ONE_PORT.items()}, two_ports]
    narrow = {port: [given.replace("10.1.1.10/7", "10.1.1.10/24") for given in all_] for port, all_ in ONE_PORT.items()}
    robot = yaml.safe_load((ROOT / "src/kuka_control/config/kuka_params_rt.yaml").read_text())["ip"]
    done = subprocess.run(
        [*own_network, sys.executable, Path(__file__).with_name("switched_network.py")],
        input=json.dumps({"ways": [*ways, {**narrow, "patience": 3.0}], "robot": robot, "interface": HAND}),
        env=with_sources({}), stdout=subprocess.PIPE, text=True, timeout=600.0,
    )  # fmt: skip
    assert done.returncode == 0
    *reached, unheard = json.loads(done.stdout)
    for result in reached:
        assert len(result["joints"]) == 7 and result["joints_beside_the_hand"] == result["joints"], result
        assert result["calibrated"] is True and result["dropped"] == 0, result
    assert unheard["dropped"] > 0 and "silent" in unheard, "so the wide netmask is needed, as the page says"
