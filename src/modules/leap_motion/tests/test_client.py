"""Client against a service on a free port of loopback that keeps, or breaks, the protocol."""

import contextlib
import json
import re
import socket
import threading
import time

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import serve
from websockets.utils import accept_key

from leap_motion import client as client_module
from leap_motion import transport
from leap_motion.client import LeapClient, LeapLink

pytestmark = pytest.mark.clock

LONG_S = 60.0
WAITS = ((transport, "OPEN_TIMEOUT_S"), (client_module, "HEADER_TIMEOUT_S"), (client_module, "PING_S"))
"""Waits of the client: service and client may get no processor for long, which is no fault of the service."""

HEADER = '{"version":6,"serviceVersion":"2.3.1+33747"}'
POLICIES = ['{"background":true}', '{"optimizeHMD":false}', '{"focused":true}']
"""UltraleapTrackingWebSocket takes these texts, below 32 characters, only as they are."""


def frame(number, **fields):
    return json.dumps({"id": number, "timestamp": number * 8650, "hands": [], "pointables": [], **fields})


class Service:
    """Runs one function per connection, the last one again for all later ones; notes what clients sent."""

    def __init__(self, *conversations):
        self._conversations = list(conversations)
        self.heard = []
        self.paths = []
        self.ended = threading.Event()
        self._server = serve(self._handle, "127.0.0.1", 0)
        self.port = self._server.socket.getsockname()[1]
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def _handle(self, connection):
        self.paths.append(connection.request.path)
        talk = self._conversations.pop(0) if len(self._conversations) > 1 else self._conversations[0]
        with contextlib.suppress(ConnectionClosed):
            talk(self, connection)

    def listen(self, connection, count=3):
        """Receives the client's policy messages."""
        self.heard += [connection.recv(LONG_S) for _ in range(count)]

    def stay(self, connection):
        """Says nothing until the client goes or the test ends."""
        with contextlib.suppress(TimeoutError):
            while not self.ended.is_set():
                with contextlib.suppress(TimeoutError):
                    connection.recv(0.1)

    def close(self):
        self.ended.set()
        self._server.shutdown()


@pytest.fixture
def start(monkeypatch):
    """Starts a service and a client of it; both end with the test."""
    monkeypatch.setattr(client_module, "RETRY_S", 0.05)
    for module, name in WAITS:
        monkeypatch.setattr(module, name, LONG_S)
    ends = []

    def start(*conversations, **options):
        service = Service(*conversations)
        client = LeapClient(port=service.port, **options)
        ends.extend([client.close, service.close])
        return service, client

    yield start
    for end in ends:
        end()


def greet(service, connection):
    connection.send(HEADER)
    service.listen(connection)


def stream(*texts):
    """A conversation that keeps the protocol, sends the texts and stays."""

    def talk(service, connection):
        greet(service, connection)
        for text in texts:
            connection.send(text)
        service.stay(connection)

    return talk


def test_frames_arrive_with_the_stamp_of_their_receipt(start):
    stamps = iter(range(100, 200))
    service, client = start(stream(frame(1)), clock=lambda: next(stamps))
    received = client.next_frame(LONG_S)
    assert (received.frame.id, received.stamp) == (1, 100)
    assert client.status.link in (LeapLink.STREAMING, LeapLink.SILENT)
    assert client.status.service == "2.3.1+33747"
    assert service.paths == ["/v6.json"]


def test_policy_messages_are_compact_and_in_order(start, wait_until):
    service, _client = start(stream())
    wait_until(lambda: len(service.heard) == 3, 10.0, "the policy messages")
    assert service.heard == POLICIES


def test_reconnects_and_sends_the_policy_messages_again(start, wait_until):
    def ends(service, connection):
        greet(service, connection)
        connection.send(frame(1))
        connection.close(1001)

    service, client = start(ends, stream(frame(2)))
    wait_until(lambda: client.next_frame(0.2) and client.counts.connections == 2, 10.0, "the second connection")
    assert service.heard == POLICIES * 2


@pytest.mark.parametrize(
    ("first", "sentence"),
    [
        ('{"version":7}', "protocol version '7'"),
        (frame(1), "no protocol version"),
        ("garbage", "not JSON"),
        (b"\x00\x01", "not JSON"),
    ],
)
def test_a_wrong_first_message_is_refused_and_tried_again(start, wait_until, first, sentence):
    def wrong(service, connection):
        connection.send(first)
        service.stay(connection)

    service, client = start(wrong)
    wait_until(lambda: sentence in client.status.sentence, 10.0, sentence)
    assert client.status.link is LeapLink.REFUSED
    wait_until(lambda: len(service.paths) >= 2, 10.0, "another try")
    assert service.heard == []
    assert client.counts.connections == 0


def test_a_wrong_service_that_gets_right_is_used(start):
    def wrong(_service, connection):
        connection.send('{"version":7}')

    _service, client = start(wrong, stream(frame(3)))
    assert client.next_frame(LONG_S).frame.id == 3


def test_no_header(start, wait_until, monkeypatch):
    monkeypatch.setattr(client_module, "HEADER_TIMEOUT_S", 0.1)
    _service, client = start(Service.stay)
    wait_until(lambda: "no header" in client.status.sentence, 10.0, "the sentence")


def test_close_1001_before_the_header(start, wait_until):
    _service, client = start(lambda _service, connection: connection.close(1001))
    wait_until(lambda: "ended the connection (1001)" in client.status.sentence, 10.0, "the sentence")
    assert client.status.link is LeapLink.REFUSED


def test_silence_is_a_fault_and_ends_with_the_next_frame(start, wait_until):
    go = threading.Event()

    def pauses(service, connection):
        greet(service, connection)
        connection.send(frame(1))
        go.wait(20.0)
        while not service.ended.is_set():
            connection.send(frame(int(time.monotonic() * 1e3)))
            service.ended.wait(0.01)

    _service, client = start(pauses)
    assert client.next_frame(LONG_S).frame.id == 1
    wait_until(
        lambda: client.status.link is LeapLink.SILENT and "sends no frames" in client.status.sentence, 10.0, "silence"
    )
    go.set()
    wait_until(lambda: client.status.link is LeapLink.STREAMING, 10.0, "the end of the silence")
    assert client.next_frame(LONG_S) is not None


@pytest.mark.parametrize(
    ("attached", "streaming", "cause"), [(False, False, "not plugged in"), (True, False, "tracking is paused")]
)
def test_a_silence_is_explained_by_the_device_event(start, wait_until, attached, streaming, cause):
    state = {"attached": attached, "streaming": streaming, "id": "LP1", "type": "Peripheral"}
    _service, client = start(stream(json.dumps({"event": {"type": "deviceEvent", "state": state}})))
    wait_until(lambda: cause in client.status.sentence, 10.0, cause)


def test_a_service_that_does_not_answer_pings_is_left(start, wait_until, monkeypatch):
    monkeypatch.setattr(client_module, "PING_S", 0.2)
    stopped = threading.Event()

    def hangs(service, connection):
        greet(service, connection)
        with connection.protocol_mutex:  # the server's own thread cannot answer while this is held
            stopped.wait(20.0)

    _service, client = start(hangs, stream(frame(5)))
    received = client.next_frame(LONG_S)
    stopped.set()
    assert received.frame.id == 5
    assert client.counts.connections == 2


def test_of_a_backlog_only_the_newest_frame_is_returned(start, wait_until):
    _service, client = start(stream(*[frame(i) for i in range(1, 51)]))
    wait_until(lambda: client.counts.received == 50, 10.0, "all frames")
    assert client.next_frame(5.0).frame.id == 50
    assert client.next_frame(0.0) is None
    assert client.counts.superseded == 49


def test_bad_frames_are_dropped_with_a_reason_and_the_stream_continues(start, wait_until):
    bad = ['{"id":2,"timestamp":NaN,"hands":[],"pointables":[]}', '{"id":3,"hands":[', frame(4, hands=7), b"\xff"]
    step = threading.Semaphore(0)

    def talk(service, connection):
        greet(service, connection)
        for text in [*bad, frame(5), frame(5), frame(6, hands=[{}])]:
            connection.send(text)
            step.acquire(timeout=LONG_S)
        service.stay(connection)

    _service, client = start(talk)
    for count in range(1, 5):
        wait_until(lambda: client.next_frame(0.05) or sum(client.counts.dropped.values()) == count, 10.0, "a drop")  # noqa: B023
        step.release()
    assert client.next_frame(LONG_S).frame.id == 5
    step.release()
    wait_until(lambda: client.next_frame(0.05) or "A frame came twice." in client.counts.dropped, 10.0, "a drop")
    step.release()
    assert client.next_frame(LONG_S).frame.id == 6
    assert client.counts.dropped == {
        "The text holds the number NaN.": 1,
        "The text is not JSON.": 2,
        "A field has an unexpected form: TypeError 'int' object is not iterable.": 1,
        "A frame came twice.": 1,
    }
    assert client.counts.hands_dropped == {"The field id is missing.": 1}
    assert client.counts.connections == 1


def test_reasons_are_counted_without_growing_for_ever(start, wait_until):
    _service, client = start(stream())
    for i in range(100):
        client._drop(f"reason {i}")
    assert len(client.counts.dropped) == client_module.MAX_REASONS + 1
    assert client.counts.dropped["other reasons"] == 100 - client_module.MAX_REASONS


def test_a_missing_service_is_named_with_the_way_to_start_it(free_port, wait_until):
    client = LeapClient(port=free_port())
    try:
        wait_until(lambda: client.status.link is LeapLink.NO_SERVICE, 10.0, "the missing service")
        assert "sudo leapd" in client.status.sentence
        assert client.next_frame(0.01) is None
    finally:
        client.close()
    assert client.status.link is LeapLink.CLOSED


def test_close_from_another_thread_ends_a_wait(start, wait_until):
    _service, client = start(stream())
    wait_until(lambda: client.counts.connections == 1, 10.0, "the connection")
    threading.Timer(0.2, client.close).start()
    before = time.monotonic()
    assert client.next_frame(60.0) is None
    assert time.monotonic() - before < 30.0
    client.close()


def test_close_with_unread_messages_is_bounded(start, wait_until):
    def floods(service, connection):
        greet(service, connection)
        number = 0
        while not service.ended.is_set():
            number += 1
            connection.send(frame(number))

    _service, client = start(floods)
    wait_until(lambda: client.counts.received > 100, 10.0, "a flood")
    before = time.monotonic()
    client.close()
    assert time.monotonic() - before < 30.0
    assert client.status.link is LeapLink.CLOSED


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        ({"timestamp": "x"}, "not a whole number"),
        ({"timestamp": 10**400}, "not a whole number"),
        ({"hands": [{}]}, "id is missing"),
    ],
)
def test_a_stream_without_a_usable_frame_is_a_state_of_the_link_and_one_usable_frame_ends_it(
    start, wait_until, monkeypatch, bad, reason
):
    monkeypatch.setattr(client_module, "UNUSABLE_S", 0.05)
    mended = threading.Event()

    def talk(service, connection):
        greet(service, connection)
        number = 0
        while not service.ended.wait(0.005):
            number += 1
            connection.send(frame(number, **({} if mended.is_set() else bad)))

    _service, client = start(talk)
    wait_until(lambda: [client.next_frame(0.01)] and client.status.link is LeapLink.UNUSABLE, 10.0, "the state")
    assert reason in client.status.sentence
    mended.set()
    wait_until(lambda: client.next_frame(0.01) and client.status.link is LeapLink.STREAMING, 10.0, "a usable frame")


@pytest.mark.parametrize(("identity", "serial"), [("LP12345678901", "LP12345678901"), (1, ""), (None, "")])
def test_the_serial_of_the_device_is_that_of_its_event_or_unknown(start, identity, serial):
    state = {"attached": True, "streaming": True, "id": identity, "type": "peripheral"}
    _service, client = start(stream(json.dumps({"event": {"type": "deviceEvent", "state": state}}), frame(1)))
    assert client.next_frame(LONG_S).frame.id == 1
    assert client.status.serial == serial


def device(serial, attached=True, streaming=True):
    state = {"attached": attached, "streaming": streaming, "id": serial, "type": "Peripheral"}
    return json.dumps({"event": {"type": "deviceEvent", "state": state}})


def test_the_serial_is_that_of_the_tracker_that_sends(start, wait_until):
    steps = [
        ((device("LP1"),), "LP1"),
        ((device("LP2", streaming=False),), "LP1"),  # a second one, which is not used
        ((device("LP1", streaming=False),), "LP1"),  # paused
        ((device("LP2", attached=False, streaming=False),), "LP1"),
        ((device("LP1", attached=False, streaming=False),), ""),
        ((device("LP2"),), "LP2"),
    ]
    go = threading.Semaphore(0)

    def talk(service, connection):
        greet(service, connection)
        for number, (texts, _) in enumerate(steps, start=1):
            go.acquire(timeout=LONG_S)
            for text in (*texts, frame(number)):
                connection.send(text)
        go.acquire(timeout=LONG_S)

    _service, client = start(talk, stream(frame(99)))
    assert client.status.serial == ""
    for _, serial in steps:
        go.release()
        assert client.next_frame(LONG_S) is not None
        assert client.status.serial == serial
    go.release()
    wait_until(lambda: client.counts.connections == 2, 10.0, "the second connection")
    assert client.status.serial == ""


@pytest.mark.parametrize(
    "torn",
    [
        *(b"\x81\x05ab", b"\x83\x00", b"\xff" * 40, b"\x81\x7f" + b"\x7f" * 8, b"\x81\x02\xff\xfe"),
        *(b"\x80\x01x", b"\x88\x01\x00", bytes(range(256)) * 8),
    ],
)
def test_torn_websocket_frames_end_a_connection_and_the_next_one_is_used(wait_until, monkeypatch, torn):
    """A server that speaks by bytes: after the header it sends what is no frame, and closes."""
    monkeypatch.setattr(client_module, "RETRY_S", 0.02)
    for module, name in WAITS:
        monkeypatch.setattr(module, name, LONG_S)
    listener = socket.create_server(("127.0.0.1", 0))
    text = lambda message: b"\x81\x7e" + len(message).to_bytes(2, "big") + message.encode()  # noqa: E731
    connections = []

    def talk():
        for last in (torn, text(frame(2))):
            connection, _ = listener.accept()
            connections.append(connection)
            key = re.search(rb"Sec-WebSocket-Key: (\S+)", connection.recv(4000))[1].decode()
            answer = "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            connection.sendall(f"{answer}Sec-WebSocket-Accept: {accept_key(key)}\r\n\r\n".encode() + text(HEADER))
            connection.sendall(last)
            if last is torn:
                connection.shutdown(socket.SHUT_WR)

    server = threading.Thread(target=talk, daemon=True)
    server.start()
    client = LeapClient(port=listener.getsockname()[1])
    try:
        wait_until(
            lambda: (got := client.next_frame(0.1)) and got.frame.id == 2, 10.0, "a frame of the next connection"
        )
        assert len(connections) == 2
    finally:
        client.close()
        server.join(5.0)
        for connection in (*connections, listener):
            connection.close()


def test_an_unexpected_error_ends_one_connection_only(start, monkeypatch):
    reads = iter([RuntimeError("a defect"), "2.3.1"])

    def read(_text):
        result = next(reads)
        if isinstance(result, Exception):
            raise result
        return result

    monkeypatch.setattr(client_module, "read_header", read)
    _service, client = start(stream(frame(1)))
    assert client.next_frame(LONG_S).frame.id == 1
