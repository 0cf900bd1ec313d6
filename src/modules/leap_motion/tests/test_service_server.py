"""The shared server: offers from any thread, clients that misbehave, other machines."""

import contextlib
import json
import random
import threading
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from common import clock
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
from simulated.wires import DELAY_S

REQUEST = (
    b"GET /v6.json HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)
PERIOD_S, SOON_S = 0.002, 10 * DELAY_S
SILENCE_S = 0.1
"""After which the client calls a service silent."""


@pytest.fixture
def start(wires):
    running = []

    def start(**options):
        service = LeapService(port=0, **options)
        thread = clock.Thread(target=service.run, daemon=True)
        thread.start()
        running.append((service, thread))
        return service

    yield start
    for service, thread in running:
        service.stop()
        thread.join()
        service.offer("{}"), service.plug(False)  # afterwards nobody is harmed


def offer(service):
    """Offers numbered frames to a service, in a thread of its own, every PERIOD_S."""

    def offer():
        for number in range(1, 10**6):
            clock.sleep(PERIOD_S)
            service.offer(wire.frame([], 30.0).text(number, 1000 * number))

    clock.Thread(target=offer, daemon=True).start()


def plain(service, path="/v6.json", **options):
    return connect(f"ws://127.0.0.1:{service.port}{path}", compression=None, close_timeout=0.05, **options)


def test_frames_offered_by_another_thread_reach_our_client_in_order(start):
    service = start(version="2.3.1+webcam")
    offer(service)
    client = LeapClient(port=service.port, runtime=clock)
    ids = [client.next_frame(1.0).frame.id for _ in range(20)]
    assert ids == list(range(ids[0], ids[0] + 20))
    assert client.status.service == "2.3.1+webcam" and service.clients == 1
    service.plug(False)
    clock.sleep(PERIOD_S + SILENCE_S + SOON_S)
    assert client.status.link is LeapLink.SILENT and "not plugged in" in client.status.sentence
    service.plug(True)
    clock.sleep(PERIOD_S + SOON_S)
    assert client.status.link is LeapLink.STREAMING
    client.close()


@pytest.mark.real
def test_a_service_and_its_client_meet_on_a_real_socket():
    service = LeapService(port=0)
    thread = threading.Thread(target=service.run)
    thread.start()
    client = LeapClient(port=service.port)
    got = None
    while got is None:  # until its policies are there
        service.offer(wire.frame([], 30.0).text(7, 7000))
        got = client.next_frame(0.1)
    assert got.frame.id == 7 and client.status.serial == "LP00000000001"
    client.close()
    service.stop()
    thread.join()


def test_at_its_end_a_client_that_says_nothing_more_delays_it_for_half_a_second(start, wires):
    service = start()
    connection = wires.connect(("127.0.0.1", service.port))
    connection.sendall(REQUEST)
    clock.sleep(SOON_S)
    assert service.clients == 1
    service.stop()
    clock.sleep(0.7 - 3 * SOON_S)  # 0.2 s until it looks, and 0.5 s
    assert service.clients == 1
    clock.sleep(4 * SOON_S)
    assert service.clients == 0


def test_the_newest_offer_wins_and_a_burst_stays_together():
    link = LeapClientLink.__new__(LeapClientLink)
    link.wants, link.frames, link.wake = {"focused": True}, (), SimpleNamespace(set=lambda: None)
    assert [link.offer(("1",)), link.offer(("2", "3")), link.offer(("4",)), link.offer(())] == [0, 1, 2, 0]
    assert link.frames == ("4",)
    link.wants = {"focused": False}
    assert link.offer(("5",)) == 0 and link.frames == ("4",)


def test_clients_that_break_every_rule_harm_only_themselves(start, wires):
    service = start()
    offer(service)
    with plain(service) as good:
        good.send('{"background":true}')
        rng = random.Random(1)
        noise = lambda size: bytes(rng.randrange(256) for _ in range(size))  # noqa: E731
        for number in range(12):
            with contextlib.suppress(OSError), wires.connect(("127.0.0.1", service.port)) as raw:
                if number % 3:
                    raw.sendall(REQUEST)
                    raw.recv(1000)
                raw.sendall(noise(400))  # torn frames, or no WebSocket at all
        for message in ("[" * 3000, b"\xff\x00", '{"focused":[1]}', noise(100), '"background"'):
            with plain(service) as odd:
                odd.send(message)
                assert "version" in odd.recv(1.0)
        with plain(service) as huge, pytest.raises(ConnectionClosed) as closed:
            huge.send("x" * (MAX_MESSAGE_BYTES + 1))
            while True:
                huge.recv(1.0)
        assert closed.value.rcvd.code == 1009
        clock.sleep(SOON_S)
        assert service.clients == 1
        good.recv(1.0), good.recv(1.0)
        frames = [json.loads(good.recv(1.0))["id"] for _ in range(20)]
        assert frames == list(range(frames[0], frames[0] + 20)) and service.lost == 0


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


def test_a_client_of_another_machine_is_served_with_the_code_only(start, monkeypatch):
    service = start(host="0.0.0.0", code="secret7")
    offer(service)
    with plain(service) as here:
        assert "version" in here.recv(1.0), "this machine needs none"
    monkeypatch.setattr("leap_motion.service.server.is_loopback", lambda host: False)
    for path in ("/v6.json", "/v6.json?code=secret", "/v6.json?code="):
        with pytest.raises(Exception, match="403"), plain(service, path):
            pass
    clients = [LeapClient(port=service.port, code=code, runtime=clock) for code in ("secret7", "secret8")]
    assert clients[0].next_frame(1.0) is not None
    assert clients[1].status.link is LeapLink.REFUSED and "`code`" in clients[1].status.sentence
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


@pytest.mark.parametrize("origin", HOSTILE)
@pytest.mark.parametrize("service", ["2.3", "gemini"])
def test_a_web_page_of_another_site_gets_no_hands_and_takes_none(start, origin, service):
    served = start(service=service)
    with pytest.raises(Exception, match="403"), plain(served, additional_headers={"Origin": origin}):
        pass
    assert served.clients == 0


@pytest.mark.parametrize("origin", ["http://localhost:8080", "http://127.0.0.1", "https://[::1]:1"])
def test_a_web_page_of_this_computer_is_served(start, origin):
    served = start()
    with plain(served, additional_headers={"Origin": origin}) as page:
        assert "version" in page.recv(1.0)


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


def test_a_port_in_use_is_a_sentence(start):
    service = start()
    with pytest.raises(LeapServiceError) as error:
        LeapService(port=service.port)
    assert str(service.port) in str(error.value) and "another port" in str(error.value)


def test_the_server_of_todays_service_sends_at_once_and_each_frame_to_one_client_only(start):
    service = start(service="gemini")
    with plain(service) as first, plain(service) as second:
        assert [first.recv(1.0), first.recv(1.0)[:10]] == ['{"version":6}', '{"event":{']
        second.recv(1.0), second.recv(1.0)
        offer(service)
        ids = [[json.loads(client.recv(1.0))["id"] for _ in range(15)] for client in (first, second)]
        assert sorted(ids[0] + ids[1]) == list(range(1, 31))
        first.send('{"optimizeHMD": true}')
        first.send('{"optimizeScreentop":true}')
        assert service.mode == "desktop"
        clock.sleep(SOON_S)
        assert service.mode == "screen-top"
    with plain(service, "/v5.json") as lower, pytest.raises(ConnectionClosed):
        lower.recv(1.0)
