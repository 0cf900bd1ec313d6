"""The server and its other end in integrations/, over a real socket; and LeRobot's plug-ins where it is installed."""

import importlib.util
import json
import os
import socket
import stat
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from common.errors import DeviceError
from leap_rig.lerobot import actions
from leap_rig.lerobot.server import MOST_CLIENTS, LerobotServer

pytestmark = [pytest.mark.real]
ROOT = Path(__file__).parents[3]
LEROBOT = ROOT / ".venv-lerobot" / "bin" / "python"
PLUGINS = ROOT / "integrations"


@pytest.fixture(scope="module")
def link():
    """The module leap_rig_link, which no environment of the rig installs."""
    spec = importlib.util.spec_from_file_location("leap_rig_link", PLUGINS / "leap_rig_link" / "leap_rig_link.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class FakeRig:
    """Answers as lerobot_server.py does."""

    def __init__(self, names, moves=True):
        self.state, self.moves, self.taken = {name: 0.25 * i for i, name in enumerate(names)}, moves, []
        self.fault = self.refused = ""
        self.clients, self.left = set(), []
        self.intent = dict(zip(actions.ACTION, (0.5, 0.1, 0.4, 0.0, 0.0, 0.0, 1.0, 0.1, 0.2, 0.3, 0.4)))

    def answer(self, request, client):
        self.clients.add(client)
        if self.fault:
            raise DeviceError(self.fault)
        if request["do"] == "hello":
            return {"moves": self.moves, "action": actions.ACTION}, {}
        if request["do"] == "observe":
            image = cv2.imencode(".jpg", np.full((48, 64, 3), (30, 60, 200), np.uint8))[1].tobytes()
            return {"state": self.state}, {"color": image}
        if request["do"] == "intent":
            return {"action": self.intent}, {}
        self.taken += [] if self.refused else [request["action"]]
        return {"refused": self.refused}, {}


@pytest.fixture
def rig(tmp_path, link):
    rig = FakeRig(link.STATE)
    rig.path = tmp_path / "rig.sock"
    server = LerobotServer(rig.path, rig.answer, rig.left.append)
    yield rig
    server.close()
    assert not rig.path.exists()


def test_both_ends_name_the_same(link):
    assert (link.POSE, link.FINGERS, link.ACTION, link.STATE) == (
        actions.POSE, actions.FINGERS, actions.ACTION, actions.STATE
    )  # fmt: skip


def test_requests_are_answered_over_the_socket(rig, link):
    client = link.RigLink(str(rig.path))
    assert not client.is_connected
    client.connect()
    assert client.is_connected and client.moves and stat.S_IMODE(rig.path.stat().st_mode) == 0o600
    said, images = client.ask("observe")
    assert said["state"] == rig.state and images["color"].startswith(b"\xff\xd8")
    assert client.ask("act", action=rig.intent)[0] == {"refused": ""} and rig.taken == [rig.intent]
    rig.fault = "The arm has said nothing for 1 s."
    with pytest.raises(link.RigLinkError, match="nothing for 1 s"):
        client.ask("observe")
    rig.fault = ""
    assert client.ask("intent")[0]["action"] == rig.intent, "a fault leaves the connection open"
    with pytest.raises(link.RigLinkError, match="not sent"):
        client.ask("act", action={"a": float("nan")})
    client.close()
    with pytest.raises(link.RigLinkError, match="not connected"):
        client.ask("observe")


def test_clients_may_come_late_whatever_time_limit_the_process_has(tmp_path, link):
    """Nodes give each new socket a time limit, after which nobody would be accepted any more."""
    rig, limit_s = FakeRig(link.STATE), 0.05
    socket.setdefaulttimeout(limit_s)
    try:
        server = LerobotServer(tmp_path / "rig.sock", rig.answer)
    finally:
        socket.setdefaulttimeout(None)
    server._thread.join(20 * limit_s)
    assert server._thread.is_alive()
    link.RigLink(str(tmp_path / "rig.sock")).connect()
    server.close()


def test_what_is_no_message_ends_the_connection_and_not_the_server(rig, link):
    for sent in (b"GET / HTTP/1.1", b"LEAP\x00\x09" + bytes(8)):
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(30.0)
            client.connect(str(rig.path))
            client.sendall(sent)
            answer = b"".join(iter(lambda client=client: client.recv(4096), b""))
            assert json.loads(answer[14:])["fault"].endswith(".")
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(rig.path))
        client.sendall(b"LEAP\x00")
    link.RigLink(str(rig.path)).connect()


def test_too_many_clients_are_turned_away(rig, link):
    clients = [link.RigLink(str(rig.path)) for _ in range(MOST_CLIENTS + 1)]
    for client in clients[:-1]:
        client.connect()
    with pytest.raises(link.RigLinkError, match="closed"):
        clients[-1].connect()
    assert rig.clients == set(range(1, MOST_CLIENTS + 1))


def test_a_connection_never_gets_the_number_of_one_that_ended(rig, link, wait_until):
    for _ in range(3):
        client = link.RigLink(str(rig.path))
        client.connect()
        client.close()
        wait_until(lambda: rig.clients == set(rig.left), 10.0, "the end of the connection")
    assert rig.left == [1, 2, 3]


def test_a_path_in_use_is_refused_and_that_of_a_killed_server_is_taken(rig, tmp_path, link):
    with pytest.raises(DeviceError, match="Another server listens"):
        LerobotServer(rig.path, rig.answer)
    assert rig.path.exists()
    old = tmp_path / "old.sock"
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(old))
    server = LerobotServer(old, rig.answer)
    link.RigLink(str(old)).connect()
    server.close()
    for path in (tmp_path / "file", tmp_path / ("x" * 200)):
        if len(path.name) < 10:
            path.write_text("")
        with pytest.raises(DeviceError, match="cannot be listened on"):
            LerobotServer(path, rig.answer)


def test_a_rig_that_is_not_there_is_named(tmp_path, link):
    with pytest.raises(link.RigLinkError, match=r"lerobot_server\.py"):
        link.RigLink(str(tmp_path / "none")).connect()


PLUGGED = """
import json, sys
from pathlib import Path
from lerobot.robots import RobotConfig, make_robot_from_config
from lerobot.teleoperators import TeleoperatorConfig, make_teleoperator_from_config
from lerobot.utils.import_utils import register_third_party_plugins
register_third_party_plugins()
path, home = sys.argv[1:]
kinds = [each.get_choice_class("leap_rig") for each in (RobotConfig, TeleoperatorConfig)]
robot = make_robot_from_config(kinds[0](socket=path, images={"color": [48, 64]}, calibration_dir=Path(home)))
teleop = make_teleoperator_from_config(kinds[1](socket=path, calibration_dir=Path(home)))
robot.connect(), teleop.connect()
seen, wanted = robot.get_observation(), teleop.get_action()
sent = robot.send_action(wanted)
sizes = []
for size in ([24, 32], [96, 128], [64, 48], [50, 64], [0, 0]):
    robot.config.images = {"color": size}
    try:
        sizes.append(list(robot.get_observation()["color"].shape))
    except ConnectionError as error:
        sizes.append(str(error))
print(json.dumps({
    "observed": sorted(seen), "features": sorted(robot.observation_features), "sent": sent, "wanted": wanted,
    "action": sorted(robot.action_features), "teleop": sorted(teleop.action_features),
    "image": [list(seen["color"].shape), seen["color"][20, 20].tolist()], "connected": robot.is_connected,
    "sizes": sizes,
}))
robot.disconnect(), teleop.disconnect()
assert not robot.is_connected and not teleop.is_connected
"""


def plugged(tmp_path, rig):
    """Runs the plug-ins in LeRobot's environment, where they are found as installed packages are."""
    for name in ("lerobot_robot_leap_rig", "lerobot_teleoperator_leap_rig"):
        about = tmp_path / f"{name}-0.1.0.dist-info"
        about.mkdir(exist_ok=True)
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1.0\n")
    paths = [tmp_path, *(PLUGINS / name for name in os.listdir(PLUGINS) if (PLUGINS / name).is_dir())]
    variables = {
        **os.environ,
        "PYTHONPATH": ":".join(map(str, paths)),
        "HF_HUB_OFFLINE": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    command = [str(LEROBOT), "-c", PLUGGED, str(rig.path), str(tmp_path / "home")]
    return subprocess.run(command, env=variables, capture_output=True, text=True, check=False)


def test_lerobot_finds_the_plug_ins_and_drives_them(rig, tmp_path):
    if not LEROBOT.is_file():
        pytest.skip("LeRobot is not installed: make lerobot")
    done = plugged(tmp_path, rig)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["observed"] == found["features"] and found["action"] == found["teleop"] == sorted(actions.ACTION)
    assert found["sent"] == found["wanted"] == rig.intent and rig.taken == [rig.intent] and found["connected"]
    assert found["image"][0] == [48, 64, 3] and found["image"][1] == pytest.approx([200, 60, 30], abs=6)
    refused = [f"The image of color is 48 x 64, but {size} is configured." for size in ("64 x 48", "50 x 64", "0 x 0")]
    assert found["sizes"] == [[24, 32, 3], [96, 128, 3], *refused]
