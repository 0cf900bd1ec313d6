"""Client in virtual time against a service that keeps, or breaks, the protocol."""

import json
import math
import socket

import pytest

from common import clock
from leap_motion import client as client_module
from leap_motion.client import LeapClient, LeapLink
from simulated.leap_wire import LeapWire
from simulated.wires import DELAY_S

HEADER = '{"version":6,"serviceVersion":"2.3.1+33747"}'
POLICIES = ['{"background":true}', '{"optimizeHMD":false}', '{"focused":true}']
"""UltraleapTrackingWebSocket takes these texts, below 32 characters, only as they are."""
SILENCE_S, UNUSABLE_S, HEADER_TIMEOUT_S, PING_S, RETRY_S, CLOSE_TIMEOUT_S = 0.1, 0.5, 2.0, 2.0, 0.5, 0.5
"""The client's waits."""
GREETED_S = 10 * DELAY_S
"""What the requests of a connection take at most, with those of its end."""
PERIOD_S = 0.01


def frame(number, **fields):
    return json.dumps({"id": number, "timestamp": number * 8650, "hands": [], "pointables": [], **fields})


def device(serial, attached=True, streaming=True):
    state = {"attached": attached, "streaming": streaming, "id": serial, "type": "Peripheral"}
    return json.dumps({"event": {"type": "deviceEvent", "state": state}})


@pytest.fixture
def wire(wires):
    with LeapWire() as wire:
        yield wire


@pytest.fixture
def start(wire):
    """Starts a service, with one conversation per connection, and a client of it; both end with the test."""
    clients = []

    def start(*conversations, **options):
        service = wire.serve(*conversations)
        clients.append(LeapClient(port=service.port, runtime=clock, **options))
        return service, clients[-1]

    yield start
    for client in clients:
        client.close()


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


def repeating(text_of):
    """A conversation that sends a text for each number, every PERIOD_S; none for None."""

    def talk(service, connection):
        greet(service, connection)
        for number in range(1, 10**6):
            text = text_of(number)
            if text is not None:
                connection.send(text)
            clock.sleep(PERIOD_S)

    return talk


def test_frames_arrive_with_the_stamp_of_their_receipt(start):
    stamps = iter(range(100, 200))
    service, client = start(stream(frame(1)), clock=lambda: next(stamps))
    received = client.next_frame(GREETED_S)
    assert (received.frame.id, received.stamp) == (1, 100)
    assert client.status.link is LeapLink.STREAMING
    assert client.status.service == "2.3.1+33747"
    assert service.paths == ["/v6.json"]


def test_policy_messages_are_compact_in_order_and_sent_again(start):
    """Reported in https://github.com/leapmotion/leapjs/issues/127: each reconnect asks for a lower protocol. Tried: a
    service that ends.
    Reported in https://github.com/leapmotion/leapjs/issues/159, https://github.com/leapmotion/leapjs/issues/171:
    background and focus are lost on reconnect. Tried: a service that ends.
    Reported in https://github.com/leapmotion/leapjs/pull/319: another program leaves the tracker in screen-top
    mode. Tried: that mode, then our client.
    """

    def ends(service, connection):
        greet(service, connection)
        connection.send(frame(1))
        connection.close(1001)

    service, client = start(ends, stream(frame(2)))
    assert client.next_frame(GREETED_S).frame.id == 1 and service.heard == POLICIES
    assert client.next_frame(RETRY_S - DELAY_S) is None
    assert client.next_frame(2 * GREETED_S).frame.id == 2 and client.counts.connections == 2
    assert service.heard == POLICIES * 2 and service.paths == ["/v6.json"] * 2


@pytest.mark.parametrize(
    ("first", "sentence"),
    [
        ('{"version":7}', "protocol version '7'"),
        (frame(1), "no protocol version"),
        ("garbage", "not JSON"),
        (b"\x00\x01", "not JSON"),
    ],
)
def test_a_wrong_first_message_is_refused_and_tried_again_ever_later(start, first, sentence):
    """Reported in https://github.com/leapmotion/leapjs/issues/226: first messages without a version. Tried: a frame
    first.
    """
    tries = []

    def wrong(service, connection):
        tries.append(clock.monotonic())
        connection.send(first)
        service.stay(connection)

    service, client = start(wrong)
    clock.sleep(GREETED_S)
    assert sentence in client.status.sentence and client.status.link is LeapLink.REFUSED
    clock.sleep(11.0)
    waits = [after - before for before, after in zip(tries, tries[1:])]
    assert waits == pytest.approx([0.5, 0.8, 1.28, 2.048, 3.0, 3.0], abs=GREETED_S)
    assert service.heard == [] and client.counts.connections == 0


def test_after_a_connection_the_next_try_is_soon_again(start):
    tries = []

    def wrong(service, connection):
        tries.append(clock.monotonic())

    def ends(service, connection):
        wrong(service, connection)
        greet(service, connection)

    start(wrong, wrong, wrong, ends, wrong)
    clock.sleep(4.0)
    waits = [after - before for before, after in zip(tries, tries[1:])]
    assert waits == pytest.approx([0.5, 0.8, 1.28, 0.5, 0.8], abs=GREETED_S)


def test_no_header(start):
    service, client = start(lambda service, connection: service.stay(connection))
    clock.sleep(HEADER_TIMEOUT_S)
    assert client.status.link is LeapLink.CONNECTING
    clock.sleep(GREETED_S)
    assert client.status.link is LeapLink.REFUSED and "no header within 2 s" in client.status.sentence


def test_silence_is_a_fault_and_ends_with_the_next_frame(start):
    """Reported in https://github.com/leapmotion/leapjs/issues/134: frames go on without a device. Tried: frames that
    stop.
    """
    pause = []
    _service, client = start(repeating(lambda number: None if pause else frame(number)))
    clock.sleep(0.5)
    assert client.next_frame(PERIOD_S) is not None
    while client.next_frame(2 * PERIOD_S) is not None:
        pause[:] = [True]
        last = clock.monotonic()
    clock.sleep(last + SILENCE_S - DELAY_S - clock.monotonic())
    assert client.status.link is LeapLink.STREAMING
    clock.sleep(2 * DELAY_S)
    assert client.status.link is LeapLink.SILENT and "sends no frames" in client.status.sentence
    pause.clear()
    assert client.next_frame(PERIOD_S + 2 * DELAY_S) is not None
    assert client.status.link is LeapLink.STREAMING


@pytest.mark.parametrize(
    ("attached", "streaming", "cause"), [(False, False, "not plugged in"), (True, False, "tracking is paused")]
)
def test_a_silence_is_explained_by_the_device_event(start, attached, streaming, cause):
    _service, client = start(stream(device("LP1", attached, streaming)))
    clock.sleep(SILENCE_S + GREETED_S)
    assert client.status.link is LeapLink.SILENT and cause in client.status.sentence


@pytest.mark.parametrize("answers", [True, False])
def test_a_silent_service_is_left_if_it_does_not_answer_pings(start, wires, answers):
    def pauses(service, connection):
        greet(service, connection)
        if not answers:
            wires.connections[-1].up.stalls = [(clock.monotonic(), math.inf)]
        service.stay(connection)

    _service, client = start(pauses, stream(frame(5)))
    clock.sleep(2 * PING_S - SILENCE_S)
    assert client.status.link is LeapLink.SILENT
    clock.sleep(3 * SILENCE_S + CLOSE_TIMEOUT_S + GREETED_S)
    if answers:
        clock.sleep(10 * PING_S)
        assert client.status.link is LeapLink.SILENT and client.counts.connections == 1
        return
    assert client.status.link is LeapLink.NO_SERVICE and "no answer to a ping for 2 s" in client.status.sentence
    assert client.next_frame(RETRY_S + GREETED_S).frame.id == 5
    assert client.counts.connections == 2


def test_of_a_backlog_only_the_newest_frame_is_returned(start):
    _service, client = start(stream(*[frame(i) for i in range(1, 51)]))
    clock.sleep(60 * DELAY_S)
    assert client.counts.received == 50
    assert client.next_frame(5.0).frame.id == 50
    assert client.next_frame(0.0) is None
    assert client.counts.superseded == 49


def test_bad_frames_are_dropped_with_a_reason_and_the_stream_continues(start):
    bad = ['{"id":2,"timestamp":NaN,"hands":[],"pointables":[]}', '{"id":3,"hands":[', frame(4, hands=7), b"\xff"]
    hand = {"id": 3, "palmPosition": [0, 350, 0], "palmNormal": [0, -1, 0], "direction": [0, 0, -1], "confidence": 1}
    swapped = [frame(6 + i, hands=[{**hand, "type": side}, {}]) for i, side in enumerate(["right", "left"])]
    texts = [*bad, frame(5), frame(5), *swapped]
    _service, client = start(repeating(lambda number: texts[number - 1] if number <= len(texts) else None))
    assert client.next_frame(1.0).frame.id == 5
    for number, count in ((6, 1), (7, 0)):
        assert (lambda frame: (frame.id, len(frame.hands)))(client.next_frame(1.0).frame) == (number, count)
    assert client.counts.dropped == {
        "The text holds the number NaN.": 1,
        "The text is not JSON.": 2,
        "A field has an unexpected form: TypeError 'int' object is not iterable.": 1,
        "A frame came twice.": 1,
    }
    assert client.counts.hands_dropped == {
        "The field id is missing.": 2,
        "A left hand is left out: it was a hand of the other side.": 1,
    }
    assert client.counts.connections == 1


def test_reasons_are_counted_without_growing_for_ever(start):
    _service, client = start(stream())
    for i in range(100):
        client._drop(f"reason {i}")
    assert len(client.counts.dropped) == client_module.MAX_REASONS + 1
    assert client.counts.dropped["other reasons"] == 100 - client_module.MAX_REASONS


def test_close_from_another_thread_ends_a_wait(start):
    _service, client = start(stream())
    closer = clock.Timer(0.2, client.close)
    closer.start()
    began = clock.monotonic()
    assert client.next_frame(60.0) is None
    assert clock.monotonic() - began == pytest.approx(0.2)
    client.close()
    assert clock.monotonic() - began < 0.2 + SILENCE_S + GREETED_S and client.status.link is LeapLink.CLOSED


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        ({"timestamp": "x"}, "not a whole number"),
        ({"timestamp": 10**400}, "not a whole number"),
        ({"hands": [{}]}, "id is missing"),
    ],
)
def test_a_stream_without_a_usable_frame_is_a_state_of_the_link_and_one_usable_frame_ends_it(start, bad, reason):
    is_bad = [True]
    _service, client = start(repeating(lambda number: frame(number, **(bad if is_bad else {}))))

    def read(seconds):
        end = clock.monotonic() + seconds
        while clock.monotonic() < end:
            client.next_frame(max(0.0, end - clock.monotonic()))

    read(UNUSABLE_S - PERIOD_S)
    assert client.status.link is LeapLink.STREAMING
    read(2 * PERIOD_S + GREETED_S)
    assert client.status.link is LeapLink.UNUSABLE and reason in client.status.sentence
    is_bad.clear()
    read(PERIOD_S + 2 * DELAY_S)
    assert client.status.link is LeapLink.STREAMING


@pytest.mark.parametrize(("identity", "serial"), [("LP12345678901", "LP12345678901"), (1, ""), (None, "")])
def test_the_serial_of_the_device_is_that_of_its_event_or_unknown(start, identity, serial):
    _service, client = start(stream(device(identity), frame(1)))
    assert client.next_frame(GREETED_S).frame.id == 1
    assert client.status.serial == serial


def test_the_serial_is_that_of_the_tracker_that_sends(start):
    steps = [
        (device("LP1"), "LP1"),
        (device("LP2", streaming=False), "LP1"),  # a second one, which is not used
        (device("LP1", streaming=False), "LP1"),  # paused
        (device("LP2", attached=False, streaming=False), "LP1"),
        (device("LP1", attached=False, streaming=False), ""),
        (device("LP2"), "LP2"),
    ]

    def talk(service, connection):
        greet(service, connection)
        for text, _ in steps:
            clock.sleep(1.0)
            connection.send(text)
        clock.sleep(0.5)

    _service, client = start(talk, stream(frame(99)))
    clock.sleep(0.5)
    assert client.status.serial == ""
    for _, serial in steps:
        clock.sleep(1.0)
        assert client.status.serial == serial
    clock.sleep(1.0)
    assert client.counts.connections == 2 and client.status.serial == ""


@pytest.mark.parametrize(
    "torn",
    [
        *(b"\x81\x05ab", b"\x83\x00", b"\xff" * 40, b"\x81\x7f" + b"\x7f" * 8, b"\x81\x02\xff\xfe"),
        *(b"\x80\x01x", b"\x88\x01\x00", bytes(range(256)) * 8),
    ],
)
def test_torn_websocket_frames_end_a_connection_and_the_next_one_is_used(start, torn):
    def tears(service, connection):
        connection.send(HEADER)
        connection.socket.sendall(torn)
        connection.socket.shutdown(socket.SHUT_WR)

    service, client = start(tears, stream(frame(2)))
    assert client.next_frame(RETRY_S + 2 * GREETED_S).frame.id == 2
    assert len(service.paths) == 2


def test_an_unexpected_error_ends_one_connection_only(start, monkeypatch):
    reads = iter([RuntimeError("a defect"), "2.3.1"])

    def read(_text):
        result = next(reads)
        if isinstance(result, Exception):
            raise result
        return result

    monkeypatch.setattr(client_module, "read_header", read)
    _service, client = start(stream(frame(1)))
    assert client.next_frame(RETRY_S + 3 * GREETED_S).frame.id == 1
