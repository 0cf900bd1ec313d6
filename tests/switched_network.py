"""The rig's network with both simulated devices on it: run in a network of its own, it reports what the clients got.

    unshare --net --mount --map-root-user python switched_network.py < ways.json > found.json

A way is {interface: [addresses]} of the PC, given by `ip address add` in this order, which is what NetworkManager does
with the lines of the handbook. `eth0` of the PC is on a switch with the hand, and with the robot if `eth1` has no
address; else `eth1` is on a wire with the robot. The kernel's reverse-path filter is strict.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from kst import KstClient, KstTiming
from reflex import HandSettings, HandSilent, ReflexHand
from reflex.calibration_files import CalibrationFiles

DEVICES = {
    # The simulated controller listens on loopback; the real one on its network.
    "robot": "from rig_simulation import control_port\ncontrol_port.require_loopback = lambda *_: None\n"
    "from rig_simulation.devices.sunrise.program import main\nmain(['--host', '172.31.1.147'])",
    "hand": "from rig_simulation.devices.reflex.program import main\nmain(['--interface', 'eth0'])",
}
ADDRESSES = {"robot": "172.31.1.147/16", "hand": "10.99.99.99/7"}
WIRES = """
ip link set lo up
ip netns add switch
ip -n switch link add plain type bridge
ip -n switch link add wire type bridge
ip -n switch link set plain up
ip -n switch link set wire up
ip link add eth0 type veth peer name pc netns switch
ip link add eth1 type veth peer name pc1 netns switch
ip -n switch link set pc master plain up
ip -n switch link set pc1 master wire up
"""
DEVICE_WIRES = """
ip netns add {name}
ip -n {name} link set lo up
ip -n {name} link add eth0 type veth peer name {name} netns switch
ip -n {name} address add {address} dev eth0
ip -n {name} link set eth0 up
ip -n switch link set {name} master plain up
"""


def run(commands: str) -> None:
    """Runs commands, a line each."""
    for line in commands.strip().splitlines():
        subprocess.run(line.split(), check=True)


def dropped() -> int:
    """Returns how many packets the reverse-path filter has dropped."""
    names, values = (line.split() for line in Path("/proc/net/netstat").read_text().splitlines()[:2])
    return int(values[names.index("IPReversePathFilter")])


def found(robot: str, interface: str, patience: float) -> dict[str, object]:
    """Returns what the product's clients get from both devices at once, the hand within `patience` [s]."""
    result: dict[str, object] = {"dropped": dropped()}
    with KstClient.connect(robot, 30001, timing=KstTiming(reply=60.0, servo_reply=60.0)) as arm:
        result["joints"] = arm.joints().tolist()
        files = CalibrationFiles(tempfile.mkdtemp())
        settings = HandSettings(silence_time=60.0, calibration_max_time=60.0)
        hand = ReflexHand(interface, files=files, settings=settings)
        try:
            hand.connect()
            hand.wait_for_packet(patience)
            hand.calibrate_fingers()
            result["calibrated"] = hand.calibrated
        except HandSilent as error:
            result["silent"] = str(error)
        finally:
            hand.disconnect()
        result["joints_beside_the_hand"] = arm.joints().tolist()
    result["dropped"] = dropped() - int(result["dropped"])
    return result


def main() -> None:
    """The program."""
    job = json.load(sys.stdin)
    subprocess.run(["mount", "-t", "tmpfs", "tmpfs", "/run"], check=True)
    run(WIRES)
    for name, address in ADDRESSES.items():
        run(DEVICE_WIRES.format(name=name, address=address))
    for interface in ("all", "eth0", "eth1"):
        Path(f"/proc/sys/net/ipv4/conf/{interface}/rp_filter").write_text("1")
    devices = []
    try:
        for name, program in DEVICES.items():
            command = ["ip", "netns", "exec", name, sys.executable, "-c", program]
            devices.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        for device in devices:
            device.stdout.readline()  # it is ready
        results = []
        for way in job["ways"]:
            run(f"ip -n switch link set robot master {'wire' if way.get('eth1') else 'plain'}")
            for interface in ("eth0", "eth1"):
                run(f"ip address flush dev {interface}\nip link set {interface} up")
                for address in way.get(interface, ()):
                    run(f"ip address add {address} dev {interface}")
            results.append(found(job["robot"], job["interface"], way.get("patience", 60.0)))
        json.dump(results, sys.stdout)
    finally:
        for device in devices:
            device.terminate()
            device.wait()


if __name__ == "__main__":
    main()
