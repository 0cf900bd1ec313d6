"""The page of stereo_web in virtual time: who gets what, and when; the program by https; the page in a browser."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import http.client
import json
import os
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import urllib.request
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import websockets.asyncio.client
from depth_scene import RGB, load
from stereo_camera import REMAPS, Camera
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.frames import Frame, Opcode
from websockets.sync.client import connect

from common import clock
from common.errors import DeviceError
from common.operator_rows import OLD_ROWS_S
from simulated.chromium import browser

pytest.importorskip("rig_msgs.srv")
import rospy

from leap_motion.headset import transport
from leap_motion.headset.hand_stream import HandStream
from leap_motion.service.socket_service import GRACE_S, PAGE_CONNECTIONS_OF_ADDRESS
from rig_msgs.msg import OperatorRow, OperatorView
from vision.ros.stereo import web_node
from vision.ros.stereo.view_node import find_screen
from vision.ros.stereo.web_node import StereoWeb
from vision.stereo.view import WebConfig

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros

PAGE = str(Path(__file__).parents[1] / "web" / "headset.html")
PORT = 8000
URL = f"ws://127.0.0.1:{PORT}/pictures"
REQUEST = (
    f"GET /pictures HTTP/1.1\r\nHost: 127.0.0.1:{PORT}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
).encode()
WEB = {"host": "127.0.0.1", "port": PORT, "page": PAGE, "certificate": "", "key": ""}
REFRESH_S = 0.2  # how often the node looks for pages
SILENCE_S = 0.5  # after which a page hears that there is no image
REQUEST_S = 10.0  # after which a page that asks for nothing is gone
SEND_S, OPEN_TIMEOUT_S, GONE_S, ACCEPT_RETRY_S = 2.0, 5.0, 10.0, 1.0
"""After which a page is gone that takes no answers; one that sends no request; one that does not take what was sent
before the end; asyncio accepts connections again."""
SOON_S = 0.01
MAX_PAGES, PAGES_OF_ADDRESS = 6, 3


@pytest.fixture
def camera(virtual_graph):
    return Camera()


@pytest.fixture
def node(virtual_graph):
    rospy.set_param("stereo_web", {"view": {**load("stereo_view.yaml"), "lens": "none"}, "web": WEB})
    node = virtual_graph.run("vision", "stereo_web_node.py", *REMAPS)
    clock.sleep(SOON_S)
    assert f"The view is at http://127.0.0.1:{PORT}/" in node.log
    return node


def get(graph, path, host=f"127.0.0.1:{PORT}"):
    """The answer to a request without a WebSocket, with its `body`."""
    with graph.wires.connect(("127.0.0.1", PORT)) as connection:
        connection.sendall(f"GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        answer = http.client.HTTPResponse(connection)
        answer.begin()
        answer.body = answer.read()
        return answer


def ask(page):
    page.send("next")
    said = json.loads(page.recv(timeout=60.0))
    return said, page.recv(timeout=60.0) if said["picture"] else None


def test_a_page_gets_each_image_once_and_the_camera_rests_without_a_page(virtual_graph, node, camera):
    answer = get(virtual_graph, "/")
    assert answer.headers["Content-Type"].startswith("text/html") and answer.body == Path(PAGE).read_bytes()
    clock.sleep(REFRESH_S)
    assert not camera.watched()
    page = connect(URL)
    clock.sleep(REFRESH_S + SOON_S)
    assert camera.watched()
    for _ in range(2):  # the depth of the first one may come behind it
        camera.publish()
        clock.sleep(0.02)
    said, jpeg = ask(page)
    assert said["picture"] and said["deep"] and "rows" not in said and "hands" not in said
    both = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert both.shape == (RGB.height, 2 * RGB.width, 3)
    assert both[240, 200, 0] > 150 and both[240, 1280 - 200, 2] > 150
    left, right, up, down = said["tangents"]
    assert (left + right) * RGB.P[0, 0] == pytest.approx(640.0)
    assert (up + down) * RGB.P[1, 1] == pytest.approx(480.0)
    begun = clock.monotonic()
    assert ask(page)[0] == {"picture": False}
    assert clock.monotonic() - begun == pytest.approx(SILENCE_S, abs=SOON_S)
    page.close()
    clock.sleep(REFRESH_S + SOON_S)
    assert not camera.watched()


def test_while_the_master_hangs_pages_come_and_go_and_get_images(virtual_graph, node, camera):
    def shows_images():
        page = connect(URL)
        clock.sleep(REFRESH_S + SOON_S)
        for _ in range(2):
            camera.publish()
            clock.sleep(0.02)
        found = ask(page)[0]["picture"]
        page.close()
        return found

    assert shows_images()
    virtual_graph.master_hangs = True
    clock.sleep(1.0)
    assert shows_images()
    virtual_graph.master_hangs = False
    clock.sleep(REFRESH_S + SOON_S)
    assert not camera.watched()


def test_a_late_page_gets_the_newest_image_alone_and_its_age(node, camera):
    page = connect(URL)
    clock.sleep(REFRESH_S + SOON_S)
    for _ in range(4):
        camera.publish()
        clock.sleep(SOON_S)
    published = clock.monotonic() - SOON_S
    clock.sleep(0.3)
    page.send(json.dumps({"t": 7.0}))
    said, jpeg = json.loads(page.recv(timeout=60.0)), page.recv(timeout=60.0)
    assert said["picture"] and jpeg[:2] == b"\xff\xd8"
    assert said["t"] == 7.0 and said["waited"] == pytest.approx(0.0, abs=1e-3)
    assert said["now"] - said["taken"] == pytest.approx(1e3 * (clock.monotonic() - published), abs=1.0)
    page.send(json.dumps({"t": 8.0}))
    said = json.loads(page.recv(timeout=60.0))
    assert not said["picture"] and said["waited"] == pytest.approx(1e3 * SILENCE_S)
    page.close()


@pytest.mark.parametrize(
    "message", ["", "[]", '{"t": "soon"}', '{"t": null}', '{"offer": "v=0"}', '{"video": 1}', b"\x00"]
)
def test_whatever_a_page_asks_it_gets_no_more_than_an_image(node, camera, message):
    page = connect(URL)
    page.send(message)
    said = json.loads(page.recv(timeout=60.0))
    assert said == ({"answer": None} if "offer" in str(message) else {"picture": False})
    assert ask(page)[0] == {"picture": False}
    page.close()


def test_what_the_operator_sees_comes_with_the_images_while_it_is_fresh(node, camera):
    view = rospy.Publisher("operator_view/rows", OperatorView, queue_size=1)
    page = connect(URL)
    clock.sleep(REFRESH_S + SOON_S)
    rows = [dict(name="Hand", text="waiting", tone="good", kind="ticks", labels=["flat"], values=[1.0])]
    view.publish(OperatorView(rows=[OperatorRow(**row) for row in rows]))
    clock.sleep(SOON_S)
    for _ in range(int(OLD_ROWS_S / SILENCE_S) - 1):
        assert ask(page)[0] == {"picture": False, "rows": rows}
    assert ask(page)[0] == {"picture": False}
    page.close()


def test_pages_that_ask_for_nothing_make_room_for_others(virtual_graph, node, camera):
    def refused():
        with pytest.raises(ConnectionClosed) as closed:
            connect(URL).recv(timeout=1.0)
        return closed.value.rcvd.code == 1013 and "too many pages" in closed.value.rcvd.reason

    pages = [connect(URL) for _ in range(PAGES_OF_ADDRESS)]
    begun = clock.monotonic()
    assert refused()
    virtual_graph.wires.client_address = "127.0.0.2"
    assert ask(connect(URL))[0] == {"picture": False}, "one machine does not take the place of another"
    pages += [connect(URL) for _ in range(MAX_PAGES - PAGES_OF_ADDRESS - 1)]
    virtual_graph.wires.client_address = "127.0.0.3"
    assert refused()
    for page in pages:
        with pytest.raises(ConnectionClosed):
            page.recv(timeout=60.0)
    assert clock.monotonic() - begun == pytest.approx(REQUEST_S + SILENCE_S, abs=SOON_S)
    assert ask(connect(URL))[0] == {"picture": False}


def test_a_page_that_takes_no_answers_is_gone(virtual_graph, node, camera):
    page = virtual_graph.wires.connect(("127.0.0.1", PORT))
    page.sendall(REQUEST)
    clock.sleep(SOON_S)
    page.recv(4096)
    virtual_graph.wires.connections[-1].down.room = 2 * len('..{"picture": false}')
    page.sendall(3 * Frame(Opcode.TEXT, b"next").serialize(mask=True))
    clock.sleep(3 * SILENCE_S + SEND_S - SOON_S)
    assert camera.watched()
    clock.sleep(REFRESH_S + 2 * SOON_S)
    assert not camera.watched()


def test_idle_connections_of_one_machine_neither_end_the_server_nor_keep_others_out(virtual_graph, node):
    wires = virtual_graph.wires
    idle = [wires.connect(("127.0.0.1", PORT)) for _ in range(300)]
    idle[0].sendall(b"GET / HT")
    wires.client_address = "127.0.0.2"
    assert get(virtual_graph, "/").status == 200
    wires.client_address = "127.0.0.1"
    with pytest.raises(OSError):
        get(virtual_graph, "/")
    assert sum(each.readable_at() > clock.monotonic() for each in idle) == PAGE_CONNECTIONS_OF_ADDRESS
    clock.sleep(GRACE_S)
    assert get(virtual_graph, "/").status == 200 and idle[0].readable_at() < clock.monotonic(), "the oldest gives way"
    clock.sleep(OPEN_TIMEOUT_S)
    assert get(virtual_graph, "/").status == 200 and all(each.readable_at() < clock.monotonic() for each in idle)


def test_who_does_not_take_the_page_keeps_no_place(virtual_graph, node):
    deaf = virtual_graph.wires.connect(("127.0.0.1", PORT))
    virtual_graph.wires.connections[-1].down.room = 100
    deaf.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{PORT}\r\n\r\n".encode())
    # On an older Python, websockets' own limit ends what is not taken.
    clock.sleep((GONE_S if sys.version_info >= (3, 11) else OPEN_TIMEOUT_S) - SOON_S)
    deaf.sendall(b"still here")
    clock.sleep(2 * SOON_S)
    with pytest.raises(OSError):
        deaf.sendall(b"and now")


def test_the_server_comes_back_after_the_system_had_no_descriptor(virtual_graph, node, monkeypatch):
    def refuse(_):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    with monkeypatch.context() as patch:
        patch.setattr("simulated.wires.Socket.accept", refuse)
        waits = virtual_graph.wires.connect(("127.0.0.1", PORT))
        clock.sleep(3.5)
    clock.sleep(ACCEPT_RETRY_S)
    assert get(virtual_graph, "/").status == 200
    waits.close()


def test_ctrl_c_ends_it_while_a_page_looks(node, camera):
    page = connect(URL)
    clock.sleep(REFRESH_S + SOON_S)
    assert camera.watched()
    node.send_signal(signal.SIGINT)
    with pytest.raises(ConnectionClosed) as closed:
        page.recv(timeout=1.0)
    assert closed.value.rcvd.code == 1001
    assert node.wait(1.0) == 0 and "Traceback" not in node.log


def test_other_paths_and_other_sites_get_nothing(virtual_graph, node):
    assert [get(virtual_graph, path).status for path in ("/secret", "/../etc/passwd", "/hands")] == [404] * 3
    assert get(virtual_graph, "/", host="evil.example:80").status == 403
    with pytest.raises(InvalidStatus, match="403"):
        connect(URL, origin="http://evil.example")
    assert ask(connect(URL, origin=f"http://127.0.0.1:{PORT}"))[0] == {"picture": False}


def test_an_address_that_is_not_ours_ends_it_with_a_sentence(virtual_graph):
    web = {**WEB, "host": "192.0.2.1"}
    rospy.set_param("stereo_web", {"view": load("stereo_view.yaml"), "web": web})
    node = virtual_graph.run("vision", "stereo_web_node.py")
    assert node.wait(1.0) == 1
    assert f"Cannot serve the page on 192.0.2.1:{PORT}" in node.log and "Traceback" not in node.log


def test_an_unknown_output_for_the_window_is_refused(application):
    with pytest.raises(DeviceError, match="'HDMI-7'"):
        find_screen(application, "HDMI-7")
    assert find_screen(application, "") is None, "no display is a Rift"


def start_program(ros, wait_until, certificate="", key="", **view):
    """Starts the node as a process; returns it and the address of its page."""
    web = {**WEB, "port": 0, "certificate": certificate, "key": key}
    rospy.set_param("stereo_web", {"view": {**load("stereo_view.yaml"), "lens": "none", **view}, "web": web})
    node = ros.run("vision", "stereo_web_node.py", *REMAPS)

    def address():
        assert node.poll() is None, node.log_path.read_text()
        words = node.log_path.read_text().split("The view is at ")
        return words[1].split("\x1b")[0].split()[0] if len(words) > 1 else None

    return node, wait_until(address, 30.0, "the address of the page")


def page_of(address, certificate, **messages):
    """Asks for the page, and sends a message on each of its sockets; returns the first answers.

    By asyncio: OpenSSL loses what one thread sends while another reads the session tickets of a new connection.
    """
    assert address.startswith("https://")
    trust = ssl.create_default_context(cafile=certificate)
    with urllib.request.urlopen(address, timeout=60.0, context=trust) as answer:
        assert answer.read() == Path(PAGE).read_bytes()
    options = {"ssl": trust, "origin": address.rstrip("/"), "open_timeout": 60.0}

    async def exchange(path, message):
        async with websockets.asyncio.client.connect(address.replace("https", "wss") + path, **options) as page:
            await page.send(message)
            return json.loads(await page.recv())

    return [asyncio.run(exchange(path, message)) for path, message in messages.items()]


@pytest.mark.real
@pytest.mark.skipif(not shutil.which("openssl"), reason="openssl is not installed")
def test_with_a_certificate_the_program_serves_by_https_until_ctrl_c(ros, processes, wait_until, tmp_path):
    key, certificate = str(tmp_path / "key.pem"), str(tmp_path / "certificate.pem")
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=localhost",
         "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", key, "-out", certificate],
        check=True, capture_output=True, timeout=60.0,
    )  # fmt: skip
    node, address = start_program(ros, wait_until, certificate, key)
    assert page_of(address, certificate, pictures="next") == [{"picture": False}]
    assert processes.end(node) == 0
    assert "Traceback" not in node.log_path.read_text()


def page_with_hands():
    """The server of a page with hands, and what it says."""
    served, said = SimpleNamespace(offer=lambda _: None, plug=lambda _: None), []
    scene = transport.Scene(0.35, False, {})
    endpoint = transport.HandsEndpoint(HandStream(0.4, 0.35), served, lambda: scene, said.append)
    web = StereoWeb(WebConfig("127.0.0.1", 0, PAGE, "", "", True, 0, 0.4, 0.35, "", "auto", False, ""), endpoint)
    return web, said


@pytest.mark.real
def test_a_crowd_takes_neither_images_nor_the_seat_from_who_has_the_code(monkeypatch):
    monkeypatch.setattr(web_node, "own_certificate", lambda _: SimpleNamespace(server=lambda: None, fingerprint=str))
    web, said = page_with_hands()
    web._doors[0][0]._limits._grace_s = 0.0  # else the flood is refused for a moment
    wire, address = web.address.replace("http", "ws"), ("127.0.0.1", int(web.address.split(":")[2].rstrip("/")))
    try:
        with contextlib.ExitStack() as stack:

            def opened(path, machine="127.0.0.1"):
                return stack.enter_context(connect(wire + path, source_address=(machine, 0), close_timeout=0.5))

            watching = [opened("pictures", f"127.0.0.{2 + i // PAGES_OF_ADDRESS}") for i in range(MAX_PAGES)]
            with pytest.raises(ConnectionClosed, match="too many pages"):
                opened("pictures").recv(timeout=60.0)
            headset = opened("hands")
            headset.send(json.dumps({"secret": said[0].rstrip(".")[-8:]}))
            seat = json.loads(headset.recv(timeout=60.0))
            pictures = opened(f"pictures?camera=&ticket={seat['ticket']}")
            for machine in range(10, 20):
                opened("hands", f"127.0.0.{machine}")
                for _ in range(PAGE_CONNECTIONS_OF_ADDRESS):
                    stack.enter_context(socket.create_connection(address, 60.0, (f"127.0.0.{machine}", 0)))
            headset.send('{"away": true}')
            assert "note" in json.loads(headset.recv(timeout=60.0))
            pictures.send("next")
            assert json.loads(pictures.recv(timeout=60.0)) == {"picture": False, "hands": True}
            with pytest.raises(ConnectionClosed):
                watching[0].recv(timeout=60.0)
    finally:
        web.close()


@pytest.mark.real
@pytest.mark.skipif(not shutil.which("openssl"), reason="openssl is not installed")
def test_a_page_with_hands_has_the_rigs_own_certificate(monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    monkeypatch.setattr(transport, "SECRET_S", 600.0)
    web, said = page_with_hands()
    try:
        certificate = str(tmp_path / "leap_rig" / "headset" / "certificate.pem")
        secret = json.dumps({"secret": said[0].rstrip(".")[-8:]})
        picture, hands = page_of(web.address, certificate, pictures="next", hands=secret)
        assert picture == {"picture": False, "hands": True} and hands["drives"]
    finally:
        web.close()


@pytest.mark.hazard(20)
@pytest.mark.long
@pytest.mark.skipif(not shutil.which("chromium"), reason="chromium is not installed")
def test_the_page_shows_images_and_their_age_and_paints_each_eye_its_own_half(ros, wait_until, tmp_path):
    camera = Camera()
    _, address = start_program(ros, wait_until, age_after=4.0, depth_gap=1.0)
    with browser(address, tmp_path, wait_until) as evaluate:

        def shown():
            camera.publish()
            return (
                evaluate(
                    "typeof view !== 'undefined' && view.shown > 3 && document.getElementById('state').textContent"
                )
                == "each eye its own view"
            )

        wait_until(shown, 30.0, "images on the page", poll=0.1)
        assert evaluate("Array.from(pen.getImageData(200, 240, 1, 1).data)")[0] > 150
        sees = evaluate(EYES)
        assert sees["left"] != sees["right"]
        assert [colour[0] > 150 for colour in sees["left"]] == [True, False]
        assert evaluate("navigator.xr !== undefined && isSecureContext")
        age = "document.getElementById('state').textContent.endsWith('s old')"
        wait_until(lambda: evaluate(age), 30.0, "the age", poll=0.1)
    camera.close()


EYES = """(() => {
  const gl = Object.assign(document.createElement("canvas"), {width: 100, height: 100}).getContext("webgl");
  const paint = painter(gl), pixel = new Uint8Array(4), found = {};
  const turn = [1, 0, 0, 0,  0, 1, 0, 0,  0, 0, 1, 0,  0, 0, 0, 1];
  const projection = [1, 0, 0, 0,  0, 1, 0, 0,  0, 0, -1, -1,  0, 0, -0.2, 0];
  paint.load();
  for (const right of [false, true]) {
    gl.clear(gl.COLOR_BUFFER_BIT);
    paint.paint(projection, turn, right);
    found[right ? "right" : "left"] = [47, 53].map(x => {
      gl.readPixels(x, 50, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
      return Array.from(pixel);
    });
  }
  return found;
})()"""
"""What the two eyes see left and right of straight ahead."""
