"""The shared server: offers from any thread, clients that misbehave, other machines."""

import asyncio
import contextlib
import json
import random
import re
import socket
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from common import clock
from leap_motion.client import LeapClient, LeapLink, wire_fault
from leap_motion.service import wire
from leap_motion.service.certificate import Certificate
from leap_motion.service.server import LeapClientLink, LeapService, LeapServiceError
from leap_motion.service.socket_service import (
    CLOSE_TIMEOUT_S,
    LONGEST_SLEEP_S,
    MAX_OF_ADDRESS,
    OPEN_TIMEOUT_S,
    PING_S,
    SEND_S,
    SocketService,
    listen,
)
from leap_motion.transport import LeapSocket, _Tls
from simulated.wires import DELAY_S

REQUEST = (
    b"GET /v6.json HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
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
    status = client.status
    its_socket = service._clients[0].connection.transport.get_extra_info("socket")
    at_once = its_socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
    client.close()
    service.stop()
    thread.join()
    assert got.frame.id == 7 and status.serial == "LP00000000001"
    assert at_once, "small frames do not wait for one another"


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


BIG = "x" * 2 * SocketService.write_limit


def that_reads_nothing(service, wires):
    """A client that asked for frames."""
    deaf = wires.connect(("127.0.0.1", service.port))
    wires.connections[-1].down.room = 1000
    deaf.sendall(REQUEST + b"\x81\x93" + bytes(4) + b'{"background":true}')
    clock.sleep(SOON_S)
    assert service.clients == 1
    return deaf


def test_a_client_that_does_not_read_is_gone_after_a_moment(start, wires):
    service = start()
    deaf = that_reads_nothing(service, wires)
    service.offer(BIG)
    clock.sleep(SEND_S - SOON_S)
    assert service.clients == 1
    clock.sleep(2 * SOON_S)
    assert service.clients == 0
    deaf.close()


class BadServer(SocketService):
    """A subclass whose message has no limit."""

    def __init__(self):
        super().__init__()
        listener = listen("127.0.0.1", 0)
        self.port, self.clients = listener.getsockname()[1], 0
        self._open(listener)

    async def _meet(self, connection, request):
        return None

    async def _converse(self, connection):
        self.clients += 1
        await connection.send(BIG)


@pytest.mark.parametrize("kind", [lambda: LeapService(port=0), BadServer])
@pytest.mark.parametrize("before", [0.0, 1.0])
def test_a_client_that_does_not_read_does_not_keep_the_service_from_its_end(wires, kind, before):
    service = kind()
    thread = clock.Thread(target=service.run, daemon=True)
    thread.start()
    deaf = that_reads_nothing(service, wires)
    if isinstance(service, LeapService):
        service.offer(BIG)
    clock.sleep(before)
    service.stop()
    begun = clock.monotonic()
    thread.join(2.0 * SEND_S)
    assert not thread.is_alive() and clock.monotonic() <= begun + LONGEST_SLEEP_S + SEND_S + SOON_S
    deaf.close()


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
            huge.send("x" * (SocketService.max_message_bytes + 1))
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


CODE = "Secret-Code-42"
OWN, FALSE = (
    Certificate(*2 * (str(Path(__file__).parent / "certificates" / f"{whose}.pem"),))
    for whose in ("service", "impostor")
)


class TestOtherMachines:
    """A service that is open to other machines, from one of which all connections come."""

    @pytest.fixture(autouse=True)
    def _machine(self, start, wires):
        wires.client_address = "10.0.0.7"
        self.wires, self.said, self.heard = wires, [], []
        wires.on_connect = self._listen
        self.service = start(host="0.0.0.0", code=CODE, certificate=OWN, secure_port=0)
        offer(self.service)
        self.clients = []
        yield
        for client in self.clients:
            client.close()

    def _listen(self, connection):
        connection.up.sent = lambda data, now: self.said.append(data)
        connection.down.sent = lambda data, now: self.heard.append(data)

    def client(self, port=None, **options):
        proof = {"code": CODE, "fingerprint": OWN.fingerprint(), **options}
        self.clients.append(LeapClient(port=port or self.service.secure_port, runtime=clock, **proof))
        return self.clients[-1]

    def connect(self):
        return self.wires.connect(("127.0.0.1", self.service.secure_port))

    def request(self, text):
        """Sends a request to the secure port; returns the socket."""
        raw, self.tls = self.connect(), _Tls()
        while not self.tls.shake():
            raw.sendall(self.tls.outgoing())
            self.tls.take(raw.recv(9999))
        raw.sendall(self.tls.outgoing(text))
        clock.sleep(SOON_S)
        return raw

    @pytest.mark.hazard(22)
    def test_are_served_by_tls_with_the_code_and_a_listener_learns_neither_code_nor_hands(self):
        client = self.client(fingerprint=":".join(re.findall("..", OWN.fingerprint().upper())))
        assert client.next_frame(1.0) is not None and client.status.link is LeapLink.STREAMING
        sent, came = b"".join(self.said), b"".join(self.heard)
        assert CODE.encode() not in sent and b"GET" not in sent
        assert b"currentFrameRate" not in came and b"HTTP" not in came and len(came) > 1000

    def test_an_impostor_gets_no_code_and_its_hands_are_not_taken(self, start):
        impostor = start(host="0.0.0.0", code=CODE, certificate=FALSE, secure_port=0)
        offer(impostor)
        client = self.client(impostor.secure_port)
        clock.sleep(3.0)
        assert client.status.link is LeapLink.REFUSED and client.counts.connections == client.counts.received == 0
        assert FALSE.fingerprint() in client.status.sentence and "Nothing was sent" in client.status.sentence
        assert impostor.clients == 0 and impostor._code.wait("10.0.0.7", clock.monotonic()) == 0.0

    def test_a_plain_service_in_its_place_gets_no_code_and_its_hands_are_not_taken(self, start):
        plain_one = start()
        offer(plain_one)
        client = self.client(plain_one.port)
        clock.sleep(3.0)
        assert client.status.link is LeapLink.NO_SERVICE and client.counts.received == 0
        assert CODE.encode() not in b"".join(self.said)

    def test_wrong_codes_slow_down_their_own_address_only(self):
        guesses = [self.client(code=f"wrong code {i}") for i in range(2)]
        clock.sleep(20.0)
        assert {client.status.link for client in guesses} == {LeapLink.REFUSED}
        assert "`code` is another one" in guesses[0].status.sentence + guesses[1].status.sentence
        right = self.client()
        clock.sleep(SOON_S)
        assert "compares no code" in right.status.sentence and self.service.clients == 0
        self.wires.client_address = "10.0.0.8"
        assert self.client().next_frame(0.1) is not None

    def test_idle_and_half_sent_requests_are_few_and_end(self):
        idle = [self.connect() for _ in range(2 * MAX_OF_ADDRESS)]
        idle[0].sendall(b"\x16\x03\x01\x02\x00\x01")  # of a TLS handshake
        clock.sleep(SOON_S)
        still = [each for each in idle if each.readable_at() > clock.monotonic()]
        assert len(still) == MAX_OF_ADDRESS
        self.wires.client_address = "10.0.0.8"
        assert self.client().next_frame(0.1) is not None
        clock.sleep(OPEN_TIMEOUT_S - 20 * SOON_S)
        assert all(each.readable_at() > clock.monotonic() for each in still)
        clock.sleep(20 * SOON_S)
        assert all(each.readable_at() <= clock.monotonic() and each.recv(1) == b"" for each in still)

    def test_one_that_is_being_opened_ends_with_the_service(self):
        half = self.connect()
        clock.sleep(SOON_S)
        self.service.stop()
        clock.sleep(1.0)
        assert half.recv(1) == b"" and not asyncio.all_tasks(self.service._loop)

    def test_all_together_do_not_keep_this_machine_out(self):
        for machine in range(10, 30):
            self.wires.client_address = f"10.0.0.{machine}"
            idle = [self.connect() for _ in range(MAX_OF_ADDRESS)]
        self.wires.client_address = "127.0.0.1"
        with plain(self.service) as here:
            assert "version" in here.recv(1.0), "this machine needs no code, and has its own port"
        assert idle

    def test_one_that_vanishes_makes_room(self):
        gone = self.request(REQUEST.replace(b"v6.json", b"v6.json?code=" + CODE.encode()))
        clock.sleep(2 * PING_S - SOON_S)
        assert self.service.clients == 1
        clock.sleep(4 * CLOSE_TIMEOUT_S)
        assert self.service.clients == 0
        gone.close()

    @pytest.mark.parametrize(
        ("host", "path", "status"),
        [
            ("evil.example", f"v6.json?code={CODE}", 403),
            ("127.0.0.1", "v6.json", 401),
            ("127.0.0.1", "v6.json?code=", 401),
            ("127.0.0.1", f"v6.json?code={CODE}&code=", 101),
        ],
    )
    def test_what_a_request_is_answered(self, host, path, status):
        raw = self.request(REQUEST.replace(b"127.0.0.1", host.encode()).replace(b"v6.json", path.encode()))
        self.tls.take(raw.recv(9999))
        assert self.tls.incoming()[0].startswith(b"HTTP/1.1 %d " % status)
        raw.close()


def test_other_machines_need_a_code_and_a_certificate(wires):
    for host in ("0.0.0.0", "", "::", "192.168.1.2", "example.org"):
        with pytest.raises(LeapServiceError, match="certificate and a code"):
            LeapService(host=host, port=0)
    with pytest.raises(LeapServiceError, match="certificate and a code"):
        LeapService(host="0.0.0.0", port=0, code="1234567", certificate=OWN)
    with pytest.raises(LeapServiceError, match="certificate and a code"):
        LeapService(host="0.0.0.0", port=0, code="12345678")
    with pytest.raises(LeapServiceError, match="no certificate and key"):
        LeapService(host="0.0.0.0", port=0, code="12345678", certificate=Certificate(__file__, __file__))


@pytest.mark.parametrize(
    ("given", "fault"),
    [
        ({"host": "10.0.0.5"}, "trust_network"),
        ({"host": "tracker.example"}, "another machine"),
        ({"host": "10.0.0.5", "code": "12345678"}, "fingerprint is not"),
        ({"host": "10.0.0.5", "fingerprint": 64 * "0"}, "code is not"),
        ({"host": "10.0.0.5", "fingerprint": 63 * "0", "code": "12345678"}, "64 hexadecimal"),
        ({"host": "10.0.0.5", "trust_network": True, "code": "12345678"}, "fingerprint is not"),
        ({"host": "10.0.0.5", "trust_network": True}, None),
        ({"host": "10.0.0.5", "fingerprint": 32 * "aB:", "code": "12345678"}, None),
        *(({"host": host}, None) for host in ("127.0.0.1", "localhost", "127.0.1.1", "::1")),
    ],
)
def test_a_client_takes_hands_of_another_machine_only_with_proof_or_where_it_is_told_to(given, fault):
    found = wire_fault(**{"code": "", "fingerprint": "", "trust_network": False, **given})
    assert (found is None) if fault is None else (fault in found)


def test_a_client_that_must_not_begin_says_why(wires):
    with pytest.raises(ValueError, match="trust_network"):
        LeapClient("10.0.0.5", runtime=clock)


def test_the_request_of_a_client_with_a_code(wires):
    listener = wires.serve(("127.0.0.1", 7000))
    clock.Thread(target=lambda: LeapSocket("127.0.0.1", 7000, "a&b c", ""), daemon=True).start()
    request = listener.accept()[0].recv(9999)
    key = re.search(rb"Sec-WebSocket-Key: ([^\r]+)", request).group(1)
    assert request.replace(key, b"KEY") == (
        b"GET /v6.json?code=a%26b+c HTTP/1.1\r\nHost: 127.0.0.1:7000\r\nUpgrade: websocket\r\n"
        b"Connection: Upgrade\r\nSec-WebSocket-Key: KEY\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )


@pytest.mark.parametrize("host", ["evil.example", "evil.example:6437", "10.0.0.5", ""])
def test_a_page_that_bound_its_name_to_this_computer_gets_no_hands(start, wires, host):
    service = start()
    with wires.connect(("127.0.0.1", service.port)) as page:
        page.sendall(REQUEST.replace(b"127.0.0.1", host.encode()))
        clock.sleep(SOON_S)
        assert page.recv(4096).startswith(b"HTTP/1.1 403 ")


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
