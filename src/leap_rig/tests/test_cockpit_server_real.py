"""The cockpit's server over its sockets."""

from __future__ import annotations

import contextlib
import http.client
import json
import math
import socket as sockets
import threading
import time

import cv2
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.sync.server import serve

from leap_motion.service.access import MAX_GUESSES, VisitLimits
from leap_motion.service.socket_service import PAGE_CONNECTIONS, PAGE_CONNECTIONS_OF_ADDRESS
from leap_rig.cockpit.control import HEARTBEAT_S, HeldSwitches
from leap_rig.cockpit.server import MAX_PAGES, PAGES_OF_ADDRESS, CockpitServer, ScenePage
from vision.stereo.transport import Picture

pytestmark = pytest.mark.real


@pytest.fixture()
def scene():
    """Another server in the place of viser's: it sends each message back."""

    def echo(connection):
        with contextlib.suppress(Exception):
            for message in connection:
                connection.send(message)

    with serve(echo, "127.0.0.1", 0, subprotocols=["viser-v1"]) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield ScenePage(b"the scene", server.socket.getsockname()[:2])
        server.shutdown()


class Served:
    def __init__(self, page, scene):
        self.obeyed, self.stops, self.said = [], [], []
        self.server = CockpitServer(
            page, scene, ("",), self.obeyed.append, lambda: self.stops.append(1), self.said.append,
            cameras=("scene", "wrist"),
        )  # fmt: skip
        self.server.control.fresh_s = math.inf  # but where a test is about it
        self.server._doors[0][0]._limits._grace_s = 0.0  # else a flood is refused for a moment
        self.server._openings = VisitLimits(1000, 1000)
        self.host = self.server.address.split("/")[2]

    @property
    def code(self):
        return self.said[-1].split()[-1].rstrip(".")

    def socket(self, path, machine="127.0.0.1", **options):
        """A WebSocket, also of the scene."""
        address = f"ws://{self.host}{path}"
        return connect(
            address, source_address=(machine, 0), subprotocols=["viser-v1"], close_timeout=0.5, **options
        )  # fmt: skip

    def bare(self, machine):
        """A connection that has not asked for anything."""
        host, port = self.host.split(":")
        return sockets.create_connection((host, int(port)), 60.0, (machine, 0))


@pytest.fixture()
def served(tmp_path, scene):
    page = tmp_path / "page.html"
    page.write_text("the page")
    served = Served(page, scene)
    yield served
    served.server.close()


def tell(socket, **message):
    socket.send(json.dumps(message))


def answer(socket):
    """The next answer but those to heartbeats."""
    while "heard" in (message := json.loads(socket.recv(timeout=60.0))):
        pass
    return message


def enter(served, socket):
    tell(socket, do="secret", value=served.code)
    admitted = answer(socket)
    assert "key" in admitted
    return admitted


def gone(socket):
    """Waits until the server has ended a connection."""
    with pytest.raises(ConnectionClosed):
        while True:
            socket.recv(timeout=60.0)
    return True


def until(condition):
    deadline = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def get(served, path, host=None):
    connection = http.client.HTTPConnection(served.host, timeout=60.0)
    connection.request("GET", path, headers={"Host": host or served.host})
    response = connection.getresponse()
    return response.status, response.read(), response.headers


def test_pages_and_who_may_have_them(served):
    assert get(served, "/")[:2] == (200, b"the page")
    assert get(served, "/")[2]["Content-Security-Policy"] == "frame-ancestors 'none'"
    assert get(served, served.server.scene_path)[2]["Content-Encoding"] == "gzip"
    assert get(served, "/else")[0] == 404
    assert get(served, "/", "evil.example")[0] == 403
    assert get(served, "/scene/")[0] == 404
    sockets = ("/state", "/control", "/pictures", served.server.scene_path)
    for path, origin in [
        *((path, "http://evil.example") for path in sockets),
        *((path, "null") for path in sockets[:3]),
    ]:
        with pytest.raises(InvalidStatus):
            served.socket(path, origin=origin)


def test_the_scene_is_passed_through_with_its_subprotocol(served):
    with served.socket(served.server.scene_path, origin="null") as socket:
        assert socket.subprotocol == "viser-v1"
        socket.send(b"\x00\x01")
        assert socket.recv(timeout=60.0) == b"\x00\x01"
        assert served.server.scene_watched
    until(lambda: not served.server.scene_watched)


def test_each_page_gets_the_state_and_is_seen(served):
    assert not served.server.watched
    with served.socket("/state") as socket:
        assert answer(socket) == {}
        assert served.server.watched
        served.server.put_state({"number": 1})
        assert answer(socket) == {"number": 1, "controller": None, "scene": served.server.scene_path}
    until(lambda: not served.server.watched)


@pytest.mark.parametrize(
    "command", ["control", "gripper", "exit", "scaling", "operator", "record", "mark", "tutorial", "stop", "take"]
)
def test_a_page_without_the_code_commands_nothing(served, command):
    values = {"scaling": 1.0, "mark": "begin", "operator": "anna"}
    with served.socket("/control") as socket:
        tell(socket, do="beat", focus=True, held={"": ["enable", "clutch"]})
        tell(socket, do=command, value=values.get(command, True))
        assert "code" in answer(socket)["refused"]
        tell(socket, do="secret", value="00000000")
        assert answer(socket)["code"] is False
    assert not served.obeyed and not served.stops
    assert served.server.held() == {"": HeldSwitches()}


def test_one_page_has_control_every_page_with_the_code_stops(served):
    with served.socket("/control") as first, served.socket("/control") as second:
        enter(served, first)
        enter(served, second)
        tell(first, do="control", value=True)
        assert "Take control" in answer(first)["refused"]
        tell(first, do="take")
        assert answer(first) == {"control": True}
        tell(second, do="take")
        assert "has had control" in answer(second)["refused"]
        tell(first, do="control", value=True)
        assert "no focus" in answer(first)["refused"]
        tell(first, do="beat", focus=True, held={})
        tell(first, do="control", value=True)
        until(lambda: served.obeyed)
        assert served.obeyed[0][:3] == ("control", "", True)
        tell(second, do="stop")
        assert "sent" in answer(second)["done"]
        assert served.stops == [1]


def test_what_is_held_is_let_go_without_heartbeat_and_with_the_connection(served):
    with served.socket("/control") as socket:
        enter(served, socket)
        tell(socket, do="take")
        answer(socket)
        tell(socket, do="beat", focus=True, held={})
        tell(socket, do="beat", focus=True, held={"": ["enable"]})
        began = time.monotonic()
        until(lambda: served.server.held()[""].enable)
        until(lambda: not served.server.held()[""].enable)
        assert time.monotonic() - began >= HEARTBEAT_S
        assert controlled(served) and not served.server.live
    until(lambda: not controlled(served))


def test_what_waited_in_a_slow_connection_commands_nothing_but_a_stop(served):
    with served.socket("/control") as socket:
        enter(served, socket)
        tell(socket, do="take")
        assert answer(socket)["control"]
        served.server.control.fresh_s = 1.0
        tell(socket, do="beat", focus=True, held={})
        now = json.loads(socket.recv(timeout=60.0))["heard"]
        for heard in (now - 2.0, now + 1e6, math.nan, None, "now"):
            tell(socket, do="beat", focus=True, held={}, heard=heard)
            tell(socket, do="control", value=True, heard=heard)
            assert "slow" in answer(socket)["refused"]
            assert not served.server.live and not served.obeyed
        served.server.control.fresh_s = 1e3
        tell(socket, do="beat", focus=True, held={}, heard=now)
        tell(socket, do="control", value=True, heard=now)
        until(lambda: served.obeyed)
        tell(socket, do="stop")
        until(lambda: served.stops)


def test_a_page_that_is_there_uses_its_key(served):
    with served.socket("/control") as socket:
        key, keys = enter(served, socket)["key"], served.server.control.access._keys
        keys[key] = -math.inf
        tell(socket, do="beat", focus=True, held={})
        until(lambda: keys[key] > -math.inf)


def test_a_burst_of_a_page_with_the_code_loses_no_stop(served):
    with served.socket("/control") as socket:
        enter(served, socket)
        for _ in range(300):
            tell(socket, do="beat", focus=True, held={})
        socket.send('{"do":"stop"}')
        assert "sent" in answer(socket)["done"] and served.stops == [1]


def controlled(served):
    return served.server.control.controller is not None


def test_a_page_without_focus_commands_nothing_and_holds_nothing_but_stops(served):
    with served.socket("/control") as socket:
        enter(served, socket)
        tell(socket, do="take")
        answer(socket)
        tell(socket, do="beat", focus=True, held={})
        tell(socket, do="beat", held={"": ["enable"]})
        for command, value in (("control", True), ("gripper", False), ("exit", None), ("mark", "begin")):
            tell(socket, do=command, value=value)
            assert "no focus" in answer(socket)["refused"]
        assert not served.server.held()[""].enable and not served.server.live and not served.obeyed
        tell(socket, do="stop")
        assert "sent" in answer(socket)["done"] and served.stops


def test_a_flood_ends_the_connection_and_the_next_one_works(served):
    with served.socket("/control") as socket:
        with contextlib.suppress(Exception):
            for _ in range(500):
                socket.send("nothing")
        with pytest.raises(Exception, match="1008|too many"):
            for _ in range(500):
                socket.recv(timeout=60.0)
    with served.socket("/control") as socket:
        enter(served, socket)


def test_each_camera_has_its_own_images_and_rests_by_itself(served):
    with served.socket("/pictures?camera=wrist") as socket:
        until(lambda: served.server.pictures.watched("wrist"))
        assert not served.server.pictures.watched("scene")
        for camera, level in (("scene", 0), ("wrist", 200)):
            served.server.put_picture(camera, Picture(np.full((8, 8, 3), level, np.uint8), 1.0, 2.0, {}))
        socket.send("{}")
        assert answer(socket)["picture"]
        image = cv2.imdecode(np.frombuffer(socket.recv(timeout=60.0), np.uint8), cv2.IMREAD_COLOR)
        assert image.min() > 150
    with served.socket("/pictures?camera=none") as socket, pytest.raises(ConnectionClosed, match="1008"):
        socket.recv(timeout=60.0)


def machines(first=2):
    """Addresses of as many machines as a test wants."""
    return (f"127.0.0.{number}" for number in range(first, 255))


def crowd(served, stack, path):
    """Pages without the code on all places of a path, from several machines."""
    return [
        stack.enter_context(served.socket(path, machine))
        for machine, _ in zip(machines(), range(MAX_PAGES // PAGES_OF_ADDRESS))
        for _ in range(PAGES_OF_ADDRESS)
    ]


def test_a_crowd_leaves_room_for_a_page_with_the_code_on_every_path(served):
    paths = ("/state", "/pictures?camera=wrist", served.server.scene_path)
    with contextlib.ExitStack() as stack:
        crowds = {path: crowd(served, stack, path) for path in (*paths, "/control")}
        for path in paths:
            with served.socket(path) as refused, pytest.raises(ConnectionClosed, match="too many pages"):
                refused.recv(timeout=60.0)
        control = stack.enter_context(served.socket("/control"))
        ticket = enter(served, control)["ticket"]
        kept = [control]
        for path in paths:
            end = f"/{ticket}" if path in served.server.scene_path else f"{'&' if '?' in path else '?'}ticket={ticket}"
            kept.append(stack.enter_context(served.socket(path + end)))
            assert gone(crowds[path][0])
        tell(control, do="take")
        assert answer(control)["control"]
        for machine, _ in zip(machines(20), range(2 * MAX_PAGES)):  # newcomers, and none takes those places
            for path in (*paths, "/control"):
                stack.enter_context(served.socket(path, machine))
            tell(control, do="beat", focus=True, held={})
        tell(control, do="stop")
        assert "sent" in answer(control)["done"] and served.stops == [1] and controlled(served)
        served.server.put_state({})
        until(lambda: "scene" in answer(kept[1]))
        kept[3].send(b"x")
        assert kept[3].recv(timeout=60.0) == b"x"
        served.server.put_picture("wrist", Picture(np.zeros((8, 8, 3), np.uint8), 1.0, 2.0, {}))
        kept[2].send("{}")
        assert answer(kept[2])["picture"]


def test_a_flood_that_opens_the_scene_waits_and_a_page_with_the_ticket_does_not(served):
    for_ever_s = 1e9
    served.server._openings = VisitLimits(3, 2, for_ever_s)
    path = served.server.scene_path
    assert [get(served, path)[0] for _ in range(4)] == [200, 200, 429, 429]
    assert get(served, path)[2]["Refresh"]
    with pytest.raises(InvalidStatus, match="429"):
        served.socket(path)
    with pytest.raises(InvalidStatus, match="403"):
        served.socket(path, "127.0.0.2", origin="http://evil.example")
    with served.socket(path, "127.0.0.2") as socket:
        socket.send(b"x")
        assert socket.recv(timeout=60.0) == b"x"
    with pytest.raises(InvalidStatus, match="429"):
        served.socket(path, "127.0.0.3")
    ticket = served.server.control.access.ticket
    assert get(served, f"{path}/{ticket}")[0] == 200
    with served.socket(f"{path}/{ticket}") as socket:
        socket.send(b"x")
        assert socket.recv(timeout=60.0) == b"x"


def test_the_ticket_alone_keeps_nobody_off_the_stop(served):
    with contextlib.ExitStack() as stack:
        ticket = enter(served, stack.enter_context(served.socket("/control")))["ticket"]
        served.server._limits["/control"]._total = 4
        for machine, _ in zip(machines(), range(4)):
            stack.enter_context(served.socket(f"/control?ticket={ticket}", machine))
        control = stack.enter_context(served.socket(f"/control?ticket={ticket}"))
        enter(served, control)
        tell(control, do="stop")
        assert "sent" in answer(control)["done"] and served.stops == [1]


def test_who_has_the_code_stops_though_all_connections_are_taken_and_is_not_cut_off_then(served):
    flooding = []
    with contextlib.ExitStack() as stack:

        def flood(first):
            for machine, _ in zip(machines(first), range(PAGE_CONNECTIONS // PAGE_CONNECTIONS_OF_ADDRESS + 2)):
                of_machine = [served.bare(machine) for _ in range(PAGE_CONNECTIONS_OF_ADDRESS + 1)]
                flooding.extend(map(stack.enter_context, of_machine))

        flood(2)
        control = stack.enter_context(served.socket("/control"))
        enter(served, control)
        flooding.clear()
        flood(20)
        assert flooding[-PAGE_CONNECTIONS_OF_ADDRESS - 1].recv(1) == b"", "the server has accepted the flood"
        tell(control, do="stop")
        assert "sent" in answer(control)["done"] and served.stops == [1]


def test_of_too_many_connections_of_a_machine_its_own_oldest_ends(served):
    with served.bare("127.0.0.2") as other, contextlib.ExitStack() as stack:
        mine = [stack.enter_context(served.bare("127.0.0.3")) for _ in range(PAGE_CONNECTIONS_OF_ADDRESS + 1)]
        assert mine[0].recv(1) == b""
        for still in (other, *mine[1:]):
            still.settimeout(0.0)
            with pytest.raises(BlockingIOError):
                still.recv(1)


def test_wrong_codes_from_many_machines_bring_a_new_code_and_the_old_key_stays(served):
    with served.socket("/control") as control:
        key = enter(served, control)["key"]
        served.server.control.access._since = -math.inf
        code = served.code
        for number, machine in zip(range(MAX_GUESSES), machines()):
            with served.socket("/control", machine) as guessing:
                tell(guessing, do="secret", value=f"guess {number}")
                assert answer(guessing)["code"] is False
        assert served.code != code and "wrong codes" in served.said[-1]
        with served.socket("/control") as back:
            tell(back, do="secret", value=key)
            assert answer(back)["key"] == key
            tell(back, do="stop")
            assert "sent" in answer(back)["done"]


@pytest.mark.parametrize(
    "twice", ["Host: {0}\r\nHost: {0}", "Host: {0}\r\nOrigin: http://{0}\r\nOrigin: http://evil.example"]
)
@pytest.mark.parametrize("path", ["/", "/control"])
def test_two_hosts_or_origins_are_refused_in_a_sentence(served, twice, path):
    upgrade = "" if path == "/" else "Upgrade: websocket\r\nConnection: Upgrade\r\n"
    with served.bare("127.0.0.1") as browser:
        browser.sendall(f"GET {path} HTTP/1.1\r\n{twice.format(served.host)}\r\n{upgrade}\r\n".encode())
        said = browser.makefile().read()
    assert said.startswith("HTTP/1.1 400 ") and said.endswith("\n\nGive one Host and one Origin.\n")
