"""Rows 84 to 93: the robot application, which watches its client, stops what moves, knows its tool and can be soft."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator

import numpy as np
import rospy

from campaign.judge import Expected, Limits
from campaign.rig import CONTROLLER, PATIENCE_S
from campaign.trial import row
from common import clock
from common.frames import BASE
from common.ros.conversions import stamped_pose
from fuzz.mutations import edited_bytes
from kst import KstError
from kst.transport import KstTransport
from kuka_msgs.msg import MoveGoal

ROBOT_BRAKES = Limits.of_the_drives()
AWAY = np.radians([-20.0, 35.0, 0.0, -70.0, 0.0, 75.0, 20.0])  # joints within the workspace
BRAKES_S, STOPS_S = 0.35, 0.15  # watchdog and way to rest; a stop that was asked for [s]
TOOL = "lrTool_1.12_-22_0_72.7_0_0_106_0_0_0_"
SOFT = "lrSoftJoints_300_300_300_300_200_100_50_0.7_"


class Words:
    """A plain client of the robot, beside the controller or in its place."""

    def __init__(self, rig) -> None:
        self._transport = KstTransport.connect("127.0.0.1", int(rig.argument("robot_port")), PATIENCE_S)

    def say(self, line: str) -> None:
        """Sends a line."""
        self._transport.send(line, PATIENCE_S)

    def ask(self, line: str) -> str:
        """Sends a line; returns the answer, empty where the connection has ended."""
        with contextlib.suppress(KstError):
            self.say(line)
            reply = self._transport.receive(clock.monotonic() + PATIENCE_S)
            return "" if reply is None else reply.text
        return ""

    def vanish(self) -> None:
        """Goes without a word."""
        self._transport.close()
        self._transport.close()


def go_away(trial) -> None:
    """Begins a PTP motion for a program, and waits until the arm moves."""
    rig = trial.rig
    assert rig.control(True).success
    rig.moves().send_goal(MoveGoal(kind=MoveGoal.JOINTS, joints=AWAY.tolist(), velocity=0.25))
    rig.wait_for_mode("moving")
    moves(trial)


def moves(trial, speed: float = 0.3) -> None:
    """Waits until the fastest joint is faster than this [rad/s]."""
    trial.rig.wait(lambda: trial.rig.arm.now.speed > speed, "the arm to move", 15.0)


@row(84, "Robot application: cable out in a PTP motion", "H", within=BRAKES_S, named_by="not answered|out of reach",
     operator=True, limits=ROBOT_BRAKES, variant="watched", dangerous="a motion that the robot plans needs no goals",
     hazards=(4, 7))  # fmt: skip
def cable_out_in_a_motion(trial):
    go_away(trial)
    trial.fault("arm", "half_open", duration=3.0)
    trial.says("connected again|answers again", 15.0)
    trial.rig.wait_for_mode("stopped")
    trial.stays_away(1.0)
    trial.recovers()


@row(85, "Robot application: PC killed in a PTP motion", "H", within=STOPS_S, operator=True, limits=ROBOT_BRAKES,
     variant="watched", hazards=(4, 9))  # fmt: skip
def killed_in_a_motion(trial):
    go_away(trial)
    trial.signal(CONTROLLER, signal.SIGKILL)
    trial.stays_away(2.0)
    trial.operator()
    trial.rig.start(CONTROLLER)
    trial.rig.wait_for_mode("home", "stopped")
    trial.recovers()


@row(86, "Robot application: PC frozen in a PTP motion", "H", within=BRAKES_S, named_by="silent for longer",
     operator=True, limits=ROBOT_BRAKES, variant="watched", hazards=(4, 9))  # fmt: skip
def frozen_in_a_motion(trial):
    rig = trial.rig
    go_away(trial)
    node = rig.pid(CONTROLLER)
    trial.begins()
    rig.suspend(CONTROLLER)
    rig.watch(2.0)
    rig.kill(node, signal.SIGCONT)
    trial.ends()
    trial.says("silent for longer")
    rig.wait_for_mode("stopped")
    trial.stays_away(1.0)
    trial.recovers()


@row(87, "Robot application: stop during each motion", "L", within=1.0, named_by="it was asked to", operator=True,
     limits=ROBOT_BRAKES, variant="watched", dangerous="who says stop expects the arm to stop",
     hazards=(4, 19))  # fmt: skip
def stop_in_each_motion(trial):
    rig = trial.rig

    def stopped(stop: Callable[[], object]) -> None:
        trial.begins()
        stop()
        trial.stands(STOPS_S)
        rig.wait_for_mode("stopped")
        trial.stays_away(1.5)

    def part(name: str) -> None:
        trial.part(name, Expected("L", 1.0, "it was asked to|control is off", operator=True, limits=ROBOT_BRAKES))

    def anybody_stops() -> None:
        client = Words(rig)
        answer = client.ask("lrStop_")
        trial.check("anybody may stop the arm", answer == "ok_lrStop_", answer)
        client.vanish()

    def control_off() -> None:
        assert rig.control(False).success

    go_away(trial)
    stopped(control_off)
    part("a motion for a program")
    assert rig.control(True).success
    rig.wait_for_mode("homing")
    moves(trial, 0.1)
    stopped(control_off)
    part("the motion home")
    assert rig.control(True).success
    rig.wait_for_mode("home")
    up = rig.arm.now.T_base_tool.copy()
    up[2, 3] += 0.15
    line = stamped_pose(up, BASE, rospy.Time())
    rig.moves().send_goal(MoveGoal(kind=MoveGoal.POSE, pose=line, straight=True, velocity=0.1))
    rig.wait(lambda: rig.arm.now.T_base_tool[2, 3] > up[2, 3] - 0.1, "the arm on the line", 15.0)
    stopped(anybody_stops)
    part("a straight line")
    rig.control(False)
    assert rig.control(True).success
    rig.wait_for_mode("home")
    rig.hand.show(right=0.1)
    rig.wait_for_mode("pick_up")
    moves(trial, 0.1)
    stopped(control_off)
    part("the motion to pick-up")
    rig.hand.hide()
    trial.follow()
    stopped(anybody_stops)
    trial.recovers()


def touch(trial, torque: float) -> None:
    """Lets something press on joint 1, where the weight of the hand makes no torque [Nm]."""
    trial.rig.arm.ask("set_external_torque", value=[torque, *[0.0] * 6])


@contextlib.contextmanager
def in_its_place(trial) -> Iterator[Words]:
    """Ends the controller, and yields a client that has said hello and which tool the arm has; then the controller
    starts again."""
    rig = trial.rig
    trial.killed.add(f"/{CONTROLLER}")
    rig.signal(CONTROLLER, signal.SIGKILL)
    rig.wait(lambda: not rig.arm.ask("state")["connected"], "the controller to be gone")
    client = Words(rig)
    hello = client.ask("lrHello_1_")
    trial.check("the next client is served", hello.startswith("ok_lrHello"), hello)
    trial.check("the tool is taken", client.ask(TOOL).startswith("ok_lrTool"))
    try:
        yield client
    finally:
        client.vanish()
        rig.arm.ask("set_tcp_force", value=[0.0] * 3)
        rig.arm.ask("set_enabling", value=False)
        trial.operator()
        rig.start(CONTROLLER)
        rig.wait_for_mode("home", "stopped")
    trial.recovers()


def soften(trial, client: Words) -> None:
    """Begins a soft servo mode."""
    answers = client.ask(SOFT), client.ask("startDirectServoJoints")
    trial.check("the arm is soft", answers[0].startswith("ok_lrSoftJoints_") and answers[1] == "done", answers)
    clock.sleep(0.15)  # until servo mode runs


def leads(trial, client: Words, beats: int) -> None:
    """Lets an arm in servo mode turn joint 1, goal by goal."""
    q = trial.rig.arm.now.q
    for k in range(beats):
        goal = q + 0.4 * 0.01 * k * np.eye(7)[0]
        client.ask(f"jp_{'_'.join(f'{x:.5f}' for x in goal)}_")
        clock.sleep(0.01)


@row(88, "Robot application: client lost while the arm is soft", "H", within=0.5, operator=True, limits=ROBOT_BRAKES,
     variant="watched", hazards=(7, 9))  # fmt: skip
def lost_while_soft(trial):
    with in_its_place(trial) as client:
        soften(trial, client)
        leads(trial, client, 100)
        trial.check("it moves", trial.rig.arm.now.speed > 0.05, trial.rig.arm.now.speed)
        trial.begins()
        client.vanish()
        trial.stays_away(2.0)


@row(89, "Robot application: wrong tool mass", "R", within=2.0, named_by="load check fails", variant="watched",
     still=True, hazards=(24, 27))  # fmt: skip
def wrong_mass(trial):
    rig = trial.rig
    with in_its_place(trial) as client:
        trial.begins()
        for kg in (0.0, 3.0):
            tool = client.ask(TOOL.replace("1.12", str(kg)))
            trial.check("the answer says what the robot reckons with", tool.startswith(f"ok_lrTool_{kg}_"), tool)
            for line in (SOFT, "lrFloat_"):
                answer = client.ask(line)
                rig.hear("the robot", answer)
                why = "load check fails" if kg else "mass is not known"
                trial.check(f"{line} is refused with {kg} kg", answer.startswith("no_") and why in answer, answer)
        rig.watch(1.0)


@row(90, "Robot application: contact in each mode", "DL", within=0.8, named_by="safety stop", operator=True,
     limits=ROBOT_BRAKES, variant="watched", dangerous="a person is touched", hazards=(2, 4, 16))  # fmt: skip
def contact_in_each_mode(trial):
    rig = trial.rig
    with in_its_place(trial) as client:
        soften(trial, client)
        touch(trial, -15.0)
        rig.wait(lambda: client.ask("lrBeat_") == "ok_lrBeat_" and rig.arm.way() > 0.04, "the arm to give way")
        mode = rig.arm.now.mode
        trial.check("a soft arm gives way and stays in servo mode", mode == "servo", mode)
        trial.begins()
        touch(trial, -40.0)
        rig.wait(lambda: client.ask("lrState_").startswith("state_IDLE_"), "the end of its servo mode")
        touch(trial, 0.0)
        rig.wait(lambda: rig.arm.now.speed == 0.0, "the arm to stand")
        rig.arm.ask("release")
        rig.watch(1.0)
    trial.part("a soft arm", Expected("H", 0.3, operator=True, limits=ROBOT_BRAKES))
    rig.hand.hide()
    rig.control(False)
    rig.wait_for_mode("home")
    rig.modes.clear()
    go_away(trial)
    trial.begins()
    touch(trial, 15.0)  # ends a PTP, is no safety stop
    rig.wait_for_mode("stopped")
    touch(trial, 0.0)
    trial.stays_away(1.5)
    trial.part("a PTP motion", Expected("L", 0.5, "touched something.*joint 1", operator=True, limits=ROBOT_BRAKES))
    rig.control(False)
    trial.follow()
    trial.begins()
    touch(trial, -25.5)
    trial.says("safety stop")
    rig.wait(lambda: rig.arm.now.speed == 0.0, "the arm to stand")
    touch(trial, 0.0)
    rig.arm.ask("release")
    trial.stays_away(2.0)
    trial.recovers()


@row(91, "Robot application: second client", "R", within=2.0, named_by="busy_", variant="watched", hazards=(12, 22))
def second_client(trial):
    rig = trial.rig
    trial.follow()
    trial.begins()
    for line in ("getJointsPositions", "lrHello_1_", "jp_0_0_0_0_0_0_0_", "doPTPinJS", "stopDirectServoJoints"):
        client = Words(rig)
        answer = client.ask(line)
        rig.hear("second client", answer)
        trial.check(f"{line} is answered by who holds the arm", answer.startswith("busy_127.0.0.1:"), answer)
        client.vanish()
    follows_on(trial, 2.0)


@row(92, "Robot application: malformed storm", "", variant="watched", hazards=(11, 22))  # fmt: skip
def storm(trial):
    rig = trial.rig
    trial.follow()
    trial.begins()
    seeds = [f"lrHello_1_\n{TOOL}\nlrFloat_\n", "jp_0_0_0_0_0_0_NaN_\ndoPTPinJS\n", "lrChannel_100001_\nlrPause_\n"]
    for k in range(60):
        data = edited_bytes(seeds[k % 3].encode(), [k, k + 1, 7 * k]).decode("latin-1")
        text = "".join(chr(ord(c) % 128) for c in data).replace("lrStop", "")
        with contextlib.suppress(KstError):
            client = Words(rig)
            client.say(text)
            client.vanish()
    follows_on(trial, 2.0)


def follows_on(trial, seconds: float) -> None:
    """Lets time pass, in which the arm is to follow its hand."""
    began, since = len(trial.rig.statuses), trial.rig.arm.now.time
    trial.rig.watch(seconds)
    modes = {mode for _, mode, _ in trial.rig.statuses[began:]}
    trial.check("the arm follows on", modes == {"servo"} and trial.rig.arm.way(since) > 0.02, trial.rig.status.reason)


@row(93, "Robot application: enabling switch released in hand guiding", "H", within=0.35, operator=True,
     limits=ROBOT_BRAKES, variant="watched", hazards=(1, 28))  # fmt: skip
def switch_released(trial):
    rig = trial.rig
    with in_its_place(trial) as client:
        answer = client.ask("lrGuide_")
        trial.check("hand guiding begins", answer == "ok_lrGuide_", answer)
        rig.arm.ask("set_enabling", value=True)
        rig.arm.ask("set_tcp_force", value=[0.0, 30.0, 0.0])
        rig.wait(lambda: client.ask("lrBeat_") == "ok_lrBeat_" and rig.arm.now.speed > 0.1, "the hand to move the arm")
        trial.begins()
        rig.arm.ask("set_enabling", value=False)
        for _ in range(100):
            client.say("lrBeat_")
            clock.sleep(0.02)
