"""Every fault of the simulated Leap service, seen by a plain WebSocket client or socket; and that it ends again."""

from __future__ import annotations

import contextlib
import json
import math
import socket
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import connect

from common.errors import DeviceError
from leap_motion import codec
from leap_motion.service import wire
from rig_simulation.control_port import ControlClient
from rig_simulation.devices.leap.server import SimulatedLeapService
from rig_simulation.faults.injection import Faults
from rig_simulation.faults.leap import LEAP_FAULTS, FrameStream
from rig_simulation.operator.motion import Script
from rig_simulation.operator.sources import Playback, ScriptedOperator

SCRIPT = Path(__file__).parents[1] / "scripts" / "leapd.py"
SOON_S = 60.0
SOON_FRAMES = 1000


class Client:
    """A client that asked for frames and got the header."""

    def __init__(self, service):
        self.connection = connect(f"ws://127.0.0.1:{service.port}/v6.json", compression=None, close_timeout=0.5)
        self.connection.send('{"background":true}')
        self.header = json.loads(self.connection.recv(SOON_S))

    def message(self, timeout=SOON_S):
        return self.connection.recv(timeout)

    def frame(self, timeout=SOON_S):
        """Returns the next message that is a frame."""
        while True:
            frame = json.loads(self.message(timeout))
            if "event" not in frame:
                return frame

    def hand(self):
        """Returns the first hand of the next frame that holds one."""
        while True:
            frame = self.frame()
            if frame["hands"]:
                return frame["hands"][0]

    def silent(self, seconds=0.3):
        try:
            self.connection.recv(seconds)
        except TimeoutError:
            return True
        return False


@pytest.fixture
def service():
    service = SimulatedLeapService(Playback(ScriptedOperator(Script(speed=600.0))), "127.0.0.1", 0, 0)
    thread = threading.Thread(target=service.run, daemon=True)
    thread.start()
    yield service
    service.stop()
    thread.join(SOON_S)
    assert not thread.is_alive()


@pytest.fixture
def new_client(service):
    with contextlib.ExitStack() as stack:

        def new_client():
            client = Client(service)
            stack.callback(client.connection.close)
            return client

        yield new_client


@pytest.fixture
def client(new_client):
    return new_client()


@pytest.fixture
def fault(service):
    with ControlClient("127.0.0.1", service.control_port, SOON_S) as control:
        yield lambda name, **fields: control.ask("fault", name=name, **fields)


def served(new_client):
    """Returns whether a new client gets frames."""
    try:
        return "hands" in new_client().frame()
    except (OSError, ConnectionClosed, InvalidHandshake, EOFError):
        return False


def test_cut(client, new_client, service, fault, wait_until):
    client.frame()
    fault("cut")
    with pytest.raises(ConnectionClosed) as closed:
        for _ in range(SOON_FRAMES):
            client.frame()
    assert closed.value.rcvd is None, "no close frame came"
    with socket.create_connection((service.host, service.port), SOON_S) as plain:
        plain.settimeout(SOON_S)
        plain.sendall(
            b"GET /v6.json HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
        )
        with pytest.raises(ConnectionResetError):
            plain.recv(100)
    assert not served(new_client)
    fault("cut", on=False)
    wait_until(lambda: served(new_client), SOON_S, "a new client to be served")


def test_half_open(client, service, fault, wait_until):
    client.frame()
    fault("half_open")
    wait_until(client.silent, SOON_S, "silence")
    pong = client.connection.ping()
    assert not pong.wait(0.3), "not even pings are answered"
    with pytest.raises(TimeoutError):
        connect(f"ws://127.0.0.1:{service.port}/v6.json", open_timeout=0.3)
    fault("half_open", on=False)
    # This client takes no pong while a frame waits to be read.
    wait_until(lambda: "hands" in client.frame() and pong.is_set(), SOON_S, "frames and the pong")


def test_silent(client, fault, wait_until):
    client.frame()
    fault("silent")
    wait_until(client.silent, SOON_S, "silence")
    assert client.connection.ping().wait(SOON_S), "pings are answered"
    fault("silent", on=False)
    assert "hands" in client.frame()


def test_restarted(client, service, new_client, fault, wait_until):
    while client.frame()["id"] < 30:
        pass
    fault("restarted")
    with pytest.raises(ConnectionClosed) as closed:
        for _ in range(SOON_FRAMES):
            client.frame()
    assert closed.value.rcvd.code == 1001
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((service.host, service.port), SOON_S)
    fault("restarted", on=False)
    wait_until(lambda: served(new_client), SOON_S, "a new client to be served on the same port")


def test_ids_and_clock_begin_anew_after_a_restart():
    playback = Playback(ScriptedOperator(Script()))
    first = json.loads(playback.next().text)
    playback.next()
    playback.restart()
    again = json.loads(playback.next().text)
    assert first["id"] == again["id"] == 1
    assert again["timestamp"] < first["timestamp"] + 30_000


@pytest.mark.clock
def test_unplugged(client, fault):
    client.frame()
    fault("unplugged")
    messages = (json.loads(client.message()) for _ in range(SOON_FRAMES))
    event = next(message for message in messages if "event" in message)
    assert event["event"]["state"]["attached"] is False
    assert client.silent()
    fault("unplugged", on=False)
    assert json.loads(client.message())["event"]["state"]["attached"] is True
    assert "hands" in client.frame()


def test_frozen(client, fault, wait_until):
    fault("frozen")
    wait_until(lambda: client.message() == client.message(), SOON_S, "the same frame again")
    frame = client.message()
    assert [client.message() for _ in range(5)] == [frame] * 5
    fault("frozen", on=False)
    wait_until(lambda: client.message() != client.message(), SOON_S, "other frames")


def test_bursts(client, fault, wait_until):
    client.frame()
    fault("bursts", value=0.5)
    wait_until(lambda: client.silent(0.25), SOON_S, "the silence between two bursts")
    held = client.frame()["id"]
    assert client.frame()["id"] == held + 1, "the frames held back come one behind the other"
    fault("bursts", on=False)
    frames = [client.frame() for _ in range(100)]
    assert [frame["id"] for frame in frames] == sorted({frame["id"] for frame in frames})


def test_garbled(client, fault, wait_until):
    fault("garbled")
    seen = set()

    def kinds():
        message = client.message()
        try:
            frame = json.loads(message)
            seen.add("without hands" if "hands" not in frame else "bad hand" if frame["hands"] else "NaN")
        except ValueError:
            seen.add("no JSON")
        return len(seen) >= 3

    wait_until(kinds, SOON_S, "several kinds of garbage")
    fault("garbled", on=False)
    wait_until(lambda: _is_frame(client.message()), SOON_S, "frames")
    assert all(_is_frame(client.message()) for _ in range(10))


def _is_frame(text):
    try:
        frame = json.loads(text)
        return isinstance(frame["timestamp"], int) and all("palmNormal" in hand for hand in frame["hands"])
    except (ValueError, KeyError):
        return False


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("hand_lost", lambda frame: not frame["hands"] and not frame["pointables"]),
        ("hand_swapped", lambda frame: frame["hands"][0]["type"] == "left"),
        ("second_hand", lambda frame: len(frame["hands"]) == 2 and len(frame["pointables"]) == 10),
        ("low_confidence", lambda frame: frame["hands"][0]["confidence"] == 0.02),
    ],
)
def test_faults_of_hands_on_the_wire(client, fault, wait_until, name, changed):
    client.hand()
    fault(name)
    wait_until(lambda: changed(client.frame()), SOON_S, name)
    fault(name, on=False)
    wait_until(lambda: not changed(client.frame()), SOON_S, "its end")


@pytest.mark.clock
def test_an_unknown_fault_is_refused(fault):
    with pytest.raises(DeviceError):
        fault("dance")


def test_faults_of_the_command_line(processes, wait_until):
    process = processes.start(
        sys.executable, str(SCRIPT), "--port", "0", "--control-port", "0", "--fault", "low_rate:60:20"
    )
    line = wait_until(process.log_path.read_text, 30.0, "the ready line")
    with ControlClient("127.0.0.1", int(line.split()[6].rpartition(":")[2]), SOON_S) as control:
        on = [entry for entry in control.ask("faults")["faults"] if entry["on"]]
    assert [(entry["name"], entry["value"]) for entry in on] == [("low_rate", 20.0)]


PERIOD_S = 1.0 / 128.0


class Frames:
    """Frames of a hand through the stream's faults, on a clock of their own: a frame every PERIOD_S."""

    def __init__(self):
        self.now = 0.0
        self.faults = Faults(LEAP_FAULTS, lambda: self.now)
        self.stream = FrameStream(self.faults)
        self.playback = Playback(ScriptedOperator(Script(speed=100.0)))
        while not json.loads(self.playback.next().text)["hands"]:
            pass

    def next(self, count):
        """Returns a list for each of the next frames: what goes out at its time."""
        out = []
        for _ in range(count):
            self.now += PERIOD_S
            out.append([json.loads(text) for text in self.stream.pass_on(self.playback.next().text, self.now)])
        return out


@pytest.fixture
def frames():
    return Frames()


def ids(batch):
    return [frame["id"] for frame in batch]


def palms(out):
    return np.array([frame["hands"][0]["palmPosition"] for batch in out for frame in batch])


def test_without_faults_every_frame_goes_out_at_once_and_unchanged(frames):
    text = frames.playback.next().text
    assert frames.stream.pass_on(text, 0.0) == [text]


def test_slow_frames_keep_order_and_rate(frames):
    first = frames.next(1)[0][0]["id"]
    frames.faults.switch("slow", value=10 * PERIOD_S)
    out = frames.next(30)
    assert out[:10] == [[]] * 10
    assert [ids(batch) for batch in out[10:]] == [[first + k] for k in range(1, 21)]
    frames.faults.switch("slow", on=False)
    assert [ids(batch) for batch in frames.next(12)][-1] == [first + 42]
    assert sum(map(len, out)) == 20


def test_bursts_lose_nothing(frames):
    frames.faults.switch("bursts", value=10 * PERIOD_S)
    out = [ids(batch) for batch in frames.next(50)]
    sent = [number for batch in out for number in batch]
    assert sent == list(range(sent[0], sent[0] + len(sent)))
    assert sum(not batch for batch in out) >= 44
    assert max(map(len, out)) == 10


@pytest.mark.parametrize("rate", [10.0, 50.0])
def test_low_rate_leaves_frames_out(frames, rate):
    frames.faults.switch("low_rate", value=rate)
    assert sum(map(len, frames.next(320))) == pytest.approx(2.5 * rate, abs=1)


def test_silent_for_a_share(frames):
    frames.faults.switch("silent", value=0.5)
    assert 60 < sum(map(len, frames.next(200))) < 140


def test_outliers_are_single_frames(frames):
    frames.faults.switch("outliers", value=200.0)
    steps = np.diff(palms(frames.next(110))[:, 1])
    up, down = np.flatnonzero(steps > 150.0), np.flatnonzero(steps < -150.0)
    assert len(up) >= 2
    np.testing.assert_array_equal(down, up + 1)


def test_a_moved_hand_has_a_new_id_there_and_again_at_the_end(frames):
    before = frames.next(1)[0][0]["hands"][0]
    frames.faults.switch("hand_moved", value=120.0)
    moved = frames.next(1)[0][0]
    hand = moved["hands"][0]
    assert hand["palmPosition"][0] - before["palmPosition"][0] == pytest.approx(120.0, abs=5.0)
    assert hand["id"] > before["id"]
    assert {finger["handId"] for finger in moved["pointables"]} == {hand["id"]}
    frames.faults.switch("hand_moved", on=False)
    after = frames.next(1)[0][0]["hands"][0]
    assert after["id"] > hand["id"], "an id that is gone does not come back"
    assert after["palmPosition"][0] - before["palmPosition"][0] == pytest.approx(0.0, abs=5.0)


def test_the_bones_of_a_swapped_hand_are_those_of_the_other_side(frames):
    bases = [np.array(f["bases"]) for f in frames.next(1)[0][0]["pointables"]]
    assert all(np.linalg.det(basis) > 0.9 for finger in bases for basis in finger)
    frames.faults.switch("hand_swapped")
    swapped = frames.next(1)[0][0]
    assert all(np.linalg.det(basis) < -0.9 for f in swapped["pointables"] for basis in np.array(f["bases"]))
    assert np.linalg.det(swapped["hands"][0]["armBasis"]) < -0.9


def test_a_swapped_hand_is_one_and_a_mirrored_or_scaled_one_is_refused(frames):
    read = codec.read_message
    text = wire.text(frames.next(1)[0][0])
    assert [hand.side for hand in read(text).hands] == ["right"]
    frames.faults.switch("hand_swapped")
    assert [hand.side for hand in read(wire.text(frames.next(1)[0][0])).hands] == ["left"]
    frames.faults.switch("hand_swapped", on=False)
    for name, value, reason in (("mirrored", None, "axes are mirrored"), ("scaled", 0.1, "not millimetres")):
        frames.faults.switch(name, value=value)
        frame = read(wire.text(frames.next(1)[0][0]))
        assert not frame.hands and reason in frame.left_out[0]
        frames.faults.switch(name, on=False)
    assert read(wire.text(frames.next(1)[0][0])).hands


def test_a_second_hand_is_whole(frames):
    frames.faults.switch("second_hand", value=-200.0)
    frame = frames.next(1)[0][0]
    first, second = frame["hands"]
    assert second["palmPosition"][0] - first["palmPosition"][0] == pytest.approx(-200.0)
    for hand in (first, second):
        assert sorted(f["type"] for f in frame["pointables"] if f["handId"] == hand["id"]) == [0, 1, 2, 3, 4]


def test_garbage_is_of_every_kind_and_some_frames_pass_by_share(frames):
    frames.faults.switch("garbled", value=0.5)
    good, kinds = 0, set()
    for _ in range(200):
        frames.now += PERIOD_S
        text = frames.stream.pass_on(frames.playback.next().text, frames.now)[0]
        try:
            message = json.loads(text)
        except ValueError:
            kinds.add("no JSON")
            continue
        if "hands" not in message:
            kinds.add("no hands")
        elif any("palmNormal" not in hand for hand in message["hands"]):
            kinds.add("broken hand")
        elif math.isnan(message["timestamp"]):
            kinds.add("NaN")
        else:
            good += 1
    assert kinds == {"no JSON", "no hands", "broken hand", "NaN"}
    assert 60 < good < 140
