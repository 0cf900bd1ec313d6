"""The words that the simulated robot application has beside the toolbox's: without sockets, then on wires in virtual
time."""

from __future__ import annotations

import argparse

import numpy as np
import pytest
from test_sunrise_application import HOME_LINE, ROBOT, Wire
from toolbox_client import ToolboxClient

from common import clock
from rig_simulation.control_port import ControlClient
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.leap_rig_server import LeapRigServer
from rig_simulation.devices.sunrise.program import add_options, main, make_server
from rig_simulation.devices.sunrise.server import ServerSettings

FAR = np.array([0.9, -0.5, 0.0, -1.4, 0.0, 0.9, 0.0])
FAR_LINE = f"jp_{'_'.join(map(str, FAR))}_"
HAND = "lrTool_1.3_0_0_60_0_0_200_0_0_0_"


class Client(Wire):
    """A client that said hello, in the cycles of the arm; its second connection is that of the same session."""

    def __init__(self, **settings):
        super().__init__(leap_rig=True, **settings)
        assert self.ask("lrHello_1_")[0].startswith("ok_lrHello_leapRig_1_0_watchdog_stop_")

    def live(self, seconds):
        """Waits while it says that it lives."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            assert self.application.receive("lrBeat_", self.now).endswith("ok_lrBeat_\n")
            self.wait(min(0.05, end - self.now))

    def until(self, over, longest=2.0):
        """Waits in cycles until it is over, its client silent."""
        end = self.now + longest
        while not over():
            assert self.now < end, f"not over in {longest} s"
            self.wait(0.001)

    def one(self, line):
        """Returns the only answer."""
        (answer,) = self.ask(line)
        return answer

    def second(self, line):
        return self.application.second(line, self.now)

    def events(self):
        """Returns what the second connection heard since the last call."""
        heard, self.application.events = self.application.events, []
        return heard

    def move(self, start, seconds):
        """Starts what moves and lets it run; returns nothing but its first word."""
        if start == "startDirectServoJoints":
            assert self.one(start) == "done\n"
            self.live(0.2)
            self.follow(seconds)
        else:
            assert self.one("jRelVel_0.5_") == self.one(FAR_LINE) == self.one(start) == "done\n"
            self.live(seconds)

    def follow(self, seconds, speed=0.8):
        """Turns the first joint by servo goals."""
        for _ in range(round(seconds / 0.01)):
            goal = self.arm.goal.copy()
            goal[0] += speed * 0.01
            answer = self.one(f"jp_{'_'.join(map(str, goal))}_")
            assert answer == "done\n", answer


def test_without_hello_its_words_are_none():
    wire = Wire(leap_rig=True)
    for line in ("lrBeat_", "lrState_", HAND, "lrHello_", "lrHello_x_", "lrHelloo_1_"):
        assert wire.ask(line) == [], line
    assert (wire.ask("jp_x_"), wire.ask("TFtrans_1_")) == ([], ["nak\n"])
    assert wire.ask("jRelVel_0.2_") == ["done\n"], "nobody is silenced by a malformed line"


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("jp_0_0_0_0_0_0_nan_", "no_jp_field 7 is not a number_"),
        ("jp_0_0_0_0_0_0_NaN_", "no_jp_a number is not finite_"),
        ("jp_0_0_", "no_jp_2 numbers came, 7 are needed_"),
        ("jp_3_0_0_0_0_0_0_", "no_jp_joint 1 is 3.0 rad, beyond its range_"),
        ("doPTP!inJS" + "_1" * 22, "no_doPTP!inJS_22 numbers came, 0 to 21 are needed_"),
        ("jf_" + "1_" * 33, "no_jf_more than 32 numbers_"),
        ("noSuchCommand", "no_word_unknown_"),
        ("lrChannel_1_", "no_lrChannel_not on this connection_"),
        ("lrWatchdog_9_20_", "no_lrWatchdog_the first time is 9.0 s, but must be 0.05 to 2.0_"),
        ("lrWatchdog_1_1_", "no_lrWatchdog_the second time is 1.0 s, but must be above the first and at most 60.0_"),
        ("lrContact_-1_0_0_0_0_0_0_0_", "no_lrContact_a torque is -1.0, but must be 0.0 to 320.0_"),
        ("lrTool_15_0_0_0_0_0_0_0_0_0_", "no_lrTool_the mass is 15.0, but must be 0.0 to 14.0_"),
        ("lrLoad_14_0_0_0_", "no_lrLoad_tool and load weigh 15.3 kg, more than 14.0_"),
        ("lrResume_", "no_lrResume_the mode is IDLE_"),
    ],
)
def test_what_is_refused_is_not_done(line, reason):
    client = Client()
    client.one(HAND)
    assert client.one(line) == f"{reason}\n"
    assert not client.application.busy and not client.application._goals.joints.any()


def test_the_state_is_one_answer():
    client = Client()
    client.arm.set_tool_force(np.array([1.0, 2.0, 3.0]))
    fields = client.one("lrState_").split("_")
    assert fields[:2] == ["state", "IDLE"] and fields[-5:] == ["1.0", "AUT", "NONE", "NOSTOP", "\n"]
    assert [float(x) for x in fields[23:26]] == [1.0, 2.0, 3.0] and len(fields) == 34
    client.move("startDirectServoJoints", 0.0)
    assert client.one("jpState_0.1_0_0_0_0_0_0_").startswith("state_SERVO_")
    client.live(1.0)
    assert client.arm.q[0] == pytest.approx(0.1, abs=5e-3)


def rest_after(client, limit_s=1.0):
    """Waits until the arm rests; returns after what time and how far the tool went [s], [m]."""
    begin, at = client.now, client.arm.tool[:3, 3]
    client.live(0.001)
    while not client.arm.resting and client.now < begin + limit_s:
        client.wait(0.001)
    return client.now - begin, float(np.linalg.norm(client.arm.tool[:3, 3] - at))


@pytest.mark.parametrize("start", ["doPTPinJS", "doPTP!inJS_0_-100_100_", "startDirectServoJoints"])
def test_a_stop_brings_whatever_moves_to_rest(start):
    client = Client()
    client.arm.q = np.array([0.0, 1.2, 0.0, -0.4, 0.0, 0.0, 0.0])
    client.move(start, 0.6)
    assert client.arm.tool_speed > 0.3
    assert client.second("lrStop_") == "ok_lrStop_\n"
    seconds, metres = rest_after(client)
    assert seconds < 0.15 and metres < 0.06
    client.live(0.1)
    why = "servo mode ends: the client" if start.startswith("start") else "the motion was stopped by the client"
    assert client.events()[-1] == why
    assert [word for word in client.take() if not word.startswith("ok_lrBeat")] == (
        [] if start.startswith("start") else ["stopped_the client_\n"]
    )


def test_a_lost_client_ends_a_servo_mode_that_moves():
    client = Client()
    client.move("startDirectServoJoints", 0.6)
    client.events()
    client.application.abandon()
    client.until(lambda: client.arm.resting, 0.15)
    assert client.events() == ["servo mode ends: the client is gone"]


@pytest.mark.parametrize("seconds", [0.15, 0.3, 0.8])
def test_a_motion_stops_from_its_present_speed_within_the_arms_limits(seconds):
    client = Client(speed_limit=10.0)
    client.arm.q = np.array([0.0, 1.2, 0.0, -0.4, 0.0, 0.0, 0.0])
    assert client.one("jRelVel_1_") == client.one(FAR_LINE) == client.one("doPTPinJS") == "done\n"
    client.live(seconds)
    client.application.stop()
    longest = 1.5 * np.max(np.abs(client.arm.v) / client.arm.motion_acceleration)
    begin = client.now
    while client.arm.v.any() and client.now < begin + 1.0:
        before = client.arm.v
        client.wait(0.001)
        if client.arm.v.any():
            assert np.all(np.abs(client.arm.v - before) <= 1.01e-3 * client.arm.acceleration)
    assert client.now - begin <= longest + 0.003


def test_a_stop_before_the_start_wins_and_an_old_client_hears_nak():
    client = Client()
    client.one(FAR_LINE)
    client.now += 0.01
    assert client.application.receive("doPTPinJS", client.now) == "done\n"
    client.application.stop()
    client.live(0.2)
    assert client.take()[-1] == "stopped_the client_\n" and not client.arm.q.any()
    old = Wire(leap_rig=True)
    assert old.ask(FAR_LINE) == old.ask("doPTPinJS") == ["done\n"]
    old.wait(0.5)
    old.application.stop()
    assert old.wait_for_reply() == "nak\n"


def test_silence_brakes_holds_and_ends_the_servo_mode():
    client = Client()
    assert client.one("lrWatchdog_0.1_0.5_") == "ok_lrWatchdog_0.1_0.5_\n"
    client.move("startDirectServoJoints", 0.6)
    client.events()
    silent_since = client.now
    client.until(lambda: client.application.phase == "HELD")
    assert 0.1 - 1e-9 <= client.now - silent_since <= 0.12
    speed = client.arm.v[0]
    client.wait(0.005)
    assert client.arm.v[0] < 0.95 * speed
    assert client.events() == ["the arm brakes and holds: the client was silent"]
    before = client.arm.v
    while client.arm.v.any() and client.now - silent_since < 0.45:
        client.wait(0.001)
        assert np.all(np.abs(client.arm.v - before) <= 1e-3 * client.arm.acceleration + 1e-9), "within the arm's limits"
        before = client.arm.v
    held = client.arm.q
    assert client.one("jp_0_0_0_0_0_0_0_") == "no_jp_held: the client was silent_\n"
    client.live(0.3)
    assert client.arm.q == pytest.approx(held, abs=2e-3), "nothing moves until it is asked"
    assert client.one("lrResume_") == "ok_lrResume_\n"
    client.live(0.1)
    assert client.application.phase == "SERVO" and client.arm.q == pytest.approx(held, abs=3e-3)
    client.wait(0.6)
    assert client.events()[-1] == "servo mode ends: the watchdog" and not client.arm.in_servo


def test_silence_stops_a_motion():
    client = Client()
    client.move("doPTPinJS", 0.5)
    client.take()
    begin = client.now
    client.until(lambda: not client.arm.in_motion)
    assert 0.15 < client.now - begin < 0.4
    assert client.wait_for_reply() == "stopped_the watchdog_\n"


def test_motions_pause_resume_and_are_cancelled():
    client = Client()
    client.move("doPTPinJS", 0.5)
    assert client.second("lrPause_") == "ok_lrPause_\n"
    client.live(0.5)
    assert client.application.phase == "PAUSED" and client.arm.resting
    client.one("jp_0_0_0_0_0_0_0_")
    assert client.second("lrResume_") == "ok_lrResume_\n"
    client.live(5.0)
    assert "done\n" in client.take() and client.arm.q == pytest.approx(FAR), "it goes where it was to go"
    client.one(HOME_LINE)
    client.one("doPTPinJS")
    client.live(0.3)
    client.second("lrPause_")
    client.live(0.5)
    client.take()
    assert client.second("lrCancel_") == "ok_lrCancel_\n"
    client.wait(0.01)
    assert client.take() == ["stopped_a cancel_\n"]
    assert client.second("lrCancel_") == "no_lrCancel_the mode is IDLE_\n"
    assert client.second("getPin3") == "no_getPin3_not on this connection_\n"


def test_a_paused_servo_mode_goes_on_where_it_stands():
    client = Client()
    client.move("startDirectServoJoints", 0.4)
    client.one("lrPause_")
    client.live(0.5)
    held = client.arm.q
    assert client.application.phase == "HELD"
    client.one("lrResume_")
    client.live(0.2)
    assert client.application.phase == "SERVO" and client.arm.q == pytest.approx(held, abs=2e-3)


@pytest.mark.parametrize(
    ("push", "word"),
    [
        (lambda arm: arm.set_external_torque(np.array([0, 0, 0, 0, 0, -6.0, 0])), "stopped_contact, joint 6_\n"),
        (lambda arm: arm.set_tool_force(np.array([0, 12.0, 0])), "stopped_contact, force_\n"),
    ],
)
def test_contact_breaks_a_motion_and_is_named(push, word):
    client = Client()
    assert client.one("lrContact_20_20_20_20_20_5_20_10_") == "ok_lrContact_20.0_20.0_20.0_20.0_20.0_5.0_20.0_10.0_\n"
    client.move("doPTPinJS", 0.5)
    client.take()
    push(client.arm)
    client.live(0.3)
    assert [text for text in client.take() if not text.startswith("ok_lrBeat")] == [word]
    assert client.events() == ["contact: " + word[len("stopped_contact, ") : -2]]
    assert client.arm.resting


def test_tool_and_load_are_one_mass_and_the_arm_knows_it():
    client = Client(tool_weight=True)
    client.arm.q = FAR
    body = client.arm.hand
    unknown = np.max(np.abs(client.arm.external_torques))
    centre = "_".join(str(1000.0 * x) for x in body.com)
    answer = client.one(f"lrTool_{body.mass}_{centre}_0_0_200_0_0_0_")
    assert answer.startswith(f"ok_lrTool_{body.mass}_")
    assert np.max(np.abs(client.arm.external_torques)) < 1e-9 < 2.0 < unknown
    assert client.arm.T_flange_tool[2, 3] == 0.2
    assert client.one("doPTP!inJS_0_-10_") == "nak\n" and client.arm.T_flange_tool[2, 3] == 0.2
    client.one("TFtrans_0_0_90_0_0_0_")
    assert np.max(np.abs(client.arm.external_torques)) < 1e-9, "the toolbox's word moves the tool point alone"
    assert client.one("lrTool_1_0_0_60_0_0_106_0_0_0_") == "ok_lrTool_1.0_0.0_0.0_60.0_\n"
    assert client.one("lrLoad_0.5_0_0_180_") == "ok_lrLoad_1.5_0.0_0.0_100.0_\n"
    client.move("startDirectServoJoints", 0.0)
    assert client.ask(HAND)[-1] == "no_lrTool_the arm is not at rest_\n"


def test_a_safety_stop_ends_what_moves():
    for start in ("doPTPinJS", "startDirectServoJoints"):
        client = Client()
        client.move(start, 0.4)
        client.take()
        client.arm.press_emergency_stop(True)
        assert client.one("lrState_").endswith("_STOP1_\n")
        client.live(0.5)
        ended = ["stopped_a safety stop, STOP1_\n"] if start == "doPTPinJS" else []
        assert [text for text in client.take() if not text.startswith("ok_lrBeat")] == ended
        assert not client.application.busy


# On wires


@pytest.fixture
def server(wires):
    with wires.scheduler.in_group("robot"):
        server = LeapRigServer(SimulatedArm(ROBOT, ArmSettings()), ServerSettings(), "127.0.0.1", 0, 0)
        server.thread = clock.Thread(target=server.run, name="robot", daemon=True)
        server.thread.start()
    server.control = ControlClient("127.0.0.1", server.control_port)
    return server


@pytest.fixture
def connect(wires, server):
    return lambda: ToolboxClient(wires, server)


def hello(client):
    """Returns the session's number."""
    return client.ask("lrHello_1_").split("_")[4]


def start(client):
    """Begins a motion of some seconds."""
    for line in ("jRelVel_0.25_", HOME_LINE, "doPTPinJS"):
        assert client.ask(line) == "done\n"


def height(server):
    """Returns the flange's [mm]."""
    return 1000.0 * server.control.ask("state")["flange"][2][3]


def test_a_second_connection_stops_and_hears(server, connect):
    client, second = connect(), connect()
    number = hello(client)
    assert second.ask("lrChannel_1_") == "no_lrChannel_no such session_\n"
    assert second.ask(f"lrChannel_{number}_") == f"ok_lrChannel_{number}.0_\n"
    client.ask("lrWatchdog_2_60_")
    start(client)
    clock.sleep(0.5)
    assert second.ask("lrState_").startswith("state_MOTION_")
    assert second.ask("lrStop_") == "ok_lrStop_\n"
    assert client.hear() == "stopped_the client_\n"
    assert second.hear() == "event_the motion was stopped by the client_\n"
    client.send("end\n")
    assert client.at_end() and second.at_end()


def test_anybody_may_stop_and_only_the_holder_may_move(server, connect):
    client, stranger = connect(), connect()
    start(client)
    assert stranger.ask("lrStop_") == "ok_lrStop_\n"
    assert client.hear() == "nak\n"
    assert stranger.ask(HOME_LINE) == "busy_{}:{}_\n".format(*client.socket.getsockname())
    assert stranger.at_end()
    assert client.ask("getPin3") == "1\n"


def test_a_dead_client_leaves_a_server_that_takes_the_next(server, connect):
    client = connect()
    hello(client)
    client.ask("lrWatchdog_2_60_")
    client.ask(HAND)
    for line in ("jRelVel_0.15_", HOME_LINE, "doPTPinJS"):
        assert client.ask(line) == "done\n"
    clock.sleep(1.0)
    assert server.control.ask("state")["velocities"][0] < -0.05
    client.close()
    clock.sleep(0.01)
    other = connect()
    assert other.ask("getPin3") == "1\n" and other.hear() == "\n", "it waits until the arm rests"
    state = server.control.ask("state")
    assert not any(state["velocities"]) and state["mode"] == "idle" and state["joints"][0] != pytest.approx(-0.7854)
    assert other.ask("Eef_pos").split("_")[2] == str(height(server)), "and the tool of the one before has gone"
    other.send("lrBeat_\n")
    assert other.silent(1.0), "who has not said hello has no further words"


def test_who_is_silent_for_too_long_gives_way(server, connect):
    client = connect()
    hello(client)
    other = connect()
    assert other.ask("getPin3").startswith("busy_")
    clock.sleep(10.1)
    last = connect()
    assert last.ask("getPin3") == "1\n"
    assert client.at_end()


def test_overlong_and_strange_lines_lose_nobody(server, connect):
    client = connect()
    client.send("x" * 2000 + "\n\x85\u00e9\n" + "y" * 5000 + "\ngetPin3\n")
    assert client.hear() == "1\n"


def test_a_cut_or_closed_port_serves_again(server, connect):
    for fault in ("cut", "restarted"):
        client = connect()
        hello(client)
        server.control.ask("fault", name=fault, on=True)
        clock.sleep(0.1)
        with pytest.raises(ConnectionError):
            client.ask()
            connect().ask()
        server.control.ask("fault", name=fault, on=False)
        clock.sleep(0.1)
        other = connect()
        assert other.ask("getPin3") == "1\n"
        other.close()
        clock.sleep(0.1)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--robot-server", "leaprig"], "choose from 'toolbox', 'leap_rig'"),
        (
            ["--robot-server", "leap_rig", "--deaf-after-lost-client"],
            "are sides of the toolbox's server",
        ),
    ],
)
def test_a_bad_choice_of_the_server_is_one_sentence(wires, capsys, arguments, sentence):
    with pytest.raises(SystemExit) as end:
        raise SystemExit(main(["--port", "0", "--control-port", "0", *arguments]))
    out, err = capsys.readouterr()
    assert (end.value.code, out, err.count("\n")) == (1, "", 1) and sentence in err, err


def test_the_program_serves_by_the_chosen_application(wires):
    server = make_server(options("--robot-server", "leap_rig"))
    assert isinstance(server, LeapRigServer)
    server.close()
    other = make_server(options())
    assert not isinstance(other, LeapRigServer)
    other.close()


def options(*arguments):
    parser = argparse.ArgumentParser()
    add_options(parser)
    return parser.parse_args(["--port", "0", "--control-port", "0", *arguments])
