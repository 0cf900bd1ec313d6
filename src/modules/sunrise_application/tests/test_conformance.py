"""Each word of the toolbox's wire, answered by the simulated controller, by the robot application, and by the server at
LEAP_RIG_ROBOT=HOST:PORT, where only the words are tried that move nothing."""

from __future__ import annotations

import os
import re
import sys

import pytest

pytestmark = pytest.mark.real

NUMBER = r"-?\d+\.\d+(E-?\d+)?_"
THREE, SIX, SEVEN = (f"({NUMBER}){{{count}}}\n" for count in (3, 6, 7))
DONE, NAK, PIN, NOTHING = "done\n", "nak\n", "[01]\n\n", ""
ZEROS = "0_0_0_0_0_0_"
STILL = [
    ("noSuchCommand", NOTHING), ("Eef_pos_", NOTHING), ("DcSeCarW_" + ZEROS, NOTHING),
    ("getJointsPositions", SEVEN), ("Torques_ext_J", SEVEN), ("Torques_m_J", SEVEN),
    ("Eef_pos", SIX), ("Eef_force", THREE), ("Eef_moment", THREE),
    ("TFtrans_0_0_106_0_0_0_", DONE), ("TFtrans_0_0_106_0_0_0_0_", NAK), ("TFtrans_x_0_0_0_0_0_", NAK),
    ("jRelVel_0.25_", DONE), ("jRelVel_abc_", NAK), ("stopDirectServoJoints", DONE),
    *((f"getPin{n}", PIN) for n in (3, 4, 10, 13, 16)),
]  # fmt: skip
"""Words and what answers them, with a regular expression."""
GOALS = [
    ("jp_" + ZEROS + "0_", DONE), ("jp_0.1_0.2_", DONE), ("jf_" + ZEROS + "0_", NOTHING),
    *((f"jp{suffix}_{ZEROS}0_", SEVEN) for suffix in ("JP", "ExT", "MT")),
    ("jpEEfP_" + ZEROS + "0_", SIX), ("jpEEfFrelEEF_" + ZEROS + "0_", THREE),
    ("blueOn", DONE), ("blueOff", DONE),
    *((f"pin{n}{state}", DONE) for n in (1, 2, 11, 12) for state in ("on", "off")),
    ("jRelVel_0_", DONE), ("doPTPinJS", DONE + NAK), ("doPTP!inJS_0_-10_", NAK), ("doPTP!inJS_7_-10_10_", DONE + NAK),
    ("doPTP!inJS", DONE + DONE), ("startDirectServoJoints", DONE), ("Torques_ext_J", NOTHING),
    ("stopDirectServoJoints", DONE),
]  # fmt: skip
"""The same, of words that set goals or outputs, which a real robot is not asked."""
SIMULATED = "import sys; from rig_simulation.devices.sunrise.program import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture(params=["simulated", "application", "address"])
def robot(request, processes, wait_until):
    """The address of a server, and whether it may be moved."""
    if request.param == "address":
        if "LEAP_RIG_ROBOT" not in os.environ:
            pytest.skip("LEAP_RIG_ROBOT=HOST:PORT names no robot")
        host, port = os.environ["LEAP_RIG_ROBOT"].rsplit(":", 1)
        return (host, int(port)), False
    if request.param == "application":
        return ("127.0.0.1", request.getfixturevalue("serve")().port), True
    process = processes.start(sys.executable, "-c", SIMULATED, "--port", "0", "--control-port", "0")
    found = wait_until(lambda: re.search(r"listening on \S+:(\d+),", process.log_path.read_text()), 30.0, "the port")
    return ("127.0.0.1", int(found[1])), True


def test_words_are_answered_alike(robot, line_to):
    """What was not answered is not: the next answer is that of a word that always is."""
    address, may_move = robot
    client = line_to(*address)
    wrong = []
    for word, expected in STILL + GOALS * may_move:
        client.send(word)
        came = "".join(client.hear() for _ in range(expected.count("\n")))
        client.send("getPin3")
        rest = client.hear() + client.hear()
        if not re.fullmatch(expected, came) or rest not in ("1\n\n", "0\n\n"):
            wrong.append((word, came, rest))
    client.send("end")
    assert not wrong and client.hear() == ""
