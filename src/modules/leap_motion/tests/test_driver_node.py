"""The node leap_driver: what it publishes, how it waits, how it ends."""

import json
import threading
from datetime import datetime
from types import SimpleNamespace

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import serve

from leap_motion.client import LeapCounts, LeapLink, LeapStatus
from leap_motion.frames import LeapFrame
from leap_motion.registration import PointFit
from leap_motion.ros.registrations import registration_file, store

pytestmark = pytest.mark.ros

RIGHT_HAND = {
    "id": 3,
    "type": "right",
    "palmPosition": [0, 350, 0],
    "palmNormal": [0, -1, 0],
    "direction": [0, 0, -1],
    "confidence": 1,
}

SOURCES = ("received", "leap_motion")


class Service:
    """Sends a frame with a hand and one without, in turn, at 50 Hz. `serial`: of the tracker. While `torn` is set it
    sends one torn frame, and none that the driver could take in its place.
    """

    def __init__(self, port=0, serial=None):
        self.serial, self.torn = serial, threading.Event()
        self._ended = threading.Event()
        self._server = serve(self._handle, "127.0.0.1", port)
        self.port = self._server.socket.getsockname()[1]
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def _handle(self, connection):
        number, announced, tore = 0, None, False
        try:
            connection.send('{"version":6,"serviceVersion":"2.3.1+test"}')
            while not self._ended.wait(0.02):
                if self.torn.is_set():
                    if not tore:
                        connection.send("{torn")
                    tore = True
                    continue
                number += 1
                if self.serial != announced:
                    announced = self.serial
                    state = {"attached": True, "streaming": True, "id": announced, "type": "Peripheral"}
                    connection.send(json.dumps({"event": {"type": "deviceEvent", "state": state}}))
                hands = [RIGHT_HAND] if number % 2 else []
                frame = {"id": number, "timestamp": number * 20000, "hands": hands, "pointables": []}
                connection.send(json.dumps(frame))
        except ConnectionClosed:
            pass

    def close(self):
        self._ended.set()
        self._server.shutdown()


@pytest.fixture
def service():
    service = Service()
    yield service
    service.close()


def statuses(array_messages):
    return [status for array in array_messages for status in array.status if status.name == "leap_motion"]


def values(status):
    return {pair.key: pair.value for pair in status.values}


def test_publishes_every_frame_and_says_what_it_counts(ros, service, wait_until):
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import TimeReference

    from leap_motion.msg import Human

    humans = ros.record("leap_motion/leap_device", Human)
    stages = ros.record("rig/stage_times", TimeReference)
    arrays = ros.record("/diagnostics", DiagnosticArray)
    ros.launch("leap_motion", "leap_driver.launch", port=service.port)
    humans.wait(20)
    assert {human.header.frame_id for human in humans} == {"leap_hands"}
    assert {human.right_hand.is_present for human in humans} == {True, False}
    assert not any(human.left_hand.is_present for human in humans)
    ids = [human.lmc_frame_id for human in humans]
    assert ids == sorted(set(ids))
    first = wait_until(lambda: stages, 10.0, "the first stage time")[0].header.stamp  # those before it are lost
    humans.wait(len(humans) + 10)
    stamps = {human.header.stamp.to_nsec() for human in humans if human.header.stamp >= first}
    wait_until(lambda: stamps <= {s.header.stamp.to_nsec() for s in stages}, 10.0, "the stage times")
    ends = {source: {s.header.stamp: s.time_ref for s in stages if s.source == source} for source in SOURCES}
    assert {stage.source for stage in stages} == set(SOURCES)
    assert all(stamp <= ends["received"][stamp] <= ends["leap_motion"][stamp] for stamp in ends["leap_motion"])
    status = wait_until(
        lambda: next((s for s in statuses(arrays) if values(s)["state"] == "streaming"), None), 10.0, "diagnostics"
    )
    assert values(status)["service_version"] == "2.3.1+test"
    assert values(status)["serial"] == "unknown", "this service sends no device event"
    assert int(values(status)["frames_received"]) > 0
    assert values(status)["reconnects"] == "0"
    service.torn.set()
    wait_until(lambda: values(statuses(arrays)[-1])["frames_dropped"] == "1", 10.0, "the torn frame")
    count = len(humans)
    service.torn.clear()
    humans.wait(count + 5)


def test_unusable_frames_are_a_warning_and_a_missing_service_is_an_error():
    from diagnostic_msgs.msg import DiagnosticStatus

    from leap_motion.ros.driver import LinkReport

    levels = {}
    for link in LeapLink:
        client = SimpleNamespace(status=LeapStatus(link, "A sentence."), counts=LeapCounts())
        levels[link], sentence, _ = LinkReport(client).diagnostics()
        assert sentence == "A sentence."
    assert levels.pop(LeapLink.STREAMING) == DiagnosticStatus.OK
    assert levels.pop(LeapLink.UNUSABLE) == DiagnosticStatus.WARN
    assert set(levels.values()) == {DiagnosticStatus.ERROR}


def test_waits_for_the_service_and_continues_when_it_appears(ros, free_port, wait_until):
    from leap_motion.msg import Human

    port = free_port()
    humans = ros.record("leap_motion/leap_device", Human)
    node = ros.run("leap_motion", "leap_driver.py", f"_port:={port}")
    wait_until(lambda: "sudo leapd" in node.log_path.read_text(), 20.0, "the sentence")
    assert node.poll() is None
    assert not humans
    service = Service(port)
    try:
        humans.wait(5, 20.0)
    finally:
        service.close()
    wait_until(
        lambda: "is lost" in node.log_path.read_text() or "ended the conn" in node.log_path.read_text(), 20.0, "loss"
    )
    assert node.poll() is None


def test_a_registration_counts_for_its_own_tracker_alone(ros, wait_until, tmp_path, monkeypatch):
    from diagnostic_msgs.msg import DiagnosticArray

    from leap_motion.msg import Human

    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    T = np.array([[1.0, 0.0, 0.0, 0.1], [0.0, 0.8, -0.6, 0.02], [0.0, 0.6, 0.8, 0.3], [0.0, 0.0, 0.0, 1.0]])
    store(registration_file("desk"), PointFit(T, np.array([1e-3]), 1.0), "LP1", datetime.now())
    humans = ros.record("leap_motion/leap_device", Human)
    arrays = ros.record("/diagnostics", DiagnosticArray)
    service = Service(serial="LP2")
    try:
        node = ros.run("leap_motion", "leap_driver.py", f"_port:={service.port}", "_registration:=desk")
        sentence = "The registration desk is of the tracker LP1, but LP2 is plugged in"
        wait_until(lambda: sentence in node.log_path.read_text(), 20.0, "the sentence")
        status = wait_until(lambda: next((s for s in statuses(arrays) if sentence in s.message), None), 10.0, "it")
        assert (status.level, values(status)["registration"]) == (2, "desk")
        assert not humans
        service.serial = "LP1"
        humans.wait(4, 20.0)
    finally:
        service.close()
    hand = next(human.right_hand for human in humans if human.right_hand.is_present)
    assert (hand.palm_center.x, hand.palm_center.y, hand.palm_center.z) == pytest.approx((0.1, 0.3, 0.51), abs=1e-6)
    assert (hand.direction.x, hand.direction.y, hand.direction.z) == pytest.approx((0.0, 0.6, -0.8), abs=1e-6)


@pytest.mark.parametrize(
    ("registered", "plugged", "level", "words"),
    [
        ("LP1", "LP1", 0, "It sends frames."),
        ("LP1", "LP2", 2, "is of the tracker LP1, but LP2 is plugged in"),
        ("LP1", "", 2, "but an unknown one is plugged in"),
        ("", "LP2", 2, "is of the tracker unknown, but LP2"),
        ("", "", 1, "does not say which tracker is plugged in"),
    ],
)
def test_a_registration_is_used_or_refused_by_the_serial(registered, plugged, level, words):
    from leap_motion.ros.driver import LinkReport

    status = LeapStatus(LeapLink.STREAMING, "It sends frames.", serial=plugged)
    client = SimpleNamespace(status=status, counts=LeapCounts())
    frame = LeapFrame(1, 8000, 115.0, ())
    report = LinkReport(client, SimpleNamespace(serial=registered, T_desk_leap=np.eye(4)), "desk")
    found, sentence, values = report.diagnostics()
    assert (found, values["registration"]) == (level, "desk") and words in sentence
    assert (report.frame(frame) is None) == (level == 2)


@pytest.mark.parametrize(
    ("parameter", "sentence"),
    [
        ("_port:=0", "~port is 0, but must be"),
        ("_port:=leap", "~port is 'leap', but must be"),
        ("_orientation:=both", "~orientation is 'both', but must be"),
        ("_prot:=6437", "~prot is not a known key"),
        ("_registration:=nobodys_desk", "nobodys_desk.yaml cannot be read"),
        ("_registration:=../desk", "The tracker's name is '../desk'"),
    ],
)
def test_bad_parameters_end_it_with_a_sentence(ros, parameter, sentence):
    node = ros.run("leap_motion", "leap_driver.py", parameter)
    assert node.wait(20.0) == 1
    log = node.log_path.read_text()
    assert sentence in log
    assert "Traceback" not in log


def test_ends_with_an_interrupt(ros, processes, free_port, wait_until):
    node = ros.run("leap_motion", "leap_driver.py", f"_port:={free_port()}")
    wait_until(lambda: "sudo leapd" in node.log_path.read_text(), 20.0, "the sentence")
    assert processes.end(node, 10.0) == 0
    assert "Traceback" not in node.log_path.read_text()
