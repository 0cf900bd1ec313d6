"""The control port: answers, refusals, and what a broken client does to it, in virtual time; and a real one."""

from __future__ import annotations

import errno
import json
import os
import socket
import threading

import pytest

from common import clock
from common.errors import DeviceError
from rig_simulation import control_port
from rig_simulation.control_port import ControlClient, ControlPort, PortClosedError
from simulated.wires import DELAY_S


def refuse():
    raise ValueError("The arm is not stopped.")


def fail():
    return {"x": 1 / 0}


HANDLERS = {
    "state": lambda: {"joints": [0.5, -1.0]},
    "double": lambda value: {"value": 2 * value},
    "refuse": refuse,
    "fail": fail,
}


@pytest.fixture
def port(wires):
    return ControlPort(HANDLERS)


@pytest.fixture
def client(port):
    return ControlClient(port.host, port.port)


@pytest.fixture
def talk(wires):
    """Sends bytes to a port; returns the lines of its answer."""

    def talk(port, data, lines=-1):
        with wires.connect((port.host, port.port)) as s:
            s.sendall(data)
            replies = s.makefile("rb")
            return [json.loads(replies.readline()) for _ in range(lines)] if lines > 0 else replies.read().splitlines()

    return talk


def test_the_port_comes_back_after_the_system_had_no_descriptor(port, client, monkeypatch):
    def refuse(_):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    other = ControlClient(port.host, port.port)
    clock.sleep(DELAY_S)
    with monkeypatch.context() as patch:
        patch.setattr("simulated.wires.Socket.accept", refuse)
        client.ask("state")  # whose connection it waited for before
        with pytest.raises(DeviceError):
            other.ask("state")
    clock.sleep(control_port.RETRY_S)
    assert other.ask("state") == {"joints": [0.5, -1.0]}


def test_the_answer_is_what_the_handler_returns_at_once(client):
    assert client.ask("state") == {"joints": [0.5, -1.0]}
    begin = clock.monotonic()
    assert client.ask("double", value=21) == {"value": 42}
    assert clock.monotonic() - begin == pytest.approx(2.0 * DELAY_S)


@pytest.mark.parametrize(
    ("name", "fields", "word"),
    [
        ("refuse", {}, "stopped"),
        ("nothing", {}, "refuse"),
        ("double", {}, "value"),
        ("double", {"value": 1, "other": 2}, "other"),
        ("fail", {}, "ZeroDivisionError"),
    ],
)
def test_refusals_are_sentences_and_the_port_continues(client, name, fields, word):
    with pytest.raises(DeviceError, match=word):
        client.ask(name, **fields)
    assert client.ask("state")


@pytest.mark.parametrize("line", [b"{", b"[]", b'{"do": 3}', b"\xff\xfe", b'{"do": "double", "value": NaN}', b"{}"])
def test_what_is_no_request_is_refused(port, talk, line):
    (answer,) = talk(port, line + b"\n", 1)
    assert answer["ok"] is False
    assert answer["error"].endswith(".")


@pytest.mark.parametrize(
    "head", [b"POST / HTTP/1.1\r\nHost: x\r\n\r\n", b"GET / HTTP/1.1\r\n", b"\x16\x03\x01\n", b"[]\n"]
)
def test_a_web_page_cannot_hide_a_request_in_its_own(talk, head):
    done = []
    port = ControlPort({"push": lambda: done.append(1)})
    answers = talk(port, head + b'{"do": "push"}\n')
    assert not done and len(answers) == 1 and json.loads(answers[0])["ok"] is False
    ControlClient(port.host, port.port).ask("push")
    assert done


def test_wire_text(wires, port):
    with wires.connect((port.host, port.port)) as s:
        s.sendall(b'{"do": "double", "value": 1.5}\n')
        assert s.recv(100) == b'{"ok": true, "value": 3.0}\n'


def test_torn_and_glued_requests_keep_their_order(wires, port):
    with wires.connect((port.host, port.port)) as s:
        replies = s.makefile("rb")
        s.sendall(b'{"do": "dou')
        clock.sleep(1.0)
        s.sendall(b'ble", "value": 1}\n\n{"do": "double", "value": 2}\n')
        assert [json.loads(replies.readline())["value"] for _ in range(2)] == [2, 4]


def test_a_line_without_end_closes_that_connection_only(port, client, talk):
    (answer,) = talk(port, b"x" * (control_port.MAX_LINE_BYTES + 1), 1)
    assert "longer than" in answer["error"]
    assert client.ask("state")


def test_a_request_that_is_being_answered_ends_before_the_port_does_unless_it_takes_ten_seconds(wires):
    for needs, takes in ((8.0, 8.0), (12.0, 10.0)):
        port = ControlPort({"take_long": lambda needs=needs: clock.sleep(needs)})
        with wires.connect((port.host, port.port)) as s:
            s.sendall(b'{"do": "take_long"}\n')
            clock.sleep(DELAY_S)
            begin = clock.monotonic()
            port.close()
            assert clock.monotonic() - begin == pytest.approx(takes, abs=DELAY_S)


def test_a_silent_port_times_out(wires):
    silent = wires.serve(("127.0.0.1", 0))
    begin = clock.monotonic()
    with pytest.raises(DeviceError):
        ControlClient(*silent.getsockname()).ask("state")
    assert clock.monotonic() - begin == pytest.approx(2.0 + 2.0 * DELAY_S)


STRANGERS = {
    "an echo": (b'{"do": "state"}\n', False, "but a program that sends back what it gets"),
    "bytes without end": (b"H", True, "its first bytes are `HHH"),
}


@pytest.mark.parametrize("name", STRANGERS)
def test_what_is_no_control_port_is_told_with_its_first_bytes_in_time(wires, name):
    sent, again, told = STRANGERS[name]
    listener = wires.serve(("127.0.0.1", 0))

    def talk():
        connection = listener.accept()[0]
        connection.recv(4096)
        connection.sendall(sent)
        while again:
            clock.sleep(0.4)
            connection.sendall(sent)

    clock.Thread(target=talk, daemon=True).start()
    port, began = listener.getsockname()[1], clock.monotonic()
    with pytest.raises(DeviceError) as caught:
        ControlClient("127.0.0.1", port).ask("state")
    assert str(caught.value).startswith(f"What answers at 127.0.0.1:{port} is not the control port of a simulated")
    assert told in str(caught.value) and clock.monotonic() - began < 2.5


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.1", "example.org", ""])
def test_only_loopback(wires, host):
    with pytest.raises(DeviceError, match="loopback"):
        ControlPort({}, host)


@pytest.mark.real
def test_on_real_sockets_many_clients_a_taken_port_its_end_and_its_return():
    results = []

    def ask():
        with ControlClient(port.host, port.port, 60.0) as client:
            results.extend(client.ask("double", value=k)["value"] for k in range(50))

    with ControlPort(HANDLERS) as port, ControlClient(port.host, port.port, 60.0) as client:
        threads = [threading.Thread(target=ask) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(60.0)
        assert sorted(results) == sorted(2 * k for k in range(50) for _ in range(4))
        with pytest.raises(DeviceError):
            ControlPort({}, "127.0.0.1", port.port)
        client.ask("state")
        with socket.create_connection((port.host, port.port), 60.0) as other:
            other.sendall(b"{}\n")
            assert other.recv(4096)
            port.close()
            assert other.recv(1) == b"", "the port ends the connection, whose end the kernel remembers for a minute"
        with pytest.raises(DeviceError):
            client.ask("state")
        with pytest.raises(PortClosedError):
            client.ask("state")
        with ControlPort({"state": lambda: None}, port.host, port.port):
            assert client.ask("state") == {}
