"""The simulated service in virtual time, with our own client and with plain ones, and the program around it."""

import contextlib
import json
import sys
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from common import clock
from common.errors import DeviceError
from leap_motion.client import LeapClient, LeapLink
from leap_motion.service.socket_service import LONGEST_SLEEP_S
from rig_simulation.control_port import ControlClient
from rig_simulation.devices.leap.program import main, parse
from rig_simulation.devices.leap.sensing import FRAME_RATE
from rig_simulation.devices.leap.server import SimulatedLeapService
from rig_simulation.operator.motion import Script
from rig_simulation.operator.sources import Playback, ScriptedOperator
from simulated.wires import DELAY_S

SCRIPT = Path(__file__).parent.parent / "scripts" / "leapd.py"
POLICIES = ('{"background":true}', '{"focused":true}')
FRAME_S, SOON_S = 1.0 / FRAME_RATE, 10 * DELAY_S
SILENCE_S = 0.1
"""After which the client calls a service silent, and tries again to reach one that is gone."""


@pytest.fixture
def start(wires):
    """Starts services in threads of their own; they end with the test."""
    running = []

    def start(playing=True, port=0, **options):
        playback = Playback(ScriptedOperator(Script(speed=600.0)), playing=playing)
        service = SimulatedLeapService(playback, "127.0.0.1", port, 0, **options)
        service.thread = clock.Thread(target=service.run, daemon=True)
        service.thread.start()
        running.append(service)
        return service

    yield start
    for service in running:
        service.stop()
        service.thread.join()


@contextlib.contextmanager
def client_of(service, path="/v6.json", policies=POLICIES):
    with connect(f"ws://127.0.0.1:{service.port}{path}", compression=None, close_timeout=0.5) as connection:
        for policy in policies:
            connection.send(policy)
        yield connection


def ask(service, request, **fields):
    with ControlClient("127.0.0.1", service.control_port) as control:
        return control.ask(request, **fields)


def receive(connection):
    return json.loads(connection.recv(1.0))


def received(connection, seconds):
    """What comes in the next so many seconds."""
    end, texts = clock.monotonic() + seconds, []
    with contextlib.suppress(TimeoutError):
        while True:
            texts.append(json.loads(connection.recv(max(1e-6, end - clock.monotonic()))))
    return texts


def test_header_then_device_event_then_frames(start):
    with client_of(start()) as connection:
        assert receive(connection) == {"version": 6, "serviceVersion": "2.3.1+simulated", "simulated": True}
        event = receive(connection)["event"]
        assert event["type"] == "deviceEvent"
        assert event["state"] == {"attached": True, "streaming": True, "type": "Peripheral", "id": event["state"]["id"]}
        frames = received(connection, 1.0)
        ids = [frame["id"] for frame in frames]
        assert ids == list(range(ids[0], ids[0] + len(ids))) and len(ids) == pytest.approx(FRAME_RATE, rel=0.05)
        assert all({"hands", "pointables", "timestamp", "currentFrameRate"} <= set(frame) for frame in frames)


@pytest.mark.parametrize(
    ("path", "header", "event"),
    [
        ("/v5.json", {"version": 5, "serviceVersion": "2.3.1+simulated", "simulated": True}, "deviceEvent"),
        ("/v4.json", {"version": 4, "simulated": True}, "deviceConnect"),
        ("/v2.json", {"version": 2, "simulated": True}, None),
        ("/", {"version": 1, "simulated": True}, None),
    ],
)
def test_lower_versions(start, path, header, event):
    with client_of(start(), path) as connection:
        assert receive(connection) == header
        second = receive(connection)
        assert second.get("event", {}).get("type") == event
        frame = second if event is None else receive(connection)
        assert "hands" in frame


@pytest.mark.parametrize("path", ["/v7.json", "/v99.json", "/other"])
def test_unknown_versions_are_closed_with_1001_before_any_header(start, path):
    with client_of(start(), path, policies=()) as connection:
        with pytest.raises(ConnectionClosed) as closed:
            connection.recv(1.0)
        assert closed.value.rcvd.code == 1001


def test_several_clients_get_the_same_frames(start):
    service = start()
    with client_of(service) as first, client_of(service) as second:
        for connection in (first, second):
            receive(connection), receive(connection)
        frames = received(second, 0.5)
        assert len(frames) > 40 and received(first, 0.0)[-len(frames) :] == frames
        assert ask(service, "state")["clients"] == 2


def test_paused_it_sends_empty_frames_until_asked_to_play(start):
    service = start(playing=False)
    with client_of(service) as connection:
        assert not any(frame["hands"] for frame in received(connection, 1.0)[2:])
        assert ask(service, "state")["playing"] is False
        ask(service, "play")
        frames = received(connection, 2.0)
        assert frames[-1]["hands"]
        state = ask(service, "state")
        assert state["playing"] is True and state["position"] == pytest.approx(2.0 * FRAME_RATE, abs=2)
        assert state["frames_sent"] >= 3.0 * FRAME_RATE - 5
        ask(service, "pause")
        received(connection, FRAME_S + SOON_S)  # in which one comes that was made before
        assert not any(frame["hands"] for frame in received(connection, 1.0))


def test_an_unplugged_device_is_reported_and_silent(start):
    service = start()
    client = LeapClient(port=service.port, runtime=clock)
    assert client.next_frame(1.0)
    ask(service, "unplug")
    clock.sleep(2 * FRAME_S + SILENCE_S + SOON_S)
    assert client.status.link is LeapLink.SILENT and "not plugged in" in client.status.sentence
    ask(service, "plug")
    clock.sleep(2 * FRAME_S + SOON_S)
    assert client.status.link is LeapLink.STREAMING
    client.close()


def test_a_request_that_is_being_answered_when_the_service_ends_is_carried_out(start, wires):
    def play_late():
        service.stop()
        clock.sleep(LONGEST_SLEEP_S + SOON_S)
        with pytest.raises(ConnectionRefusedError):
            wires.connect((service.host, service.port))
        clock.sleep(0.3)
        service._do(service._playback.play)

    service = start(playing=False, requests={"play_late": play_late})
    with pytest.raises(DeviceError):  # its connection is closed by then
        ask(service, "play_late")
    assert not service._playback.playing
    service.thread.join()
    assert service._playback.playing


def test_a_port_in_use_and_a_foreign_address_are_refused(start):
    service = start()
    with pytest.raises(DeviceError):
        SimulatedLeapService(Playback(ScriptedOperator(Script())), "127.0.0.1", service.port, 0)
    with pytest.raises(DeviceError):
        SimulatedLeapService(Playback(ScriptedOperator(Script())), "0.0.0.0", 0, 0)


def test_a_machine_that_cannot_keep_up_sends_fewer_frames_but_never_none(monkeypatch, start):
    play = Playback.next

    def slow(playback):
        clock.sleep(0.02)
        return play(playback)

    monkeypatch.setattr(Playback, "next", slow)
    with client_of(start()) as connection:
        receive(connection), receive(connection)
        counts = [len(received(connection, 1.0)) for _ in range(5)]
        assert all(4 <= count <= 6 for count in counts), "until they are late by 0.05 s, and again from 0.5 s on"


@pytest.mark.real
def test_the_program_says_where_it_listens_has_its_faults_and_ends_with_an_interrupt(processes, wait_until):
    options = ("--port", "0", "--control-port", "0", "--paused", "--fault", "low_rate:600:20")
    process = processes.start(sys.executable, str(SCRIPT), *options, "__name:=leapd", "__log:=/dev/null")
    wait_until(lambda: process.log_path.read_text().endswith("\n"), 20.0, "the ready line")
    line = process.log_path.read_text()
    words = line.replace(",", "").split()
    assert words[:3] == ["leapd:", "listening", "on"]
    address, control = words[3], words[6]
    with ControlClient("127.0.0.1", int(control.rpartition(":")[2]), 60.0) as client:
        assert client.ask("state")["playing"] is False
        on = [entry for entry in client.ask("faults")["faults"] if entry["on"]]
    assert [(entry["name"], entry["value"]) for entry in on] == [("low_rate", 20.0)]
    leap = LeapClient(port=int(address.rpartition(":")[2]))
    assert leap.next_frame(60.0) is not None
    assert processes.end(process) == 0
    leap.close()
    assert process.log_path.read_text() == line, "one line, and no traceback at the end"


def test_the_program_refuses_a_missing_recording(capsys, tmp_path):
    assert main(["--port", "0", "--control-port", "0", "--recording", str(tmp_path / "none.jsonl")]) == 1
    assert "cannot be read" in capsys.readouterr().err


def test_negative_offsets_can_be_given():
    assert parse(["--offset", "-50", "190", "-0.5", "__name:=leapd"]).offset == [-50.0, 190.0, -0.5]
