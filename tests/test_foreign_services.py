"""Something else answers where a device is expected: servers by devices, each told as what it is by its first bytes."""

from __future__ import annotations

from pathlib import Path

import pytest

from common import clock
from kst import ForeignServer, KstClient, KstError, NoServer, ServerBusy
from kst.stranger import stranger
from leap_motion.client import LeapClient, LeapLink
from reflex.client import ReflexHand
from reflex.codec import STATE_BYTES, encode_mode
from reflex.errors import HandSilent
from simulated.hand_wire import HandNetwork

SRC = Path(__file__).parents[1] / "src"
PATIENCE_S = 8.0  # of the slowest client


def answering(answer, ends=True):
    """A server that sends an answer to the first bytes that it gets."""

    def talk(connection):
        connection.recv(4096)
        connection.sendall(answer)
        while not ends and connection.recv(4096):
            pass

    return talk


def echo(connection):
    while data := connection.recv(4096):
        connection.sendall(data)


def banner(connection):
    connection.sendall(b"SSH-2.0-OpenSSH_9.6\r\n")
    connection.recv(4096)


def padded(connection):
    """The toolbox, with a NUL behind each answer."""
    while connection.recv(4096):
        connection.sendall(b"done\0\n")


def endless(bytes_):
    def talk(connection):
        while True:
            connection.sendall(bytes_)
            clock.sleep(1e-3)

    return talk


def silent(connection):
    while connection.recv(4096):
        pass


STRANGERS = {
    "an echo server": (echo, "a program that sends back what it gets", ""),
    "a web server": (answering(b"HTTP/1.0 404 Not Found\r\n\r\n"), "a web server", "`HTTP/1.0 404 Not Found\\r\\n"),
    "a web server that upgrades anything": (
        answering(
            b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Accept: abc=\r\n\r\n"
        ),
        "a web server",
        "`HTTP/1.1 101 Switching",
    ),
    "a page": (answering(b"<!DOCTYPE HTML>\n<html>\n"), "a web server", "`<!DOCTYPE HTML>"),
    "an SSH server": (banner, "an SSH server", "`SSH-2.0-OpenSSH_9.6"),
    "a padded dialect": (padded, "", "`done\\x00\\n"),
    "no line end": (answering(b"ready", ends=False), "", "`ready`"),
    "a TLS alert": (answering(b"\x15\x03\x01\0\2\2F"), "a service with TLS", "`\\x15\\x03\\x01\\x00\\x02\\x02F`"),
    "endless bytes": (endless(b"\xff" * 4096), "", "`\\xff\\xff"),
    "endless lines": (endless(b"hello\n" * 5), "", "`hello\\nhello"),
}
TELLS_NOTHING = {"silence": silent, "an end without a word": lambda connection: None}


@pytest.fixture
def serve(wires):
    """Starts a server for any number of connections; returns its port."""

    def serve(talk):
        listener = wires.serve(("127.0.0.1", 0))

        def converse(connection):
            try:
                with connection:
                    talk(connection)
            except OSError:  # the client is gone
                pass

        def accept():
            while True:
                clock.Thread(target=converse, args=(listener.accept()[0],), daemon=True).start()

        clock.Thread(target=accept, daemon=True).start()
        return listener.getsockname()[1]

    return serve


def arm(port):
    with pytest.raises(KstError) as caught:
        KstClient.connect("127.0.0.1", port)
    return caught.value, str(caught.value)


def tracker(port, **options):
    client = LeapClient(port=port, runtime=clock, **options)
    deadline = clock.monotonic() + PATIENCE_S
    while client.status.link is LeapLink.CONNECTING and clock.monotonic() < deadline:
        clock.sleep(0.01)
    status = client.status
    client.close()
    return status.link, status.sentence


def secure_tracker(port):
    return tracker(port, code="abc", fingerprint="0" * 64)


@pytest.mark.parametrize("device", [arm, tracker, secure_tracker])
@pytest.mark.parametrize("name", STRANGERS)
def test_a_stranger_is_told_with_its_first_bytes(serve, device, name):
    talk, kind, first = STRANGERS[name]
    if device is secure_tracker and name == "a TLS alert":
        talk, kind, first = answering(b"HTTP/1.1 400 Bad Request\r\n\r\n"), "a web server", "`HTTP/1.1 400"
    began, port = clock.monotonic(), serve(talk)
    fault, sentence = device(port)
    assert fault is LeapLink.REFUSED if device is not arm else isinstance(fault, ForeignServer)
    assert f"at 127.0.0.1:{port} is not " in sentence and first in sentence
    assert f"{f' but {kind}' if kind else ''}: its first bytes are `" in sentence
    assert not any(word in sentence for word in ("silent", "just ended", "busy", "No Leap service"))
    assert clock.monotonic() - began < PATIENCE_S


@pytest.mark.parametrize("name", TELLS_NOTHING)
def test_who_says_nothing_is_no_stranger(serve, name):
    port = serve(TELLS_NOTHING[name])
    error, sentence = arm(port)
    assert isinstance(error, ServerBusy if name == "silence" else NoServer) and "is not" not in sentence
    for device in (tracker, secure_tracker):
        link, sentence = device(port)
        assert link is LeapLink.NO_SERVICE and "is not" not in sentence
        assert ("without a word" in sentence) is (name != "silence" and device is tracker)


@pytest.mark.parametrize("text", ["hello", "[1]", '{"event":{}}', '{"version":6}\0'])
def test_a_websocket_that_is_not_the_trackers_says_so_with_its_first_message(wires, text):
    from simulated.leap_wire import LeapWire

    with LeapWire() as wire:
        service = wire.serve(lambda service, connection: (connection.send(text), service.ended.wait()))
        link, sentence = tracker(service.port)
    shown = text.replace("\0", "\\x00")
    assert link is LeapLink.REFUSED and f"is not a Leap service: its first bytes are `{shown}`" in sentence


STRANGE_PACKETS = {
    "HTTP/1.1 200 OK": "a web server",
    "hello": "",
    "\1\0\0": "",
    "\1" + "\0" * STATE_BYTES: "",
}


@pytest.mark.parametrize("data", STRANGE_PACKETS)
def test_what_is_no_hand_on_its_port_is_told_in_place_of_its_silence(wires, data, tmp_path):
    notes = []
    with HandNetwork() as network:
        link = network.link("lo", 11333)
        hand = ReflexHand("lo", runtime=clock, on_note=notes.append)
        assert "What answers" not in hand.diagnosis()[1]
        hand.connect()
        for _ in range(30):
            link.send(data.encode("latin-1"))
            clock.sleep(0.1)
        told = "What answers at 10.99.99.99:11333 is not the hand"
        level, sentence, _ = hand.diagnosis()
        assert level == "error" and told in sentence and STRANGE_PACKETS[data] in sentence
        with pytest.raises(HandSilent, match="What answers at"):
            hand.wait_for_packet(0.1)
        assert any(note.text.startswith("No packet") and told in note.text for note in notes)
        clock.sleep(6.0)
        assert "What answers" not in hand.diagnosis()[1], "that was long ago"
        link.send(encode_mode(2))
        clock.sleep(0.1)
        assert "sends commands to the hand" in hand.diagnosis()[1], "an echo, or another host"
        hand.disconnect()


def test_every_device_has_the_same_words():
    """By copies: pip of Ubuntu 20.04 and an sdist take a library's folder alone, where a link would lead nowhere."""
    packages = ("kst", "leap_motion", "reflex")
    files = [SRC / f"modules/{package}/src/{package}/stranger.py" for package in packages]
    assert not any(file.is_symlink() for file in files) and len({file.read_text() for file in files}) == 1
    long = stranger("a:1", "it", b"SSH-2.0" + bytes(100))
    assert long.startswith("what answers at a:1 is not it but an SSH server: its first bytes are `SSH-2.0\\x00")
    assert long.endswith("\\x00…`")
