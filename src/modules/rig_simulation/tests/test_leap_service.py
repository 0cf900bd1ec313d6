"""The simulated service on its socket, with our own client and with plain ones, and the program around it."""

import contextlib
import json
import socket
import sys
import threading
import time
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from common.errors import DeviceError
from leap_motion.client import LeapClient, LeapLink
from rig_simulation.control_port import ControlClient
from rig_simulation.devices.leap.program import main, parse
from rig_simulation.devices.leap.server import SimulatedLeapService
from rig_simulation.operator.motion import Script
from rig_simulation.operator.sources import Playback, ScriptedOperator

SCRIPT = Path(__file__).parent.parent / "scripts" / "leapd.py"
POLICIES = ('{"background":true}', '{"focused":true}')


@pytest.fixture
def start():
    """Starts services in threads of their own; they end with the test."""
    running = []

    def start(playing=True, **options):
        playback = Playback(ScriptedOperator(Script(speed=600.0)), playing=playing)
        service = SimulatedLeapService(playback, "127.0.0.1", 0, 0, **options)
        thread = threading.Thread(target=service.run, daemon=True)
        thread.start()
        running.append((service, thread))
        return service

    yield start
    for service, thread in running:
        service.stop()
        thread.join(60.0)
        assert not thread.is_alive()


@contextlib.contextmanager
def client_of(service, path="/v6.json", policies=POLICIES):
    with connect(f"ws://127.0.0.1:{service.port}{path}", compression=None, close_timeout=0.5) as connection:
        for policy in policies:
            connection.send(policy)
        yield connection


def ask(service, request, **fields):
    with ControlClient("127.0.0.1", service.control_port, timeout=30.0) as control:
        return control.ask(request, **fields)


def receive(connection, timeout=60.0):
    return json.loads(connection.recv(timeout))


@pytest.mark.clock
def test_header_then_device_event_then_frames(start):
    with client_of(start()) as connection:
        assert receive(connection) == {"version": 6, "serviceVersion": "2.3.1+simulated"}
        event = receive(connection)["event"]
        assert event["type"] == "deviceEvent"
        assert event["state"] == {"attached": True, "streaming": True, "type": "Peripheral", "id": event["state"]["id"]}
        frames = [receive(connection) for _ in range(20)]
        ids = [frame["id"] for frame in frames]
        assert ids == sorted(set(ids))
        assert all({"hands", "pointables", "timestamp", "currentFrameRate"} <= set(frame) for frame in frames)


@pytest.mark.clock
@pytest.mark.parametrize(
    ("path", "header", "event"),
    [
        ("/v5.json", {"version": 5, "serviceVersion": "2.3.1+simulated"}, "deviceEvent"),
        ("/v4.json", {"version": 4}, "deviceConnect"),
        ("/v2.json", {"version": 2}, None),
        ("/", {"version": 1}, None),
    ],
)
def test_lower_versions(start, path, header, event):
    with client_of(start(), path) as connection:
        assert receive(connection) == header
        second = receive(connection)
        assert second.get("event", {}).get("type") == event
        frame = second if event is None else receive(connection)
        assert "hands" in frame


@pytest.mark.clock
@pytest.mark.parametrize("path", ["/v7.json", "/v99.json", "/other"])
def test_unknown_versions_are_closed_with_1001_before_any_header(start, path):
    with client_of(start(), path, policies=()) as connection:
        with pytest.raises(ConnectionClosed) as closed:
            connection.recv(10.0)
        assert closed.value.rcvd.code == 1001


def test_frames_come_only_to_those_who_asked(start, wait_until):
    service = start()
    with client_of(service, policies=()) as connection, client_of(service) as other:
        for _ in range(12):
            receive(other)
        assert "version" in receive(connection)
        assert "event" in receive(connection)
        with pytest.raises(TimeoutError):
            connection.recv(0.2)
        connection.send("garbage")
        connection.send('["focused"]')
        connection.send('{"focused":"yes"}')
        connection.send('{"focused":true}')
        assert "hands" in receive(connection)
        connection.send('{"focused":false}')

        def silent():
            try:
                connection.recv(0.3)
            except TimeoutError:
                return True
            return False

        wait_until(silent, 10.0, "the end of the stream")
        connection.send('{"background":true}')
        assert "hands" in receive(connection)


@pytest.mark.clock
def test_the_server_of_todays_service_sends_to_everybody(start):
    with client_of(start(service="gemini"), policies=()) as connection:
        assert ["version" in receive(connection), "event" in receive(connection), "hands" in receive(connection)] == [
            True
        ] * 3


@pytest.mark.clock
def test_several_clients_get_the_same_frames(start):
    service = start()
    with client_of(service) as first, client_of(service) as second:
        for connection in (first, second):
            receive(connection), receive(connection)
        newest = receive(second)["id"]
        frame = receive(first)
        while frame["id"] < newest:
            frame = receive(first)
        assert ask(service, "state")["clients"] == 2


def test_a_client_that_does_not_read_costs_only_its_own_frames(start, wait_until):
    service = start()
    service._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)  # so that a few frames fill the connection
    slow = socket.socket()
    slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    try:
        slow.connect(("127.0.0.1", service.port))
        slow.sendall(
            b"GET /v2.json HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
        )
        wait_until(lambda: ask(service, "state")["frames_lost"] > 5, 60.0, "frames lost to the slow client")
        with client_of(service) as quick:
            receive(quick), receive(quick)
            ids = [receive(quick)["id"] for _ in range(20)]
            assert ids == sorted(set(ids))
    finally:
        slow.close()


def test_paused_it_sends_empty_frames_until_asked_to_play(start, wait_until):
    service = start(playing=False)
    client = LeapClient(port=service.port)
    try:
        frames = [client.next_frame(60.0).frame for _ in range(10)]
        assert not any(frame.hands for frame in frames)
        assert ask(service, "state")["playing"] is False
        ask(service, "play")
        wait_until(lambda: client.next_frame(60.0).frame.hands, 10.0, "a hand")
        state = ask(service, "state")
        assert state["playing"] is True
        assert state["position"] > 0
        assert state["frames_sent"] > 10
        ask(service, "pause")
        wait_until(lambda: not client.next_frame(60.0).frame.hands, 10.0, "the hand gone")
    finally:
        client.close()


def test_an_unplugged_device_is_reported_and_silent(start, wait_until):
    service = start()
    client = LeapClient(port=service.port)
    try:
        assert client.next_frame(60.0)
        ask(service, "unplug")
        wait_until(lambda: client.status.link is LeapLink.SILENT, 10.0, "silence")
        wait_until(lambda: "not plugged in" in client.status.sentence, 10.0, "the cause")
        ask(service, "plug")
        wait_until(lambda: client.status.link is LeapLink.STREAMING, 10.0, "frames")
    finally:
        client.close()


def test_our_client_follows_a_restart_on_the_same_port(start, wait_until):
    service = start()
    client = LeapClient(port=service.port)
    try:
        assert client.next_frame(60.0)
        port = service.port
        service.stop()
        wait_until(lambda: client.status.link not in (LeapLink.STREAMING, LeapLink.SILENT), 20.0, "the loss")
        playback = Playback(ScriptedOperator(Script()), playing=False)
        again = SimulatedLeapService(playback, "127.0.0.1", port, 0)
        thread = threading.Thread(target=again.run, daemon=True)
        thread.start()
        wait_until(lambda: client.next_frame(0.2) and client.counts.connections == 2, 20.0, "frames again")
        again.stop()
        thread.join(10.0)
    finally:
        client.close()


def test_a_request_that_is_being_answered_when_the_service_ends_is_carried_out(start, wait_until):
    def refused():
        try:
            socket.create_connection((service.host, service.port), 5.0).close()
        except ConnectionRefusedError:
            return True

    def play_late():
        service.stop()
        wait_until(refused, 10.0, "the end of the service's port")
        ended.wait(0.3)
        service._do(service._playback.play)

    ended = threading.Event()
    service = start(playing=False, requests={"play_late": play_late})
    with pytest.raises(DeviceError):  # its connection is closed by then
        ask(service, "play_late")
    wait_until(lambda: service._playback.playing, 15.0, "the request to be carried out")


@pytest.mark.clock
def test_a_port_in_use_and_a_foreign_address_are_refused(start):
    service = start()
    with pytest.raises(DeviceError):
        SimulatedLeapService(Playback(ScriptedOperator(Script())), "127.0.0.1", service.port, 0)
    with pytest.raises(DeviceError):
        SimulatedLeapService(Playback(ScriptedOperator(Script())), "0.0.0.0", 0, 0)


def test_the_program_says_where_it_listens_and_ends_with_an_interrupt(processes, wait_until):
    process = processes.start(
        sys.executable,
        str(SCRIPT),
        "--port",
        "0",
        "--control-port",
        "0",
        "--paused",
        "__name:=leapd",
        "__log:=/dev/null",
    )
    line = wait_until(process.log_path.read_text, 20.0, "the ready line")
    words = line.replace(",", "").split()
    assert words[:3] == ["leapd:", "listening", "on"]
    address, control = words[3], words[6]
    with ControlClient("127.0.0.1", int(control.rpartition(":")[2]), 60.0) as client:
        assert client.ask("state")["playing"] is False
    leap = LeapClient(port=int(address.rpartition(":")[2]))
    assert leap.next_frame(60.0) is not None
    before = time.monotonic()
    assert processes.end(process, 10.0) == 0
    assert time.monotonic() - before < 39.0, "then it would have been killed"
    leap.close()
    assert process.log_path.read_text() == line, "one line, and no traceback at the end"


def test_the_program_refuses_a_missing_recording(capsys, tmp_path):
    assert main(["--port", "0", "--control-port", "0", "--recording", str(tmp_path / "none.jsonl")]) == 1
    assert "cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ["--port", "70000"],
        ["--rate", "0"],
        ["--speed", "nan"],
        ["--offset", "1", "2", "inf"],
        ["--figure", "star"],
        ["--prot", "1"],
    ],
)
def test_bad_arguments_are_refused(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        parse(arguments)
    assert ended.value.code == 2
    assert "error:" in capsys.readouterr().err


def test_negative_offsets_can_be_given():
    assert parse(["--offset", "-50", "190", "-0.5", "__name:=leapd"]).offset == [-50.0, 190.0, -0.5]


@pytest.mark.clock
def test_a_machine_that_cannot_keep_up_sends_fewer_frames_but_never_none(monkeypatch, start):
    play = Playback.next

    def slow(playback):
        time.sleep(0.02)
        return play(playback)

    monkeypatch.setattr(Playback, "next", slow)
    with client_of(start()) as connection:
        receive(connection), receive(connection)
        for _ in range(3):
            begin = receive(connection)["timestamp"]
            while receive(connection)["timestamp"] < begin + 100_000:
                pass
