"""Each word of the wire, the toolbox's and the extension's, answered by the simulated controller, by the robot
application, and by the server at LEAP_RIG_ROBOT=HOST:PORT, where only the words are tried that move nothing."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import pytest

from common import clock
from rig_simulation.control_port import ControlClient
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.leap_rig_server import LeapRigServer
from rig_simulation.devices.sunrise.leap_rig_words import WORDS, read
from rig_simulation.devices.sunrise.robot import Robot
from rig_simulation.devices.sunrise.server import ServerSettings
from rig_simulation.files import read_urdf

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
OLD = [
    *(f"DcSeCar{suffix}_" for suffix in ("ExT", "MT", "JP", "EEfP", "EEfFrelEEF", "")),
    *(f"velJDC{suffix}_" for suffix in ("ExT", "MT", "JP", "EEfP", "")),
    *(f"cArtixanPosition{suffix}_" for suffix in ("Circ1", "Circ2", "")),
    *(f"doPTPinCS{suffix}" for suffix in ("RelBase", "RelEEF", "Circle1", "")), "doPTP!inCS", "doPTP!CSCircle1",
    "stDcEEf_", "stVelDcJoint_", "startSmartImpedneceJoints", "handGuiding", "preciseHandGuiding1",
    "preciseHandGuiding2",
]  # fmt: skip
"""Words of the toolbox that our client does not use: a client that says hello has none of them."""
STATE = rf"state_IDLE_({NUMBER}){{28}}[A-Z0-9]+_[A-Z]+_[A-Z0-9]+_" "\n"
TOOL, HOME = "lrTool_1_0_0_60_0_0_106_0_0_0_", "jp_-0.78540_0.52360_0.00000_-1.39626_0.00000_1.22173_0.00000_"
ABILITIES = "watchdog_stop_contact_tool_soft_float_guide_state"
OURS_STILL = [
    ("lrHello_1_", rf"ok_lrHello_leapRig_1_\d+_{ABILITIES}_" "\n"), ("lrHello_x_", NOTHING),
    ("lrBeat_", "ok_lrBeat_\n"), ("lrBeatx", "no_word_unknown_\n"), ("noSuchCommand", "no_word_unknown_\n"),
    ("lrState_", STATE), ("lrStop_", "ok_lrStop_\n"), ("lrChannel_1_", "no_lrChannel_not on this connection_\n"),
    *((f"lr{word}_", f"no_lr{word}_the mode is IDLE_\n") for word in ("Pause", "Resume", "Cancel")),
    ("jpState_0_0_", "no_jpState_2 numbers came, 7 are needed_\n"),
    ("jp_" + ZEROS + "NaN_", "no_jp_a number is not finite_\n"),
    ("jf_" + ZEROS + "1e400_", "no_jf_a number is not finite_\n"),
    ("jpJP_" + ZEROS + "nan_", "no_jpJP_field 7 is not a number_\n"),
    ("jp_" + "1_" * 33, "no_jp_more than 32 numbers_\n"),
    ("jp_" + "1" * 65 + "_", "no_jp_field 1 is not a number_\n"),
    ("jpState_" + ZEROS + "3.1_", "no_jpState_joint 7 is 3.1 rad, beyond its range_\n"),
    ("TFtrans_0_0_x_", "no_TFtrans_field 3 is not a number_\n"),
    ("jRelVel_", "no_jRelVel_0 numbers came, 1 are needed_\n"),
    ("doPTP!inJS" + "_1" * 22, "no_doPTP!inJS_22 numbers came, 0 to 21 are needed_\n"),
    *((f"{word}_1_1_1_1_1_1_", f"no_{word.rstrip('_')}_not offered to a client that says hello_\n") for word in OLD),
    ("x" * 1025, NOTHING), ("lrWatchdog_2_60_", "ok_lrWatchdog_2.0_60.0_\n"),
    ("lrWatchdog_0.01_1_", "no_lrWatchdog_the first time is 0.01 s, but must be 0.05 to 2.0_\n"),
    ("lrWatchdog_1_61_", "no_lrWatchdog_the second time is 61.0 s, but must be above the first and at most 60.0_\n"),
    ("lrContact_10_10_10_10_10_5_5_30_", "ok_lrContact_10.0_10.0_10.0_10.0_10.0_5.0_5.0_30.0_\n"),
    ("lrContact_321_0_0_0_0_0_0_0_", "no_lrContact_a torque is 321.0, but must be 0.0 to 320.0_\n"),
    ("lrContact_0_0_0_0_0_0_0_-1_", "no_lrContact_the force is -1.0, but must be 0.0 to 500.0_\n"),
    ("lrTool_15_0_0_0_0_0_0_0_0_0_", "no_lrTool_the mass is 15.0, but must be 0.0 to 14.0_\n"),
    ("lrTool_1_600_0_0_0_0_0_0_0_0_", "no_lrTool_the centre of mass in mm is 600.0, but must be -500.0 to 500.0_\n"),
    ("lrTool_1_0_0_0_0_0_1e4_0_0_0_", "no_lrTool_the tool point in mm is 10000.0, but must be -1000.0 to 1000.0_\n"),
    ("lrTool_1_0_0_0_0_0_0_7_0_0_", r"no_lrTool_an angle is 7.0, but must be -6.28\d+ to 6.28\d+_" "\n"),
    ("lrSoftJoints_1_1_1_1_1_1_1_0.7_", "no_lrSoftJoints_the tool's mass is not known: say lrTool first_\n"),
    ("lrSoftJoints_1_1_1_1_1_1_1_0_", "no_lrSoftJoints_the damping is 0.0, but must be 0.1 to 1.0_\n"),
    ("lrSoftTool_1_1_1_1_1_1_0.7_1_300_1_1_1_", "no_lrSoftTool_the force is 300.0, but must be 1.0 to 200.0_\n"),
    ("lrFloat_", "no_lrFloat_the tool's mass is not known: say lrTool first_\n"), ("lrStiff_", "ok_lrStiff_\n"),
]  # fmt: skip
"""Words of a client that says hello first."""
OURS_GOALS = [
    (f"jpState_{ZEROS}0_", STATE), (TOOL, "ok_lrTool_1.0_0.0_0.0_60.0_\n"),
    ("lrLoad_13.5_0_0_0_", "no_lrLoad_tool and load weigh 14.5 kg, more than 14.0_\n"),
    ("lrLoad_0.5_0_0_180_", "ok_lrLoad_1.5_0.0_0.0_100.0_\n"),
    ("lrSoftJoints_300_300_300_300_200_100_50_0.7_", "ok_lrSoftJoints_300.0_300.0_300.0_300.0_200.0_100.0_50.0_0.7_\n"),
    ("lrSoftTool_9_9_9_9_9_9_0.7_1_9_9_9_1_", "ok_lrSoftTool_9.0_9.0_9.0_9.0_9.0_9.0_0.7_1.0_9.0_9.0_9.0_1.0_\n"),
    ("doPTP!inJS_0_-10_", NAK), ("startDirectServoJoints", DONE), ("lrStiff_", "no_lrStiff_the arm is not at rest_\n"),
]  # fmt: skip
SOFT_JOINTS = "lrSoftJoints_300_300_300_300_200_100_50_0.7_"
SOFT_TOOL = "lrSoftTool_2000_2000_2000_200_200_200_0.7_50_200_50_500_2_"
SIMULATED = "import sys; from rig_simulation.devices.sunrise.program import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture(params=["toolbox", "leap_rig", "application", "address"])
def robot(request, processes, wait_until):
    """The address of a server, and whether it may be moved."""
    if request.param == "address":
        if "LEAP_RIG_ROBOT" not in os.environ:
            pytest.skip("LEAP_RIG_ROBOT=HOST:PORT names no robot")
        host, port = os.environ["LEAP_RIG_ROBOT"].rsplit(":", 1)
        return (host, int(port)), False
    if request.param == "application":
        return ("127.0.0.1", request.getfixturevalue("serve")().port), True
    ports = ("--port", "0", "--control-port", "0", "--robot-server", request.param)
    process = processes.start(sys.executable, "-c", SIMULATED, *ports)
    found = wait_until(lambda: re.search(r"listening on \S+:(\d+),", process.log_path.read_text()), 30.0, "the port")
    return ("127.0.0.1", int(found[1])), True


def test_both_know_the_same_words_and_each_has_a_case():
    java = (Path(__file__).parents[1] / "java" / "leaprig" / "Word.java").read_text()
    assert sorted(re.findall(r'^    [A-Z_0-9]+\("([^"]+)", Kind', java, re.M)) == sorted(w.text for w in WORDS)
    cases = [line for line, _ in STILL + GOALS + OURS_STILL + OURS_GOALS] + ["end", "lrGuide_"]
    found = {read(line).word for line in cases}
    assert [word.text for word in WORDS if word not in found] == []


def test_words_are_answered_alike(robot, line_to):
    address, may_move = robot
    client = line_to(*address)
    assert not answered_otherwise(client, STILL + GOALS * may_move)
    client.send("end")
    assert client.hear() == ""


def answered_otherwise(client, words):
    """Returns the words that are not answered as expected. What was not answered is not: the next answer is that of a
    word that always is."""
    wrong = []
    for word, expected in words:
        client.send(word)
        came = "".join(client.hear() for _ in range(expected.count("\n")))
        client.send("getPin3")
        rest = client.hear() + client.hear()
        print(f"{word[:40]:40} | {came[:60]!r}")  # the table of words and answers, with pytest -s
        if not re.fullmatch(expected, came) or rest not in ("1\n\n", "0\n\n"):
            wrong.append((word, came, rest))
    return wrong


class Parrot:
    """Answers every word alike, but for the pin."""

    def __init__(self, answer):
        self._answer, self._lines = answer, []

    def send(self, line):
        self._lines += ("1\n\n" if line == "getPin3" else self._answer).splitlines(keepends=True)

    def hear(self):
        return self._lines.pop(0) if self._lines else ""


SERVING = f"state_SERVO_{'0.0_' * 28}T1_NONE_NOSTOP_\n"


@pytest.mark.parametrize("answer", ["", "wrong\n", "done\ndone\n", "nak\n", SERVING])
def test_no_case_passes_whatever_is_answered(answer):
    cases = [case for case in STILL + GOALS + OURS_STILL + OURS_GOALS if case[0] != "getPin3"]
    passes = [case for case in cases if case[1] == answer]
    assert [case[0] for case in cases if not answered_otherwise(Parrot(answer), [case])] == [case[0] for case in passes]


class VirtualLine:
    """A plain client in virtual time."""

    def __init__(self, wires, server):
        self.socket = wires.connect((server.host, server.port))
        self.socket.settimeout(600.0)
        self.replies = self.socket.makefile("rb")

    def send(self, line):
        self.socket.sendall(f"{line}\n".encode())

    def hear(self):
        return self.replies.readline().decode("ascii")

    def ask(self, line):
        self.send(line)
        return self.hear()

    def close(self):
        self.replies.close()
        self.socket.close()


class Simulated:
    """The simulated one, in virtual time."""

    def __init__(self, wires):
        with wires.scheduler.in_group("robot"):
            arm = SimulatedArm(Robot(read_urdf("LBR7R800", "MF_elektrisch")), ArmSettings())
            self.server = LeapRigServer(arm, ServerSettings(), "127.0.0.1", 0, 0)
            clock.Thread(target=self.server.run, name="robot", daemon=True).start()
        self.wires, self.control = wires, ControlClient("127.0.0.1", self.server.control_port)

    def connect(self):
        return VirtualLine(self.wires, self.server)

    def push(self, newton):
        self.control.ask("set_tcp_force", value=[0, newton, 0])

    def press(self, pressed):
        self.control.ask("set_enabling", value=pressed)

    def weigh_otherwise(self):
        """What is on the flange weighs 1.1 kg anyway."""


class OnStubs:
    """The robot application, in time that is slow; its motions last until they are stopped."""

    def __init__(self, serve):
        self.server = serve(leaprig__pace=0.1)
        self.server.say(speed=1e-6)
        self.connect = self.server.connect

    def push(self, newton):
        self.server.say(force=f"0,{newton},0")

    def press(self, pressed):
        self.server.say(enabling="HANDGUIDING" if pressed else "NONE")

    def weigh_otherwise(self):
        self.server.say(load="false")


@pytest.fixture(params=["simulated", pytest.param("application", marks=pytest.mark.long)])
def ours(request):
    """A server of the extension that may be moved, and to which it may be anything that happens."""
    of = request.getfixturevalue
    return OnStubs(of("serve")) if request.param == "application" else Simulated(of("wires"))


@pytest.mark.parametrize("where", ["simulated", "application", "address"])
def test_words_of_the_extension_are_answered_alike(request, where, line_to):
    of = request.getfixturevalue
    if where == "address":
        if "LEAP_RIG_ROBOT" not in os.environ:
            pytest.skip("LEAP_RIG_ROBOT=HOST:PORT names no robot")
        host, port = os.environ["LEAP_RIG_ROBOT"].rsplit(":", 1)
        client = line_to(host, int(port))
        client.send("lrHello_1_\ngetPin3")
        if not client.hear().startswith("ok_lrHello"):
            pytest.skip("the server at that address has no extension")
        client.hear(), client.hear()
    else:
        client = (OnStubs(of("serve")) if where == "application" else Simulated(of("wires"))).connect()
    assert not answered_otherwise(client, OURS_STILL + OURS_GOALS * (where != "address"))
    client.send("end")
    assert client.hear() == ""


def joined(ours, watchdog):
    """Returns a client that said hello, and its second connection."""
    client, second = ours.connect(), ours.connect()
    number = client.ask("lrHello_1_").split("_")[4]
    assert second.ask(f"lrChannel_{number}_") == f"ok_lrChannel_{number}.0_\n"
    assert client.ask(f"lrWatchdog_{watchdog}_").startswith("ok_")
    return client, second


def begin(client, start):
    """Starts what takes long."""
    assert client.ask("jRelVel_0.05_") == client.ask(HOME) == "done\n"
    assert client.ask(start) in ("done\n", f"ok_{start}\n"), start


def until(second, mode):
    """Waits for the mode that the second connection hears."""
    while not second.ask("lrState_").startswith(f"state_{mode}_"):
        clock.sleep(0.01)


def test_a_stop_is_answered_alike(ours):
    client, second = joined(ours, "2_60")
    assert client.ask(TOOL).startswith("ok_")
    for start in ("doPTPinJS", "doPTP!inJS_0_-100_100_", "lrGuide_"):
        begin(client, start)
        until(second, "MOTION")
        assert second.ask("lrStop_") == "ok_lrStop_\n"
        assert client.hear() == "stopped_the client_\n"
        assert second.hear() == "event_the motion was stopped by the client_\n"
    for start, kind in (("startDirectServoJoints", ""), ("lrFloat_", ", FLOAT")):
        begin(client, start)
        assert second.hear() == f"event_servo mode begins{kind}_\n"
        assert second.ask("lrStop_") == "ok_lrStop_\n"
        assert second.hear() == "event_servo mode ends: the client_\n"
        until(second, "IDLE")


def test_a_pause_is_answered_alike(ours):
    client, second = joined(ours, "2_60")
    begin(client, "doPTPinJS")
    until(second, "MOTION")
    for end in ("lrResume_", "lrCancel_"):
        assert second.ask("lrPause_") == "ok_lrPause_\n"
        assert second.hear() == "event_the motion is paused_\n"
        assert second.ask("lrPause_") == "no_lrPause_the mode is PAUSED_\n"
        assert second.ask(end) == f"ok_{end}\n"
        if end == "lrResume_":
            assert second.hear() == "event_the motion is resumed_\n"
            until(second, "MOTION")
    assert client.hear() == "stopped_a cancel_\n"
    assert second.hear() == "event_the motion was stopped by a cancel_\n"


def test_silence_is_answered_alike(ours):
    client, second = joined(ours, "0.05_60")
    begin(client, "doPTPinJS")
    assert client.hear() == "stopped_the watchdog_\n"
    assert second.hear() == "event_the motion was stopped by the watchdog_\n"
    begin(client, "startDirectServoJoints")
    said = [second.hear() for _ in range(2)]
    assert said == ["event_servo mode begins_\n", "event_the arm brakes and holds: the client was silent_\n"]
    assert client.ask(HOME) == "no_jp_held: the client was silent_\n"
    assert client.ask("lrResume_") == "ok_lrResume_\n"
    assert second.hear() == "event_servo mode continues_\n"


def test_contact_is_answered_alike(ours):
    client, second = joined(ours, "2_60")
    assert client.ask("lrContact_0_0_0_0_0_0_0_10_").startswith("ok_")
    begin(client, "doPTPinJS")
    until(second, "MOTION")
    ours.push(12.0)
    assert client.hear() == "stopped_contact, force_\n"
    assert second.hear() == "event_contact: force_\n"


@pytest.mark.parametrize("word", ["lrGuide_", "startDirectServoJoints"])
def test_what_is_said_during_a_guarded_motion_does_not_follow_it(ours, word):
    client, second = joined(ours, "2_60")
    assert client.ask("lrContact_0_0_0_0_0_0_0_10_").startswith("ok_")
    begin(client, "doPTP!inJS_0_-300_300_")
    until(second, "MOTION")
    client.send(word)
    assert word != "lrGuide_" or client.hear() == "no_lrGuide_the arm is not at rest_\n"
    ours.push(12.0)
    assert client.hear() == "stopped_contact, force_\n"
    assert second.hear() == "event_contact: force_\n"
    clock.sleep(0.1)
    assert second.ask("lrState_").startswith("state_IDLE_")


def test_a_second_and_the_next_client_are_answered_alike(ours):
    client, stranger = ours.connect(), ours.connect()
    begin(client, "doPTPinJS")
    assert stranger.ask("lrBeat_") == "busy_{}:{}_\n".format(*client.socket.getsockname()) and stranger.hear() == ""
    stopper = ours.connect()
    assert stopper.ask("lrStop_") == "ok_lrStop_\n" and client.hear() == "nak\n"
    begin(client, "doPTPinJS")
    client.close()
    while not stopper.ask("lrHello_1_").startswith("ok_"):
        stopper.close()
        stopper = ours.connect()
    assert stopper.ask("lrState_").startswith("state_IDLE_"), "the arm has stopped before the next one is served"


def test_a_released_switch_ends_hand_guiding_alike(ours):
    client, second = joined(ours, "2_60")
    assert client.ask(TOOL).startswith("ok_") and client.ask("lrGuide_") == "ok_lrGuide_\n"
    until(second, "MOTION")
    ours.press(True)
    until(second, "MOTION")
    clock.sleep(0.1)
    ours.press(False)
    assert client.hear() == "done\n"
    until(second, "IDLE")


@pytest.mark.parametrize("soft", [SOFT_JOINTS, SOFT_TOOL])
def test_a_client_lost_while_the_arm_is_soft_is_answered_alike(ours, soft):
    client, second = joined(ours, "2_60")
    for line in (TOOL, soft):
        assert client.ask(line).startswith("ok_"), line
    begin(client, "startDirectServoJoints")
    assert second.hear().startswith("event_servo mode begins, ")
    client.close()
    assert second.hear() == "event_servo mode ends: the client is gone_\n"
    assert second.hear() == "", "the session is over"
    other = ours.connect()
    while not other.ask("lrHello_1_").startswith("ok_"):
        other.close()
        other = ours.connect()
    assert other.ask(soft) == f"no_{soft.split('_')[0]}_the tool's mass is not known: say lrTool first_\n"


@pytest.mark.parametrize("line", [SOFT_JOINTS, SOFT_TOOL, "lrFloat_"])
def test_a_wrong_mass_is_refused_alike(ours, line):
    client = joined(ours, "2_60")[0]
    ours.weigh_otherwise()
    assert client.ask("lrTool_4_500_0_0_0_0_106_0_0_0_") == "ok_lrTool_4.0_500.0_0.0_0.0_\n"
    refusal = "the controller's load check fails: mass, centre or pose are wrong"
    assert client.ask(line) == f"no_{line.split('_')[0]}_{refusal}_\n"
