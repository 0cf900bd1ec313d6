"""The control port: answers, refusals, and what a broken client does to it."""

from __future__ import annotations

import json
import socket
import threading

import pytest

from common.errors import DeviceError
from rig_simulation import control_port
from rig_simulation.control_port import ControlClient, ControlPort

pytestmark = pytest.mark.clock


def refuse():
    raise ValueError("The arm is not stopped.")


def fail():
    return {"x": 1 / 0}


@pytest.fixture
def port():
    handlers = {"state": lambda: {"joints": [0.5, -1.0]}, "double": lambda value: {"value": 2 * value}}
    with ControlPort({**handlers, "refuse": refuse, "fail": fail}) as port:
        yield port


@pytest.fixture
def client(port):
    with ControlClient(port.host, port.port, 60.0) as client:
        yield client


def talk(port, data: bytes) -> dict:
    with socket.create_connection((port.host, port.port), 60.0) as s:
        s.sendall(data)
        return json.loads(s.makefile("rb").readline())


def test_the_answer_is_what_the_handler_returns(client):
    assert client.ask("state") == {"joints": [0.5, -1.0]}
    assert client.ask("double", value=21) == {"value": 42}


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
def test_what_is_no_request_is_refused(port, line):
    answer = talk(port, line + b"\n")
    assert answer["ok"] is False
    assert answer["error"].endswith(".")


@pytest.mark.parametrize(
    "head", [b"POST / HTTP/1.1\r\nHost: x\r\n\r\n", b"GET / HTTP/1.1\r\n", b"\x16\x03\x01\n", b"[]\n"]
)
def test_a_web_page_cannot_hide_a_request_in_its_own(head):
    done = []
    with ControlPort({"push": lambda: done.append(1)}) as port:
        with socket.create_connection((port.host, port.port), 60.0) as s:
            s.sendall(head + b'{"do": "push"}\n')
            answers = s.makefile("rb").read().splitlines()
        assert not done and len(answers) == 1 and json.loads(answers[0])["ok"] is False
        with ControlClient(port.host, port.port, 60.0) as client:
            client.ask("push")
    assert done


def test_wire_text(port):
    with socket.create_connection((port.host, port.port), 60.0) as s:
        s.sendall(b'{"do": "double", "value": 1.5}\n')
        assert s.recv(100) == b'{"ok": true, "value": 3.0}\n'


def test_torn_and_glued_requests_keep_their_order(port):
    with socket.create_connection((port.host, port.port), 60.0) as s:
        replies = s.makefile("rb")
        s.sendall(b'{"do": "dou')
        s.sendall(b'ble", "value": 1}\n\n{"do": "double", "value": 2}\n')
        assert [json.loads(replies.readline())["value"] for _ in range(2)] == [2, 4]


def test_a_line_without_end_closes_that_connection_only(port, client):
    answer = talk(port, b"x" * (control_port.MAX_LINE_BYTES + 1))
    assert "longer than" in answer["error"]
    assert client.ask("state")


def test_many_clients_at_once(port):
    def ask():
        with ControlClient(port.host, port.port, 60.0) as client:
            results.extend(client.ask("double", value=k)["value"] for k in range(50))

    results = []
    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30.0)
    assert sorted(results) == sorted(2 * k for k in range(50) for _ in range(4))


def test_the_client_comes_back_after_the_port_did(port):
    client = ControlClient(port.host, port.port, 60.0)
    client.ask("state")
    port.close()
    with pytest.raises(DeviceError):
        client.ask("state")
    with ControlPort({"state": lambda: None}, port.host, port.port):
        assert client.ask("state") == {}
    client.close()


def test_a_request_that_is_being_answered_ends_before_the_port_does():
    begun, go_on, ended = threading.Event(), threading.Event(), threading.Event()

    def take_long():
        begun.set()
        go_on.wait(30.0)
        ended.set()

    with ControlPort({"take_long": take_long}) as port, socket.create_connection((port.host, port.port), 30.0) as s:
        s.sendall(b'{"do": "take_long"}\n')
        assert begun.wait(30.0)
        threading.Timer(0.3, go_on.set).start()
        port.close()
        assert ended.is_set()


def test_a_silent_port_times_out():
    with socket.create_server(("127.0.0.1", 0)) as silent:
        client = ControlClient("127.0.0.1", silent.getsockname()[1], 0.1)
        with pytest.raises(DeviceError):
            client.ask("state")


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.1", "example.org", ""])
def test_only_loopback(host):
    with pytest.raises(DeviceError, match="loopback"):
        ControlPort({}, host)


def test_a_port_in_use_is_one_sentence(port):
    with pytest.raises(DeviceError):
        ControlPort({}, "127.0.0.1", port.port)
