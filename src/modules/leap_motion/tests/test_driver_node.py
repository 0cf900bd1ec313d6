"""The node leap_driver: what it publishes, how it waits, how it ends."""

import json
import threading

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import serve

pytestmark = pytest.mark.ros

RIGHT_HAND = {
    "id": 3,
    "type": "right",
    "palmPosition": [0, 350, 0],
    "palmNormal": [0, -1, 0],
    "direction": [0, 0, -1],
    "confidence": 1,
}


class Service:
    """Sends a frame with a hand and one without, in turn, at 50 Hz; the frame `bad` is torn."""

    def __init__(self, port=0):
        self._ended = threading.Event()
        self._server = serve(self._handle, "127.0.0.1", port)
        self.port = self._server.socket.getsockname()[1]
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def _handle(self, connection):
        number = 0
        try:
            connection.send('{"version":6,"serviceVersion":"2.3.1+test"}')
            while not self._ended.wait(0.02):
                number += 1
                hands = [RIGHT_HAND] if number % 2 else []
                frame = {"id": number, "timestamp": number * 20000, "hands": hands, "pointables": []}
                connection.send("{torn" if number == 5 else json.dumps(frame))
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
    wait_until(lambda: stages, 10.0, "the first stage time")
    begin = len(humans)  # what was sent before the test was connected to the stage times is lost
    humans.wait(begin + 10)
    stamps = {human.header.stamp.to_nsec() for human in humans[begin:]}
    wait_until(lambda: stamps <= {s.header.stamp.to_nsec() for s in stages}, 10.0, "the stage times")
    assert {stage.source for stage in stages} == {"leap_motion"}
    status = wait_until(
        lambda: next((s for s in statuses(arrays) if values(s)["state"] == "streaming"), None), 10.0, "diagnostics"
    )
    assert values(status)["service_version"] == "2.3.1+test"
    assert int(values(status)["frames_received"]) > 0
    assert values(status)["reconnects"] == "0"
    wait_until(lambda: values(statuses(arrays)[-1])["frames_dropped"] == "1", 10.0, "the torn frame")


def test_waits_for_the_service_and_goes_on_when_it_appears(ros, free_port, wait_until):
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


@pytest.mark.parametrize(
    ("parameter", "sentence"),
    [
        ("_port:=0", "~port is 0, but must be"),
        ("_port:=leap", "~port is 'leap', but must be"),
        ("_orientation:=both", "~orientation is 'both', but must be"),
        ("_prot:=6437", "~prot is not a known key"),
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
