"""The relay between a browser and pages of the rig, over sockets."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import json
import math
import os
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from leap_motion.service.certificate import own_certificate
from leap_rig.cockpit.server import CockpitServer, ScenePage
from leap_rig.relay import greeting, server, transport
from leap_rig.relay.client import PagePort, RelayClient
from leap_rig.relay.greeting import NONCE, RUN
from leap_rig.relay.server import VISITORS_OF_ADDRESS, Relay, forwarded_for

pytestmark = pytest.mark.real

KEY = b"the key of relay and rig, 32 bytes"
PUBLIC = "https://cockpit.example.org"


def until(condition):
    deadline = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


class Cockpit:
    """The cockpit's server, whose page may be asked for by the public address too."""

    def __init__(self, folder, certificate=None):
        self.obeyed, self.stops, self.said = [], [], []
        page = folder / "page.html"
        page.write_text("the page" * 10_000)
        scene = ScenePage(b"the scene", ("127.0.0.1", 1))
        self.server = CockpitServer(
            page, scene, ("",), self.obeyed.append, lambda: self.stops.append(1), self.said.append, public=PUBLIC,
            certificate=certificate,
        )  # fmt: skip
        self.server.control.fresh_s = math.inf  # these pages tell nothing that they heard
        self.port = int(self.server.address.split(":")[2].rstrip("/"))

    @property
    def code(self):
        return self.said[-1].split()[-1].rstrip(".")


class Rig:
    """The rig's side of the relay in a thread."""

    def __init__(self, url, pages, key=KEY):
        self.said, self.loop = [], asyncio.new_event_loop()
        self._task = self.loop.create_task(RelayClient(url, key, pages, self.said.append).run())
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        with contextlib.suppress(asyncio.CancelledError):
            self.loop.run_until_complete(self._task)
        self.loop.close()

    def close(self):
        with contextlib.suppress(RuntimeError):
            self.loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join(10.0)
        assert not self._thread.is_alive()


class Running:
    """A relay in a thread."""

    def __init__(self, pages, port=0, forwarded=False):
        self.said = []
        self.relay = Relay(KEY, pages, self.said.append, port=port, forwarded=forwarded)
        self.url = f"ws://127.0.0.1:{self.relay.port}/rig"
        self._thread = threading.Thread(target=self.relay.run, daemon=True)
        self._thread.start()

    def close(self):
        self.relay.stop()
        self._thread.join(10.0)
        assert not self._thread.is_alive()


@pytest.fixture()
def ends():
    """What ends with the test, last first."""
    with contextlib.ExitStack() as stack:
        yield lambda thing: (stack.callback(thing.close), thing)[1]


@pytest.fixture()
def afar(ends, tmp_path):
    """Relay, rig and cockpit; returns the cockpit and the relay's port for its page."""
    cockpit = Cockpit(tmp_path)
    ends(cockpit.server)
    relay = ends(Running({"cockpit": 0}))
    ends(Rig(relay.url, {"cockpit": PagePort(cockpit.port)}))
    return cockpit, relay.relay.pages["cockpit"]


def get(port, path="/", host="cockpit.example.org"):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30.0)
    connection.request("GET", path, headers={"Host": host})
    response = connection.getresponse()
    return response.status, response.read()


@contextlib.contextmanager
def page(port, path, origin=PUBLIC):
    with socket.create_connection(("127.0.0.1", port), 30.0) as raw, connect(
        f"ws://cockpit.example.org{path}", sock=raw, origin=origin, open_timeout=30.0
    ) as opened:
        yield opened


def tell(opened, **message):
    opened.send(json.dumps(message))


def answer(opened):
    while "heard" in (message := json.loads(opened.recv(timeout=60.0))):
        pass
    return message


def test_a_page_comes_through_and_commands_the_rig_with_the_code(afar):
    cockpit, port = afar
    assert get(port) == (200, b"the page" * 10_000)
    with page(port, "/state") as state, page(port, "/control") as control:
        cockpit.server.put_state({"mode": "home"})
        until(lambda: answer(state).get("mode") == "home")
        tell(control, do="take")
        assert "code" in answer(control)["refused"]
        tell(control, do="secret", value=cockpit.code)
        assert answer(control)["key"]
        tell(control, do="take")
        assert answer(control)["control"]
        tell(control, do="beat", focus=True, held={})
        tell(control, do="gripper", arm="", value=True)
        until(lambda: cockpit.obeyed)
        tell(control, do="stop")
        assert "sent" in answer(control)["done"]
        assert cockpit.stops
    until(lambda: cockpit.server.control.controller is None)  # the page is gone, and the rig sees it


def test_the_public_address_admits_its_own_page_alone(afar):
    cockpit, port = afar
    assert get(port, host="evil.example.org")[0] == 403
    with pytest.raises(InvalidStatus), page(port, "/control", "https://evil.example.org"):
        pass
    assert get(cockpit.port, host=f"127.0.0.1:{cockpit.port}")[0] == 200


def test_wrong_codes_from_afar_let_nobody_here_wait(afar):
    cockpit, port = afar
    with page(port, "/control") as stranger:
        for _ in range(2):
            tell(stranger, do="secret", value="no code")
            assert answer(stranger)["refused"]
    with connect(f"ws://127.0.0.1:{cockpit.port}/control") as here:
        tell(here, do="secret", value=cockpit.code)
        assert answer(here)["key"]


def test_a_large_connection_passes_both_ways_unchanged(ends):
    """More than all buffers hold, so that each side has to wait for the other."""
    listener = ends(socket.create_server(("127.0.0.1", 0)))
    relay = ends(Running({"page": 0}))
    ends(Rig(relay.url, {"page": PagePort(listener.getsockname()[1])}))
    sent = os.urandom(5 * 2**20)

    def echo():
        accepted, _ = listener.accept()
        with accepted, accepted.makefile("rb") as whole:
            accepted.sendall(whole.read()[::-1])

    threading.Thread(target=echo, daemon=True).start()
    with socket.create_connection(("127.0.0.1", relay.relay.pages["page"]), 30.0) as browser:
        browser.sendall(sent)
        browser.shutdown(socket.SHUT_WR)
        received = b"".join(iter(lambda: browser.recv(2**16), b""))
    assert received == sent[::-1]


@pytest.mark.skipif(not shutil.which("openssl"), reason="openssl is not installed")
@pytest.mark.parametrize("ends_at_the_rig", [True, False])
def test_tls_ends_at_the_rig_or_before_the_relay(ends, tmp_path, ends_at_the_rig):
    cockpit = Cockpit(tmp_path, own_certificate(tmp_path))
    ends(cockpit.server)
    relay = ends(Running({"cockpit": 0}))
    rig = ends(Rig(relay.url, {"cockpit": PagePort(cockpit.port, tls=not ends_at_the_rig)}))
    port = relay.relay.pages["cockpit"]
    if ends_at_the_rig:
        tls = ssl.create_default_context(cafile=str(tmp_path / "certificate.pem"))
        connection = http.client.HTTPSConnection("localhost", port, timeout=30.0, context=tls)
        connection.request("GET", "/", headers={"Host": "cockpit.example.org"})
        assert connection.getresponse().read() == b"the page" * 10_000
    else:
        assert get(port) == (200, b"the page" * 10_000)
    assert rig.said == ["The relay is reached."]


def test_a_browser_that_takes_nothing_is_let_go(ends, monkeypatch):
    monkeypatch.setattr(transport, "TAKE_S", 0.3)
    listener = ends(socket.create_server(("127.0.0.1", 0)))
    relay = ends(Running({"page": 0}))
    ends(Rig(relay.url, {"page": PagePort(listener.getsockname()[1])}))
    with socket.create_connection(("127.0.0.1", relay.relay.pages["page"]), 30.0):
        accepted, _ = listener.accept()
        accepted.settimeout(30.0)
        with accepted, pytest.raises((BrokenPipeError, ConnectionResetError)):
            while True:
                accepted.sendall(bytes(2**16))


def test_what_a_page_holds_is_let_go_where_the_relay_dies(ends, tmp_path):
    cockpit = Cockpit(tmp_path)
    ends(cockpit.server)
    relay = ends(Running({"cockpit": 0}))
    ends(Rig(relay.url, {"cockpit": PagePort(cockpit.port)}))
    with page(relay.relay.pages["cockpit"], "/control") as control:
        tell(control, do="secret", value=cockpit.code)
        assert answer(control)["key"]
        tell(control, do="take")
        tell(control, do="beat", focus=True, held={"": []})

        def enables():
            tell(control, do="beat", focus=True, held={"": ["enable"]})
            return cockpit.server.held()[""].enable

        until(enables)
        relay.close()
    until(lambda: not cockpit.server.held()[""].enable and cockpit.server.control.controller is None)


def test_another_key_opens_nothing(ends):
    relay = ends(Running({"page": 0}))
    rig = ends(Rig(relay.url, {"page": PagePort(1)}, b"another key" * 4))
    until(lambda: any("key" in text for text in rig.said) and any("another key" in text for text in relay.said))
    assert relay.relay._sockets_of_run == 0


def test_a_false_relay_gets_no_connection(ends):
    """It has the rig's own answer, and sends that back."""
    from websockets.sync.server import serve

    heard = []

    def impostor(connection):
        connection.send(greeting.challenge(bytes(NONCE)))
        mac = connection.recv()[-greeting.MAC :]
        connection.send(mac)
        with contextlib.suppress(ConnectionClosed):
            connection.send(greeting.opening(b"abc", "page"))
            heard.append(connection.recv(timeout=30.0))

    with serve(impostor, "127.0.0.1", 0) as false:
        threading.Thread(target=false.serve_forever, daemon=True).start()
        listener = ends(socket.create_server(("127.0.0.1", 0)))
        listener.settimeout(0.0)
        port = false.socket.getsockname()[1]
        rig = ends(Rig(f"ws://127.0.0.1:{port}/rig", {"page": PagePort(listener.getsockname()[1])}))
        until(lambda: any("another key" in text for text in rig.said))
        false.shutdown()
    assert not heard
    with pytest.raises(BlockingIOError):
        listener.accept()


def greeted(url, run):
    """Returns a WebSocket of a rig that has the key."""
    rig = connect(url, open_timeout=30.0, close_timeout=0.5)
    sent, due = greeting.answer(KEY, rig.recv(timeout=30.0), run, bytes(NONCE))
    rig.send(sent)
    greeting.check_proof(rig.recv(timeout=30.0), due)
    return rig


def test_a_relay_has_one_rig_at_a_time(ends):
    relay = ends(Running({"page": 0}))
    first = ends(greeted(relay.url, b"1" * RUN))
    with pytest.raises(ConnectionClosed, match="another rig"):
        greeted(relay.url, b"2" * RUN).recv(timeout=30.0)
    first.close()
    until(lambda: any("No rig" in text for text in relay.said))
    ends(greeted(relay.url, b"2" * RUN))


def test_a_browser_or_a_stranger_is_no_rig(ends, monkeypatch):
    monkeypatch.setattr(server, "GREET_S", 0.3)
    relay = ends(Running({"page": 0}))
    with pytest.raises(InvalidStatus):
        connect(relay.url, origin="https://evil.example.org")
    with pytest.raises(InvalidStatus):
        connect(relay.url.replace("/rig", "/"))
    for message in ("text", b"", b"x" * 80):
        with connect(relay.url) as stranger, pytest.raises(ConnectionClosed):
            stranger.recv(timeout=30.0)
            stranger.send(message)
            stranger.recv(timeout=30.0)
    with connect(relay.url) as silent, pytest.raises(ConnectionClosed):
        silent.recv(timeout=30.0)
        silent.recv(timeout=30.0)


def test_text_from_the_rig_ends_the_connection(ends):
    relay = ends(Running({"page": 0}))
    rig = ends(greeted(relay.url, b"1" * RUN))
    with socket.create_connection(("127.0.0.1", relay.relay.pages["page"]), 30.0) as browser:
        assert greeting.read_opening(rig.recv(timeout=30.0)).page == "page"
        rig.send("text")
        assert browser.recv(100) == b""


def test_a_browser_without_a_rig_is_let_go(ends, monkeypatch):
    monkeypatch.setattr(server, "NO_RIG_S", 0.2)
    relay = ends(Running({"page": 0}))
    with socket.create_connection(("127.0.0.1", relay.relay.pages["page"]), 30.0) as browser:
        assert browser.recv(100) == b""


def test_browsers_are_few_and_come_in_moderation(ends, monkeypatch):
    monkeypatch.setattr(server, "NO_RIG_S", 30.0)
    monkeypatch.setattr(server, "MAX_VISITORS", 3)
    relay = ends(Running({"page": 0}))
    port = relay.relay.pages["page"]
    with contextlib.ExitStack() as stack:
        waiting = [stack.enter_context(socket.create_connection(("127.0.0.1", port), 30.0)) for _ in range(3)]
        one_too_many = stack.enter_context(socket.create_connection(("127.0.0.1", port), 30.0))
        with contextlib.suppress(ConnectionResetError):
            assert one_too_many.recv(100) == b""
        waiting[0].settimeout(0.1)
        with pytest.raises(socket.timeout):
            waiting[0].recv(100)


def behind_a_proxy(ends, tmp_path):
    """As `afar`, with a proxy that names the browsers."""
    cockpit = Cockpit(tmp_path)
    ends(cockpit.server)
    relay = ends(Running({"cockpit": 0, "other": 0}, forwarded=True))
    ends(Rig(relay.url, {"cockpit": PagePort(cockpit.port)}))
    return cockpit, relay.relay.pages


@contextlib.contextmanager
def named(port, path, names):
    """A WebSocket as the proxy passes it on; `names`: what it and the browser wrote into X-Forwarded-For."""
    with socket.create_connection(("127.0.0.1", port), 30.0) as raw, connect(
        f"ws://cockpit.example.org{path}", sock=raw, origin=PUBLIC, open_timeout=30.0, close_timeout=0.5,
        additional_headers=[("X-Forwarded-For", names)],
    ) as opened:  # fmt: skip
        yield opened


def visiting(ends, port, name=""):
    """A browser's connection, which the proxy says is from `name`."""
    browser = ends(socket.create_connection(("127.0.0.1", port), 60.0))
    browser.sendall(f"GET / HTTP/1.1\r\nX-Forwarded-For: 10.9.9.9, {name}\r\n\r\n".encode())
    return browser


def ended(browser):
    """Waits for the end of a connection."""
    with contextlib.suppress(ConnectionResetError):
        return browser.recv(1) == b""
    return True


def waits(browser):
    """Whether a connection is still open."""
    browser.settimeout(0.0)
    with pytest.raises(BlockingIOError):
        browser.recv(1)
    return True


def test_one_browser_behind_a_proxy_takes_not_the_places_of_others(ends, monkeypatch):
    monkeypatch.setattr(server, "NO_RIG_S", 60.0)
    page, other = ends(Running({"page": 0, "other": 0}, forwarded=True)).relay.pages.values()
    crowd = [visiting(ends, page, "10.0.0.1") for _ in range(VISITORS_OF_ADDRESS)]
    for name in ("10.0.0.1", "::ffff:10.0.0.1"):
        assert ended(visiting(ends, page, name))
    rest = [visiting(ends, page, "10.0.0.2"), visiting(ends, other, "10.0.0.1")]
    assert ended(visiting(ends, page, "10.0.0.1")) and all(map(waits, crowd + rest))


def test_the_address_that_the_proxy_names_may_come_in_pieces(ends, monkeypatch):
    monkeypatch.setattr(server, "NO_RIG_S", 90.0)
    monkeypatch.setattr(server, "GREET_S", 60.0)
    monkeypatch.setattr(server, "VISITORS_OF_ADDRESS", 1)
    (page,) = ends(Running({"page": 0}, forwarded=True)).relay.pages.values()
    first = visiting(ends, page, "10.0.0.1")
    second = ends(socket.create_connection(("127.0.0.1", page), 60.0))
    for piece in (b"GET / HTTP/1.1\r\n", b"X-Forwarded-For: 10.0.0.1\r", b"\n\r\n"):
        second.sendall(piece)
        time.sleep(0.2)
    assert ended(second) and waits(first)


def test_each_page_of_a_relay_has_its_own_places(ends, monkeypatch):
    monkeypatch.setattr(server, "NO_RIG_S", 60.0)
    monkeypatch.setattr(server, "MAX_VISITORS", 2)
    page, other = ends(Running({"page": 0, "other": 0})).relay.pages.values()
    first, _, third = (visiting(ends, page) for _ in range(3))
    elsewhere = visiting(ends, other)
    assert ended(third) and waits(first) and waits(elsewhere)


def test_wrong_codes_of_a_browser_behind_a_proxy_let_no_other_one_wait(ends, tmp_path):
    cockpit, pages = behind_a_proxy(ends, tmp_path)
    with named(pages["cockpit"], "/control", "203.0.113.5") as stranger:
        for _ in range(2):
            tell(stranger, do="secret", value="no code")
            assert answer(stranger)["refused"]
    with named(pages["cockpit"], "/control", "203.0.113.5, 203.0.113.6") as other:
        tell(other, do="secret", value=cockpit.code)
        assert answer(other)["key"]


@pytest.mark.parametrize(
    ("request_", "address"),
    [
        (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", ""),
        (b"GET / HTTP/1.1\r\nx-forwarded-for:10.0.0.1\r\n\r\n", "10.0.0.1"),
        (b"GET / HTTP/1.1\r\nX-Forwarded-For: evil, 10.0.0.1, 2001:db8::1 \r\n\r\n", "2001:db8::1"),
        (b"GET / HTTP/1.1\r\nX-Forwarded-For: 10.0.0.1\r\nX-Forwarded-For: 10.0.0.2\r\n\r\n", "10.0.0.2"),
        (b"GET / HTTP/1.1\r\nX-Forwarded-For: 10.0.0.1, evil\r\n\r\n", ""),
        (b"GET / HTTP/1.1\r\nX-Forwarded-For: \xff\r\n\r\n", ""),
        (b"GET / HTTP/1.1\r\n\r\nX-Forwarded-For: 10.0.0.1\r\n", ""),
        (b"", ""),
    ],
)
def test_what_the_proxy_wrote_last_names_the_browser(request_, address):
    assert forwarded_for(request_) == address


def test_strangers_at_the_rigs_door_keep_no_rig_out_and_cut_none_off(ends, monkeypatch):
    monkeypatch.setattr(server, "MAX_RIG_SOCKETS", 8)
    monkeypatch.setattr(server, "GREET_S", 60.0)
    relay = ends(Running({"page": 0}))
    with contextlib.ExitStack() as stack:
        for _ in range(2):
            for _ in range(8):
                stack.enter_context(socket.create_connection(("127.0.0.1", relay.relay.port), 30.0))
            rig = ends(greeted(relay.url, b"1" * RUN))
        for _ in range(8):
            stack.enter_context(socket.create_connection(("127.0.0.1", relay.relay.port), 30.0))
        browser = stack.enter_context(socket.create_connection(("127.0.0.1", relay.relay.pages["page"]), 30.0))
        second = stack.enter_context(socket.create_connection(("127.0.0.1", relay.relay.pages["page"]), 30.0))
        assert greeting.read_opening(rig.recv(timeout=30.0)).page == "page" and browser and second


def test_the_rig_comes_back_to_a_relay_that_was_away(ends, tmp_path, free_port):
    cockpit, port = Cockpit(tmp_path), free_port()
    ends(cockpit.server)
    rig = ends(Rig(f"ws://127.0.0.1:{port}/rig", {"cockpit": PagePort(cockpit.port)}))
    until(lambda: any("not reached" in text for text in rig.said))
    first = Running({"cockpit": 0}, port)
    assert get(first.relay.pages["cockpit"])[0] == 200
    first.close()
    second = ends(Running({"cockpit": 0}, port))
    until(lambda: second.said)
    assert get(second.relay.pages["cockpit"])[0] == 200


def test_a_page_that_the_rig_does_not_serve_ends_at_once(ends):
    relay = ends(Running({"page": 0, "other": 0}))
    rig = ends(Rig(relay.url, {"page": PagePort(1)}))
    for name in ("page", "other"):
        with socket.create_connection(("127.0.0.1", relay.relay.pages[name]), 30.0) as browser:
            assert browser.recv(100) == b""
    assert any("not reached" in text for text in rig.said) and any("does not serve" in text for text in rig.said)


class TestProgram:
    def run(self, *arguments):
        command = [sys.executable, "-c", "from leap_rig.relay.command_line import main; main()", *arguments]
        return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)

    def key(self, folder, mode=0o600, text="0123456789abcdef" * 4):
        path = folder / "relay.key"
        path.write_text(text)
        path.chmod(mode)
        return str(path)

    def refused(self, *arguments):
        process = self.run(*arguments)
        _, said = process.communicate(timeout=60.0)
        assert process.returncode == 1
        return said

    def test_serves_and_connects_until_it_is_interrupted(self, tmp_path, free_port):
        key, port = self.key(tmp_path), str(free_port())
        relay = self.run("serve", "--key", key, "--port", port, "--page", "page=0")
        assert f":{port}" in relay.stderr.readline()
        rig = self.run("connect", f"ws://127.0.0.1:{port}/rig", "--key", key, "--page", "page=1")
        assert "connected" in relay.stderr.readline()
        for process in (rig, relay):
            process.send_signal(signal.SIGINT)
            assert "Traceback" not in process.communicate(timeout=60.0)[1]
            assert process.returncode == 0

    def test_refuses_keys_that_others_may_read_and_links_that_are_not_encrypted(self, tmp_path):
        page = ("--page", "page=1")
        assert "Others may read" in self.refused("serve", "--key", self.key(tmp_path, 0o640), *page)
        assert "characters" in self.refused("serve", "--key", self.key(tmp_path, text="short"), *page)
        assert "more than 1024 characters" in self.refused("serve", "--key", self.key(tmp_path, text="x" * 1025), *page)
        os.mkfifo(tmp_path / "pipe", 0o600)
        for no_file in (str(tmp_path / "pipe"), "/dev/zero"):
            assert "is no regular file" in self.refused("serve", "--key", no_file, *page)
        assert "cannot be read: Is a directory" in self.refused("serve", "--key", str(tmp_path), *page)
        assert "cannot be read" in self.refused("serve", "--key", str(tmp_path / "none"), *page)
        key = self.key(tmp_path)
        assert "wss" in self.refused("connect", "ws://192.0.2.1/rig", "--key", key, *page)
        assert "no address" in self.refused("connect", "https://192.0.2.1/rig", "--key", key, *page)
        forwarded = self.refused("serve", "--key", key, *page, "--forwarded", "--host", "0.0.0.0")
        assert "--forwarded needs --host 127.0.0.1" in forwarded
        assert "no page" in self.refused("serve", "--key", key, "--page", "Page=1")

    def test_needs_neither_ros_nor_numpy(self):
        code = "import sys; from leap_rig.relay import command_line; print(*sys.modules)"
        loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
        assert "websockets" in loaded and not {"numpy", "rospy", "yaml"} & set(loaded)
