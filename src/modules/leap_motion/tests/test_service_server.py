"""The shared server: offers from any thread, clients that misbehave, other machines."""

import contextlib
import json
import os
import random
import socket
import threading
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from leap_motion.client import LeapClient, LeapLink
from leap_motion.service import wire
from leap_motion.service.server import (
    MAX_MESSAGE_BYTES,
    MAX_WRONG_CODES,
    AccessCode,
    LeapClientLink,
    LeapService,
    LeapServiceError,
    is_loopback,
)


@pytest.fixture
def start():
    running = []

    def start(**options):
        service = LeapService(port=0, **options)
        thread = threading.Thread(target=service.run, daemon=True)
        thread.start()
        running.append((service, thread))
        return service

    yield start
    for service, thread in running:
        service.stop()
        thread.join(60.0)
        assert not thread.is_alive()
        service.offer("{}"), service.plug(False)  # afterwards nobody is harmed


@pytest.fixture
def offering():
    """Offers numbered frames to a service from a thread of its own."""
    ended = threading.Event()
    threads = []

    def offering(service, period=0.002):
        def offer():
            number = 0
            while not ended.wait(period):
                number += 1
                service.offer(wire.frame([], 30.0).text(number, 1000 * number))

        threads.append(threading.Thread(target=offer, daemon=True))
        threads[-1].start()

    yield offering
    ended.set()
    for thread in threads:
        thread.join(5.0)


def plain(service, path="/v6.json"):
    return connect(f"ws://127.0.0.1:{service.port}{path}", compression=None, close_timeout=0.05)


def test_frames_offered_by_another_thread_reach_our_client_in_order(start, offering, wait_until):
    service = start(version="2.3.1+webcam")
    offering(service)
    client = LeapClient(port=service.port)
    try:
        ids = [client.next_frame(60.0).frame.id for _ in range(20)]
        assert ids == sorted(set(ids))
        assert client.status.service == "2.3.1+webcam" and service.clients == 1
        service.plug(False)
        wait_until(lambda: client.status.link is LeapLink.SILENT, 10.0, "silence")
        wait_until(lambda: "not plugged in" in client.status.sentence, 10.0, "the cause")
        service.plug(True)
        wait_until(lambda: client.status.link is LeapLink.STREAMING, 10.0, "frames")
    finally:
        client.close()


def test_the_newest_offer_wins_and_a_burst_stays_together():
    link = LeapClientLink.__new__(LeapClientLink)
    link.wants, link.frames, link.wake = {"focused": True}, (), SimpleNamespace(set=lambda: None)
    assert [link.offer(("1",)), link.offer(("2", "3")), link.offer(("4",)), link.offer(())] == [0, 1, 2, 0]
    assert link.frames == ("4",)
    link.wants = {"focused": False}
    assert link.offer(("5",)) == 0 and link.frames == ("4",)


@pytest.mark.clock
def test_clients_that_break_every_rule_harm_only_themselves(start, offering):
    service = start()
    offering(service)
    with plain(service) as good:
        good.send('{"background":true}')
        rng = random.Random(1)
        for number in range(12):
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", service.port), 5.0) as raw:
                if number % 3:
                    raw.sendall(
                        b"GET /v6.json HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
                    )
                    raw.recv(1000)
                raw.sendall(bytes(rng.randrange(256) for _ in range(400)))  # torn frames, or no WebSocket at all
        for message in ("[" * 3000, b"\xff\x00", '{"focused":[1]}', os.urandom(100), '"background"'):
            with plain(service) as odd:
                odd.send(message)
                odd.recv(60.0)
        with plain(service) as huge, pytest.raises(ConnectionClosed) as closed:
            huge.send("x" * (MAX_MESSAGE_BYTES + 1))
            while True:
                huge.recv(60.0)
        assert closed.value.rcvd.code == 1009
        frames = [json.loads(good.recv(60.0)).get("id", 0) for _ in range(20)]
        assert frames == sorted(frames) and frames[-1] > frames[3]


@given(st.one_of(st.text(), st.binary(), st.just("[" * 5000)), st.sampled_from(wire.SERVICES))
def test_any_message_of_a_client_is_read_as_policies(message, service):
    assert isinstance(wire.policies(message, service), dict)


@pytest.mark.parametrize(
    ("message", "leapd", "gemini"),
    [
        ('{"background":true}', {"background": True}, {"background": True}),
        ('{"optimizeHMD":false}', {"optimizeHMD": False}, {"optimizeHMD": False}),
        ('{"focused": true}', {"focused": True}, {}),
        ('{"focused":true,"background":true}', {"focused": True, "background": True}, {}),
        ('{"focused":"yes"}', {"focused": False}, {}),
        ('["focused"]', {}, {}),
    ],
)
def test_policies_of_the_two_services(message, leapd, gemini):
    assert (wire.policies(message, "2.3"), wire.policies(message, "gemini")) == (leapd, gemini)


def test_other_machines_need_the_code():
    for host in ("0.0.0.0", "", "::", "192.168.1.2", "example.org"):
        with pytest.raises(LeapServiceError):
            LeapService(host=host, port=0)
    with pytest.raises(LeapServiceError):
        LeapService(host="0.0.0.0", port=0, code="12345")


@pytest.mark.parametrize(
    ("address", "loopback"),
    [
        *(("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("localhost", True), ("::ffff:127.0.0.1", True)),
        *(("::ffff:10.0.0.1", False), ("10.0.0.1", False), ("fe80::1%eth0", False), ("", False), ("host", False)),
    ],
)
def test_loopback_addresses(address, loopback):
    assert is_loopback(address) == loopback


def test_a_client_of_another_machine_is_served_with_the_code_only(start, offering, wait_until, monkeypatch):
    service = start(host="0.0.0.0", code="secret7")
    offering(service)
    with plain(service) as here:
        assert "version" in here.recv(60.0), "this machine needs none"
    monkeypatch.setattr("leap_motion.service.server.is_loopback", lambda host: False)
    for path in ("/v6.json", "/v6.json?code=secret", "/v6.json?code="):
        with pytest.raises(Exception, match="403"), plain(service, path):
            pass
    clients = [LeapClient(port=service.port, code=code) for code in ("secret7", "secret8")]
    try:
        assert clients[0].next_frame(60.0) is not None
        wait_until(lambda: clients[1].status.link is LeapLink.REFUSED, 10.0, "the refusal")
        assert "`code`" in clients[1].status.sentence
    finally:
        for client in clients:
            client.close()


HOSTILE = (
    "https://evil.example",
    "http://127.0.0.1.evil.example",
    "null",
    "file://",
    "http://[",
    "x",
    "",
    "http://10.0.0.1",
)


@pytest.mark.clock
@pytest.mark.parametrize("origin", HOSTILE)
@pytest.mark.parametrize("service", ["2.3", "gemini"])
def test_a_web_page_of_another_site_gets_no_hands_and_takes_none(start, origin, service):
    served = start(service=service)
    with pytest.raises(Exception, match="403"), connect(
        f"ws://127.0.0.1:{served.port}/v6.json", compression=None, additional_headers={"Origin": origin}
    ):
        pass
    assert served.clients == 0


@pytest.mark.clock
@pytest.mark.parametrize("origin", ["http://localhost:8080", "http://127.0.0.1", "https://[::1]:1"])
def test_a_web_page_of_this_computer_is_served(start, origin):
    served = start()
    headers = {"Origin": origin}
    options = {"compression": None, "close_timeout": 0.05, "additional_headers": headers}
    with connect(f"ws://127.0.0.1:{served.port}/v6.json", **options) as page:
        assert "version" in page.recv(60.0)


@given(st.lists(st.text(), max_size=20))
def test_after_too_many_wrong_codes_none_is_accepted(tries):
    code = AccessCode("right one")
    for text in tries:
        assert code.accepts(text) == (text == "right one")
        if code._wrong >= MAX_WRONG_CODES:
            break
    while code._wrong < MAX_WRONG_CODES:
        assert not code.accepts("wrong")
    assert not code.accepts("right one")


@pytest.mark.clock
def test_a_port_in_use_is_a_sentence(start):
    service = start()
    with pytest.raises(LeapServiceError) as error:
        LeapService(port=service.port)
    assert str(service.port) in str(error.value) and "another port" in str(error.value)


@pytest.mark.clock
def test_the_server_of_todays_service_sends_at_once_and_each_frame_to_one_client_only(start, offering):
    service = start(service="gemini")
    with plain(service) as first, plain(service) as second:
        assert [first.recv(60.0), first.recv(60.0)[:10]] == ['{"version":6}', '{"event":{']
        second.recv(60.0), second.recv(60.0)
        offering(service)
        ids = [[json.loads(client.recv(60.0))["id"] for _ in range(15)] for client in (first, second)]
        assert not set(ids[0]) & set(ids[1])
        first.send('{"optimizeHMD": true}')
        first.send('{"optimizeScreentop":true}')
        while service.mode == "desktop":
            first.recv(60.0)
        assert service.mode == "screen-top"
    with plain(service, "/v5.json") as lower, pytest.raises(ConnectionClosed):
        lower.recv(60.0)
