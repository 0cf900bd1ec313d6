"""Every fault of the simulated Leap service in virtual time, as a plain WebSocket client sees it; and its end."""

from __future__ import annotations

import contextlib
import json
import math

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import connect

from common import clock
from leap_motion import codec
from leap_motion.service import wire
from rig_simulation.control_port import ControlClient
from rig_simulation.devices.leap.sensing import FRAME_RATE
from rig_simulation.devices.leap.server import SimulatedLeapService
from rig_simulation.faults.injection import Faults
from rig_simulation.faults.leap import LEAP_FAULTS, FrameStream
from rig_simulation.operator.motion import Script
from rig_simulation.operator.sources import Playback, ScriptedOperator
from simulated.wires import DELAY_S

SEEN_S = 3.0 / FRAME_RATE + 10 * DELAY_S
"""After which a fault shows: the frame that was made before is sent as it is, and one in many is lost."""
POLL_S = 0.02
"""How often the service looks whether a fault of its connections is over."""
REQUEST = (
    b"GET /v6.json HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


class Client:
    """A client that asked for frames and got header and event."""

    def __init__(self, service):
        self.connection = connect(f"ws://127.0.0.1:{service.port}/v6.json", compression=None, close_timeout=0.5)
        self.connection.send('{"background":true}')
        self.header, self.event = (json.loads(self.connection.recv(1.0)) for _ in range(2))

    def messages(self, seconds):
        """What comes in the next so many seconds: when, and what."""
        end, came = clock.monotonic() + seconds, []
        with contextlib.suppress(TimeoutError):
            while True:
                text = self.connection.recv(max(1e-6, end - clock.monotonic()))
                came.append((clock.monotonic(), text))
        return came

    def frames(self, seconds):
        """The frames of the next so many seconds."""
        return [json.loads(text) for _, text in self.messages(seconds)]


@pytest.fixture
def service(wires):
    service = SimulatedLeapService(Playback(ScriptedOperator(Script(speed=600.0))), "127.0.0.1", 0, 0)
    thread = clock.Thread(target=service.run, daemon=True)
    thread.start()
    yield service
    service.stop()
    thread.join()


@pytest.fixture
def client(service):
    client = Client(service)
    yield client
    client.connection.close()


@pytest.fixture
def fault(service):
    """Switches a fault and waits until it shows."""
    with ControlClient("127.0.0.1", service.control_port) as control:

        def switch(name, after=SEEN_S, **fields):
            control.ask("fault", name=name, **fields)
            clock.sleep(after)

        yield switch


def served(service):
    """Whether a new client gets frames at once."""
    try:
        new = Client(service)
        came = new.frames(SEEN_S)
        new.connection.close()
        return bool(came)
    except (OSError, ConnectionClosed, InvalidHandshake, EOFError):
        return False


def test_cut(client, service, fault, wires):
    assert client.frames(0.1)
    fault("cut")
    with pytest.raises(ConnectionClosed) as closed:
        client.messages(1.0)
    assert closed.value.rcvd is None, "no close frame came"
    with wires.connect((service.host, service.port)) as plain:
        plain.sendall(REQUEST)
        with pytest.raises(ConnectionResetError):
            plain.recv(100)
    assert not served(service)
    fault("cut", on=False)
    assert served(service)


def test_half_open(client, service, fault):
    fault("half_open")
    client.messages(0.0)
    pong = client.connection.ping()
    assert client.messages(5.0) == [] and not pong.is_set(), "not even pings are answered"
    with pytest.raises(TimeoutError):
        connect(f"ws://127.0.0.1:{service.port}/v6.json", open_timeout=0.3)
    fault("half_open", on=False, after=POLL_S)
    assert client.frames(SEEN_S) and pong.is_set()


def test_silent(client, fault):
    fault("silent")
    client.messages(0.0)
    pong = client.connection.ping()
    assert client.messages(5.0) == [] and pong.is_set(), "pings are answered"
    fault("silent", on=False)
    assert client.frames(SEEN_S)


def test_restarted(client, service, fault, wires):
    assert client.frames(1.0)[-1]["id"] > 100
    fault("restarted")
    with pytest.raises(ConnectionClosed) as closed:
        client.messages(1.0)
    assert closed.value.rcvd.code == 1001
    with pytest.raises(ConnectionRefusedError):
        wires.connect((service.host, service.port))
    fault("restarted", on=False, after=POLL_S)
    assert Client(service).frames(SEEN_S)[0]["id"] <= 3, "ids begin anew"


def test_unplugged(client, fault):
    assert client.frames(0.1)
    fault("unplugged")
    assert client.frames(5.0)[-1]["event"]["state"]["attached"] is False
    fault("unplugged", on=False)
    event, *frames = client.frames(SEEN_S)
    assert event["event"]["state"]["attached"] is True
    assert frames and all("hands" in frame for frame in frames)


def test_frozen(client, fault):
    fault("frozen")
    client.messages(0.0)
    came = [text for _, text in client.messages(1.0)]
    assert len(came) > 100 and len(set(came)) == 1
    fault("frozen", on=False)
    client.messages(0.0)
    assert len({text for _, text in client.messages(1.0)}) > 100


def test_bursts(client, fault):
    first = client.frames(0.1)[-1]["id"]
    fault("bursts", value=0.5)
    came = client.messages(3.2)
    times = np.array([time for time, _ in came])
    pauses = np.diff(times)[np.diff(times) > 0.1]
    assert pauses == pytest.approx(np.full(6, 0.5), abs=SEEN_S), "silence between two bursts"
    fault("bursts", on=False)
    ids = [json.loads(text)["id"] for _, text in [*came, *client.messages(1.0)]]
    assert ids == list(range(first + 1, first + 1 + len(ids))), "nothing is lost"


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("low_confidence", lambda frame: frame["hands"][0]["confidence"] == 0.02),
    ],
)
def test_faults_of_hands_on_the_wire(client, fault, name, changed):
    assert client.frames(1.0)[-1]["hands"]
    fault(name)
    client.messages(0.0)
    assert all(map(changed, client.frames(0.1)))
    fault(name, on=False)
    client.messages(0.0)
    assert not any(map(changed, client.frames(0.1)))


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
