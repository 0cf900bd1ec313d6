"""The robot application: its unit tests, and the whole as a process that speaks the toolbox's words and more."""

from __future__ import annotations

import ast
import contextlib
import os
import re
import socket
import struct
import subprocess
import time

import pytest

from fuzz.mutations import edited_bytes
from kst import ApplicationSettings, Feedback, KstClient, MotionStopped, run_ptp
from kst.session import KstTiming

pytestmark = pytest.mark.real

HOME = "jp_-0.78540_0.52360_0.00000_-1.39626_0.00000_1.22173_0.00000_"
NEAR = "jp_0.02_0.02_0.02_0.02_0.02_0.02_0.02_"
TOOL = "lrTool_1_0_0_60_0_0_106_0_0_0_"
STILL, FAST = 1e-6, 50.0
"""Of the stub's motions: one that lasts as long as the test wants, and one that ends soon."""
SLOW_CLOCK = {"leaprig__pace": 0.1}
"""The server's time: at `lrWatchdog_2_60_` a client may be silent for 20 s."""
PATIENT = KstTiming(reply=60.0, servo_reply=60.0, silence=240.0)


def test_units(classes):
    done = subprocess.run(["java", "-cp", classes, "leaprig.UnitTests"], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and re.search(r"^\d\d tests, 0 failed$", done.stdout, re.M), done.stdout + done.stderr


def spoken(path):
    """The directions and texts of a recorded transcript."""
    found = re.findall(r"^ *[\d.]+ ([<>]) ('.*')$", path.read_text(), re.M)
    return [(direction, ast.literal_eval(text)) for direction, text in found]


@pytest.mark.parametrize(("name", "torques"), [("ptp", "0"), ("servo", "0.1,0.2,0.3,0.4,0.5,0.6,0.7"), ("errors", "0")])
def test_an_old_client_is_answered_as_by_the_published_server(serve, shared_data, name, torques):
    """Byte for byte, but for where the arm is while it moves. What was not answered is not: the next answer is that
    of the next line."""
    server = serve(sim__tau_ext=torques)
    client = server.connect()
    before, request, moving, servo = ">", "", False, False
    for direction, text in spoken(shared_data / "kst" / f"{name}.txt"):
        if direction == ">":
            request = text[:-1]
            moving = request.startswith("doPTP") or (moving and not request.startswith("jRelVel"))
            if request.startswith("doPTP"):
                server.say(speed=STILL)
            client.send(request)
        elif text == "EOF":
            assert client.hear() == ""
        elif not text.startswith("(nothing"):
            if before == "<":
                server.say(speed=FAST)  # the last word of a motion
            came = client.hear()
            moved = moving and before == ">" and "E-" in text
            if moved or (servo and text.count("_") in (6, 7)):
                near = 0.06 if text.count("_") == 7 else 60.0
                assert [float(x) for x in came.split("_")[:-1]] == pytest.approx(
                    [float(x) for x in text.split("_")[:-1]], abs=near
                )
            else:
                assert came == text, request
            if request.startswith("startDirect"):
                servo = True
                server.wait_for("servo mode begins")
            elif servo and request.startswith("stopDirect"):
                server.wait_for("servo mode ends")
        before = direction if direction == "<" and not text.startswith("(nothing") else ">"


def test_our_client_moves_it_and_comes_again(serve):
    server = serve()
    server.say(speed=FAST)
    for _ in range(2):
        with KstClient.connect("127.0.0.1", server.port, timing=PATIENT) as arm:
            run_ptp(arm, [0.0, 0.2, 0.0, -0.4, 0.0, 0.2, 0.0], velocity=0.5)
            q = arm.joints()
            assert q == pytest.approx([0.0, 0.2, 0.0, -0.4, 0.0, 0.2, 0.0])
            arm.start_joint_servo()
            for feedback in (Feedback.DONE, Feedback.JOINTS, Feedback.POSE, Feedback.FORCE, Feedback.EXTERNAL_TORQUES):
                q[6] += 0.001
                arm.servo(q, feedback)
            arm.stop_joint_servo()


def test_our_client_uses_its_words(serve, wait_until):
    server = serve(**SLOW_CLOCK)
    settings = ApplicationSettings(2.0, 60.0, tool_mass=1.12, tool_centre=(-0.022, 0.0, 0.0727))
    with KstClient.connect("127.0.0.1", server.port, timing=PATIENT, application=settings) as arm:
        assert "CALL attach 1.12 kg" in server.log
        arm.set_load(0.5)
        server.say(speed=STILL)
        arm.start_ptp_joints([0.0, 0.2, 0.0, -0.4, 0.0, 0.2, 0.0], 0.5)
        assert arm.state().mode == "MOTION"
        arm.pause_motion()
        wait_until(lambda: arm.state().mode == "PAUSED", 30.0, "the pause")
        arm.resume_motion()
        wait_until(lambda: arm.state().mode == "MOTION", 30.0, "the motion")
        arm.stop_motion()
        with pytest.raises(MotionStopped, match="stopped by the client"):
            while not arm.ptp_arrived():
                arm.beat()
        wait_until(lambda: "the motion was stopped by the client" in arm.events(), 30.0, "the event")
        arm.start_joint_servo()
        state = arm.servo(arm.joints(), Feedback.STATE)
        assert (state.mode, state.safety_stop) == ("SERVO", "NOSTOP")
        arm.stop_motion()
        with pytest.raises(MotionStopped, match="servo mode ends: the client"):
            while True:
                arm.servo(state.joints, Feedback.STATE)
        arm.stop_joint_servo()


@pytest.mark.parametrize("start", ["doPTPinJS", "lrGuide_"])
def test_a_second_connection_stops_what_moves(serve, start):
    server = serve(**SLOW_CLOCK, sim__q0="0,0.5,0,-1.4,0,1.2,0")
    server.say(speed=STILL)
    client, second = server.connect(), server.connect()
    number = client.hello()
    client.ask("lrWatchdog_2_60_")
    assert second.ask(f"lrChannel_{number}_").startswith("ok_lrChannel_")
    assert second.ask("lrChannel_1_").startswith("no_lrChannel")
    client.ask("jRelVel_0.5_")
    client.ask(HOME)
    assert client.ask(start) in ("done\n", "ok_lrGuide_\n")
    server.wait_for("CALL move")
    assert second.ask("lrStop_") == "ok_lrStop_\n"
    assert client.hear() == "stopped_the client_\n"
    assert second.hear() == "event_the motion was stopped by the client_\n"
    assert "CALL cancel" in server.log


def test_anybody_may_stop_and_only_the_holder_may_move(serve):
    server = serve()
    server.say(speed=STILL)
    client, stranger = server.connect(), server.connect()
    client.ask("jRelVel_0.5_")
    client.ask(HOME)
    client.ask("doPTPinJS")
    assert stranger.ask("lrStop_") == "ok_lrStop_\n"
    assert client.hear() == "nak\n"
    holder = "{}:{}".format(*client.socket.getsockname())
    assert stranger.ask(NEAR) == f"busy_{holder}_\n"
    assert stranger.hear() == ""
    assert client.ask("getPin3") == "1\n"


def test_silence_brakes_holds_and_ends(serve):
    server = serve()
    client, second = server.connect(), server.connect()
    number = client.hello()
    client.ask("lrWatchdog_0.05_0.5_")
    second.ask(f"lrChannel_{number}_")
    client.ask("startDirectServoJoints")
    heard = [second.hear() for _ in range(3)]
    assert heard == [
        "event_servo mode begins_\n",
        "event_the arm brakes and holds: the client was silent_\n",
        "event_servo mode ends: the watchdog_\n",
    ]


def test_contact_tool_and_softness_reach_the_controller(serve):
    server = serve(**SLOW_CLOCK)
    client = server.connect()
    client.hello()
    client.ask("lrWatchdog_2_60_")
    assert client.ask(TOOL) == "ok_lrTool_1.0_0.0_0.0_60.0_\n"
    assert client.ask("lrLoad_0.5_0_0_180_") == "ok_lrLoad_1.5_0.0_0.0_100.0_\n"
    assert "CALL attach 1.5 kg at [0.0, 0.0, 100.0]" in server.log
    client.ask("lrContact_10_10_10_10_10_5_5_30_")
    server.say(speed=STILL)
    client.ask("jRelVel_0.5_")
    client.ask(HOME)
    client.ask("doPTPinJS")
    server.say(force="0,31,0")
    assert client.hear() == "stopped_contact, force_\n"
    server.say(force="0,0,0")
    assert client.ask("lrSoftTool_2000_2000_500_200_200_200_0.7_50_40_10_50_0.5_").startswith("ok_")
    client.ask("startDirectServoJoints")
    server.wait_for(r"CALL soft tool X 2000.0 .* null space 50.0 force \[40.0, 40.0, 40.0, 10.0.*\]true")
    client.ask("stopDirectServoJoints")
    server.wait_for("servo mode ends")
    assert client.ask("lrFloat_") == "ok_lrFloat_\n"
    server.wait_for(r"CALL soft joints \[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0\]")
    server.say(stop="STOP1", mode="AUT", enabling="NONE")
    server.wait_for("a safety stop, STOP1")
    assert client.ask("lrState_").endswith("_AUT_NONE_STOP1_\n")


@pytest.mark.parametrize("mode", ["doPTPinJS", "startDirectServoJoints"])
def test_a_dead_client_leaves_a_server_that_takes_the_next(serve, mode):
    server = serve()
    server.say(speed=STILL)
    client = server.connect()
    client.ask("jRelVel_0.5_")
    client.ask(HOME)
    client.ask(mode)
    client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    client.close()
    assert server.served().ask("Eef_force") == "0.0_0.0_0.0_\n"
    assert re.search("the client is gone", server.log)


def test_a_client_that_reads_nothing_is_closed(serve):
    server = serve()
    client = server.connect()
    with pytest.raises((ConnectionResetError, BrokenPipeError)):
        for _ in range(100_000):
            client.socket.sendall(b"getJointsPositions\n" * 100)
    assert server.served().ask("getPin3") == "1\n"


def storm(serve, shared_data, ends, least):
    """Edited transcripts, each on a connection of its own; after each the next client is served."""
    server = serve(leaprig__pace=1)
    server.say(speed=FAST)
    seeds = ["".join(t for d, t in spoken(f) if d == ">").encode() for f in sorted((shared_data / "kst").glob("*.txt"))]
    seeds.append(f"lrHello_1_\n{TOOL}\nlrFloat_\nlrStop_\n{HOME}\ndoPTPinJS\nlrPause_\nlrResume_\nlrState_\n".encode())
    count = 0
    while count < least or time.monotonic() < ends:
        client = server.connect()
        with contextlib.suppress(OSError):  # it was closed as it deserved
            client.socket.sendall(edited_bytes(seeds[count % len(seeds)], [count, count + 1, 7 * count]))
        client.close()
        server.served().close()
        count += 1
    assert "failed" not in server.log and server.process.poll() is None
    return count


def test_a_storm_of_words(serve, shared_data):
    storm(serve, shared_data, 0.0, 40)


SECONDS = float(os.environ.get("FUZZ_SECONDS", "1800"))


@pytest.mark.long
@pytest.mark.timeout(2 * SECONDS + 900)
def test_an_hour_of_words(serve, shared_data, classes):
    storm(serve, shared_data, time.monotonic() + SECONDS, 40)
    command = ["java", "-cp", classes, "leaprig.Fuzz", str(SECONDS), str(time.time_ns())]
    subprocess.run(command, check=True)
