"""The client against what the published server really said: excerpts here, the whole recordings where they are."""

import ast
import re

import numpy as np
import pytest

from common import clock
from common.poses import translation
from kst.client import KstClient
from kst.codec import Feedback
from kst.session import KstTiming

HOME = np.array([-0.7854, 0.5236, 0.0, -1.39626, 0.0, 1.22173, 0.0])
WAITS = KstTiming(rest=0.0)  # the client of the recording did not watch the arm before the stop

PTP_EXCERPT = r"""
1.0 > 'TFtrans_0.0_0.0_106.0_0.0_0.0_0.0_\n'
1.0 < 'done\n'
1.1 > 'jRelVel_0.25_\n'
1.1 < 'done\n'
1.2 > 'jp_-0.78540_0.52360_0.00000_-1.39626_0.00000_1.22173_0.00000_\n'
1.2 < 'done\n'
1.3 > 'doPTPinJS\n'
1.3 < 'done\n'
1.4 > 'getJointsPositions\n'
1.4 < '-1.3405321274206328E-5_8.936880849470885E-6_0.0_-2.383156847762074E-5_0.0_2.0852665088281255E-5_0.0_\n'
4.8 < 'done\n'
4.9 > 'getPin3\n'
4.9 < '1\n'
4.9 < '\n'
5.0 > 'Eef_force\n'
5.0 < '0.0_0.0_0.0_\n'
5.1 > 'end\n'
5.1 < 'EOF'
"""


def wait_for_arrival(client):
    while not client.ptp_arrived():
        clock.sleep(0.001)


CALLS = {
    "getJointsPositions": lambda client, _: client.joints(),
    "Torques_ext_J": lambda client, _: client.external_torques(),
    "Torques_m_J": lambda client, _: client.measured_torques(),
    "Eef_pos": lambda client, _: client.pose(),
    "Eef_force": lambda client, _: client.force(),
    "Eef_moment": lambda client, _: client.moment(),
    "blueOn": lambda client, _: client.set_blue(True),
    "blueOff": lambda client, _: client.set_blue(False),
    "pin1on": lambda client, _: client.set_pin(1, True),
    "getPin3": lambda client, _: client.pin(3),
    "arrival": lambda client, _: wait_for_arrival(client),
    "stopDirectServoJoints": lambda client, _: client.stop_joint_servo(),
    "jp": lambda client, q: client.servo(q),
    "jf": lambda client, q: client.servo(q, Feedback.NOTHING),
    "jpJP": lambda client, q: client.servo(q, Feedback.JOINTS),
    "jpExT": lambda client, q: client.servo(q, Feedback.EXTERNAL_TORQUES),
    "jpMT": lambda client, q: client.servo(q, Feedback.MEASURED_TORQUES),
    "jpEEfP": lambda client, q: client.servo(q, Feedback.POSE),
    "jpEEfFrelEEF": lambda client, q: client.servo(q, Feedback.FORCE),
    "end": lambda client, _: client.close(),
}


def events(text):
    """The sent and received texts of a recording, without what stayed unanswered."""
    found = re.findall(r"^ *[\d.]+ ([<>]) ('.*')$", text, re.MULTILINE)
    pairs = [(direction, ast.literal_eval(quoted)) for direction, quoted in found]
    silent = {i for i, (_, said) in enumerate(pairs) if said.startswith("(nothing")}
    return [pair for i, pair in enumerate(pairs) if not {i, i + 1} & silent]


def spoken(line):
    """A line as its word and its numbers."""
    word, *numbers = line.strip().split("_")
    if not (numbers and numbers[-1] == ""):
        return line.strip(), []
    return word, [float(number) for number in numbers[:-1]]


class Replay:
    """Says the server's part of a recording to one client and checks the client's part."""

    def __init__(self, wires, script):
        self.faults = []
        self._script = script
        self._listener = wires.serve(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._thread = clock.Thread(target=self._serve, name="server", daemon=True)
        self._thread.start()

    def finish(self):
        self._thread.join(1.0)
        assert not self._thread.is_alive()
        assert self.faults == []

    def _serve(self):
        connection, _ = self._listener.accept()
        with connection, connection.makefile("rb") as reader:
            for direction, text in self._script:
                if direction == "<":
                    if text != "EOF":
                        connection.sendall(text.encode())
                    continue
                came, expected = spoken(reader.readline().decode()), spoken(text)
                if came[0] != expected[0] or not np.allclose(came[1], expected[1], rtol=0.0, atol=1e-12):
                    self.faults.append((came, expected))
                    return


def steps(script):
    """The words and numbers of the client's lines, and `arrival` where the server speaks unasked."""
    before = [("<", ""), *script]
    for (previous, _), (direction, text) in zip(before, script):
        if direction == ">":
            yield spoken(text)
        elif previous == "<" and text == "done\n":
            yield "arrival", []


def play(wires, script):
    """Calls the client so that it says its part; returns the client and what its calls returned."""
    replay = Replay(wires, script)
    said = list(steps(script))
    tool = translation(*(0.001 * x for x in said[0][1][:3]))
    client = KstClient.connect("127.0.0.1", replay.port, tool, timing=WAITS)
    results = []
    i = 1
    while i < len(said):
        word, numbers = said[i]
        following = [word for word, _ in said[i + 1 : i + 3]]
        if word == "jRelVel" and following == ["jp", "doPTPinJS"]:
            client.start_ptp_joints(said[i + 1][1], numbers[0])
            i += 3
        elif word == "getJointsPositions" and following == ["jp", "startDirectServoJoints"]:
            client.start_joint_servo()
            i += 3
        else:
            results.append(CALLS[word](client, numbers))
            i += 1
    replay.finish()
    return client, [result for result in results if result is not None]


def test_a_motion_as_recorded(wires):
    client, (joints, pin, force) = play(wires, events(PTP_EXCERPT))
    np.testing.assert_allclose(joints[:2], [-1.3405321274206328e-5, 8.936880849470885e-6])
    assert pin is True
    np.testing.assert_array_equal(force, np.zeros(3))
    assert client.counts.stray == client.counts.missed == client.counts.foreign == 0


@pytest.mark.parametrize("name", ["ptp", "servo"])
def test_the_whole_recording(wires, shared_data, name):
    client, results = play(wires, events((shared_data / "kst" / f"{name}.txt").read_text()))
    assert all(np.all(np.isfinite(result)) for result in results)
    assert client.counts.stray == client.counts.missed == client.counts.foreign == 0
    last_joints = [result for result in results if np.shape(result) == (7,)][-1]
    expected = np.zeros(7) if name == "ptp" else np.array([-0.7573589273439677, *HOME[1:]])
    np.testing.assert_array_equal(last_joints, expected)
