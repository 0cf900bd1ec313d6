"""Rows 1 to 17: the link to the arm."""

from __future__ import annotations

import re
import signal

import numpy as np
import rospy

from campaign.judge import Limits
from campaign.network.link import CLEAR
from campaign.network.measure import tracking_error
from campaign.rig import CONTROLLER, DRIVER, TELEOP
from campaign.sockets import connections
from campaign.trial import row
from common import clock
from kuka_msgs.msg import jointPositions

ROBOT_BRAKES = Limits.of_the_drives()
SLOW_LINK_M_S = 0.15


@row(1, "Arm TCP reset by peer", "DL", within=1.5, named_by="out of reach|connection", operator=True,
     limits=ROBOT_BRAKES, dangerous="the commonest end of a link, in the middle of a motion", hazards=(7,))  # fmt: skip
def reset(trial):
    trial.follow()
    trial.fault("arm", "cut", duration=1.5)
    trial.says("connected again", 15.0)
    trial.stays_away(2.0)
    trial.recovers()


@row(2, "Arm half-open TCP (cable out, no FIN)", "HD", within=1.5, named_by="not answered for", operator=True,
     dangerous="no end of file says that the link is gone", hazards=(7,))  # fmt: skip
def half_open(trial):
    trial.follow()
    trial.fault("arm", "half_open", duration=3.0)
    trial.says("connected again|answers again", 15.0)
    trial.stays_away(1.0)
    trial.recovers()


@row(8, "Controller in protective stop", "DL", within=0.8, named_by="safety stop", operator=True, limits=ROBOT_BRAKES,
     dangerous="a person is touched", hazards=(2, 8))  # fmt: skip
def protective_stop(trial):
    trial.follow()
    trial.begins()
    # At joint 1, where the weight of the hand makes no torque.
    trial.rig.arm.ask("set_external_torque", value=[-25.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    trial.says("safety stop", 5.0)
    trial.rig.wait(lambda: trial.rig.arm.now.speed == 0.0, "the arm to stand")
    trial.rig.arm.ask("set_external_torque", value=[0.0] * 7)
    trial.rig.arm.ask("release")
    trial.stays_away(2.0)
    trial.recovers()


def wrong_joints(trial, offset: float, stays: float) -> None:
    """Shifts the measured joints [rad]; the arm is to stop, to say so, and to stay within `stays` [rad]."""
    arm, before = trial.rig.arm, len(trial.rig.said)
    since = arm.now.time
    trial.fault("arm", "shifted", value=offset)
    trial.rig.wait_for_mode("stopped")
    trial.rig.watch(0.7)
    said = [text for _, who, text in trial.rig.said[before:] if who == "kuka/status" and "not believed" in text]
    trial.check(f"the joint is named, at {offset} rad", said and "joint" in said[0], said[:1])
    trial.check(f"the arm moves by less than {stays} rad, at {offset} rad", arm.way(since) < stays, arm.way(since))


def believed_again(trial):
    """Ends that, and waits until the controller knows."""
    said = len(trial.rig.said)
    trial.mend("arm", "shifted")
    believed = lambda: any("believed again" in text for _, _, text in trial.rig.said[said:])  # noqa: E731
    trial.rig.wait(believed, "the joints to be believed again")


@row(16, "Measured joints far from commanded", "DL", within=1.2, named_by="joint . is at .* deg", operator=True,
     limits=ROBOT_BRAKES, dangerous="goals made from wrongly measured joints make the arm jump",
     hazards=(8,))  # fmt: skip
def shifted(trial):
    rig = trial.rig
    trial.follow()
    wrong_joints(trial, 0.5, 0.15)  # while it moves, which it may end
    trial.stays_away(1.0)
    believed_again(trial)
    trial.recovers()
    for offset in (-0.1, 0.02):
        wrong_joints(trial, offset, 0.02)  # while it stands in servo mode
        believed_again(trial)
        trial.recovers()
    rig.hand.hide()
    rig.wait_for_mode("home")
    rig.modes.clear()
    rig.hand.show(right=0.1)
    rig.wait_for_modes("pick_up")
    trial.fault("arm", "shifted", value=0.1)
    rig.wait_for_mode("stopped", "servo")
    trial.check("no stream begins after a pick-up with wrong joints", rig.mode == "stopped", rig.modes)
    rig.hand.hide()
    # They are still wrong when control is switched on: nothing moves.
    rig.control(False)
    answer = rig.control(True)
    refused = not answer.success and "once they are right again" in answer.message
    trial.check("control stays off, and the answer says why", refused, answer.message)
    since = rig.arm.now.time
    rig.watch(1.0)
    trial.check("nothing moves where control is switched on with wrong joints", rig.arm.way(since) < 1e-3, rig.modes)
    believed_again(trial)
    trial.recovers()


@row(17, "Measured joints frozen while commanded moves", "DL", within=1.2, named_by="stands still although",
     operator=True, limits=ROBOT_BRAKES,
     dangerous="the arm moves on unseen, and a goal at the frozen joints would pull it back", hazards=(8,))  # fmt: skip
def frozen(trial):
    rig = trial.rig
    trial.follow()
    since, at = rig.arm.now.time, rig.arm.now.q
    trial.fault("arm", "frozen")
    rig.wait_for_mode("stopped")
    trial.stays_away(2.0)
    away = [np.max(np.abs(sample.q - at)) for sample in rig.arm.since(since)]
    trial.check("the arm does not go back to where its joints are frozen", away[-1] > max(away) - 0.02, away[-1])
    trial.mend("arm", "frozen")
    trial.recovers()


# The goals end in the middle of a motion, which the robot's drives brake.
@row(3, "Arm server accepts but never answers", "DL", within=1.8, named_by="not answered|does not answer",
     operator=True, limits=ROBOT_BRAKES, hazards=(7,))  # fmt: skip
def never_answers(trial):
    rig = trial.rig
    trial.follow()
    trial.fault("arm", "silent")
    rig.wait_for_mode("stopped")
    began = clock.monotonic()
    answer = rig.control(True)
    trial.check("no thread is blocked: a service answers", clock.monotonic() - began < 2.0, answer.message)
    trial.check("control cannot be switched on", not answer.success, answer.message)
    rig.arm.ask("fault", name="cut", duration=0.3)  # and the next connection is accepted and never answered
    trial.says("silent for .* another client", 20.0)
    trial.mend("arm", "silent")
    trial.says("connected again", 20.0)
    trial.stays_away(1.0)
    trial.recovers()


# With slower answers fewer goals leave, and the robot's drives bring the arm to each of them as fast as they may.
@row(4, "Answer split over several reads / two answers in one read", "", within=1.0, variant="shipped/arm",
     limits=ROBOT_BRAKES, hazards=(7,))  # fmt: skip
def torn(trial):
    rig = trial.rig
    trial.follow()
    missed = rig.count("kuka_control", "missed_answers")
    whole = packets(trial, 3.0)
    for fault, value, least, most in (("torn", 0.0001, 2.0, np.inf), ("bursts", 0.03, 0.0, 0.9)):
        trial.fault("arm", fault, value=value)
        rig.wire.set(CLEAR)
        moves_on(trial, f"with {fault} answers", 3.0)
        more = rig.wire.set(CLEAR)["packets"] / whole
        rig.arm.ask("fault", name=fault, on=False)
        # On a real wire the kernel's own packets, which say that others came, count as well.
        seen = not rig.exact or least < more < most
        trial.check(f"{fault} answers are on the wire", seen, f"{more:.2f} times as many packets")
    rig.watch(1.5)  # counters come each second
    more = rig.count("kuka_control", "missed_answers") - missed
    trial.check("no answer is taken for another one", more == 0, f"{more} were left out")


def packets(trial, seconds: float) -> int:
    """Returns how many packets pass on the arm's wire in so much time, both ways."""
    trial.rig.wire.set(CLEAR)
    trial.rig.watch(seconds)
    return trial.rig.wire.set(CLEAR)["packets"]


def moves_on(trial, when: str, seconds: float) -> None:
    """Lets time pass, in which the arm is to follow the moving hand."""
    rig = trial.rig
    began, since = len(rig.statuses), rig.arm.now.time
    rig.watch(seconds)
    modes = {mode for _, mode, _ in rig.statuses[began:]}
    trial.check(f"servo mode lasts {when}", modes == {"servo"}, f"{modes}: {rig.status.reason}")
    trial.check(f"the arm moves {when}", rig.arm.way(since) > 0.02, rig.arm.way(since))


# Fewer goals leave, as in row 4; the reaction is to the garbage that comes instead of every answer, 2 s later.
@row(5, "Garbage or binary in an answer", "DL", within=9.0, named_by="answer is left out|not answered|is missing",
     operator=True, limits=ROBOT_BRAKES, hazards=(7,))  # fmt: skip
def garbage(trial):
    rig = trial.rig
    trial.follow()
    missed = rig.count("kuka_control", "missed_answers")
    trial.fault("arm", "garbled", value=0.02)
    moves_on(trial, "with garbage now and then", 2.0)
    rig.wait(lambda: rig.count("kuka_control", "missed_answers") > missed, "the garbage to be counted")
    rig.arm.ask("fault", name="garbled", value=1.0)
    rig.wait_for_mode("stopped")
    trial.stays_away(2.0)
    trial.mend("arm", "garbled")
    trial.says("connected again", 20.0)
    trial.recovers()


# The goals end in the middle of a motion, as in row 3.
@row(6, "Late answer to an earlier command", "", within=1.0, named_by="not answered|No answer in time",
     limits=ROBOT_BRAKES, hazards=(7,))  # fmt: skip
def late(trial):
    rig = trial.rig
    heard = []
    subscriber = rospy.Subscriber("kuka/joint_positions", jointPositions, heard.append, queue_size=1000)
    trial.follow(sway=False)
    rig.hand.hide()
    rig.wait_for_mode("home")
    rig.watch(0.5)
    heard.clear()
    missed = rig.count("kuka_control", "missed_answers")
    # Outside of servo mode different questions are asked in turn; later than 1 s an answer is given up and another
    # question is asked.
    trial.fault("arm", "slow", value=1.2, duration=4.0)
    rig.watch(7.0)
    subscriber.unregister()
    joints = np.array([angles(message) for message in heard])
    off = np.max(np.abs(joints - rig.arm.now.q)) if len(joints) else np.inf
    trial.check("no late answer is taken for the joints", off < 1e-3, off)
    more = rig.count("kuka_control", "missed_answers") - missed
    trial.check("what was late at home is counted", more > 0, more)
    rig.wait(lambda: rig.mode in ("home", "stopped"), "the rig to know where it is")
    trial.stays_away(0.5)
    trial.recovers()
    missed = rig.count("kuka_control", "missed_answers")
    rig.hand.sway(1.0, right=0.06)
    rig.arm.ask("fault", name="slow", value=0.25, duration=0.6)
    rig.watch(2.0)
    trial.check("what was late in servo mode is counted", rig.count("kuka_control", "missed_answers") > missed)
    if rig.mode != "servo":
        rig.hand.show(right=-0.06)
        rig.wait_for_mode("servo")
        rig.hand.sway(1.0, right=0.06)
    moves_on(trial, "with answers in time again", 1.5)


def angles(message) -> list[float]:
    """Returns the joints of a message [rad]."""
    return [getattr(message, f"joint_{k}") for k in range(1, 8)]


@row(7, 'Arm answers "nak"', "RL", within=3.0, named_by="refused", operator=True, still=True, hazards=(7,))
def refused(trial):
    rig = trial.rig
    assert rig.control(True).success
    trial.fault("arm", "refused")
    rig.modes.clear()
    rig.hand.show(right=0.1)
    rig.wait_for_modes("stopped")
    trial.stays_away(2.0)
    started = [text for _, text in rig.arm.events if "startDirectServoJoints" in text]
    trial.check("servo mode is not taken for running", not started and rig.arm.now.mode == "idle", started)
    rig.hand.hide()
    trial.mend("arm", "refused")
    trial.recovers()


@row(9, "Emergency stop, later released", "DL", within=0.8, named_by="safety stop", operator=True, limits=ROBOT_BRAKES,
     dangerous="after the release the arm must not catch up with a hand that has moved on", hazards=(8,))  # fmt: skip
def emergency_stop(trial):
    rig = trial.rig
    trial.follow()
    trial.fault("arm", "emergency_stop")
    rig.wait_for_mode("stopped")
    rig.wait(lambda: rig.arm.now.speed == 0.0, "the arm to stand")
    rig.watch(1.0)
    rig.arm.ask("fault", name="emergency_stop", on=False)
    rig.watch(0.5)
    since = rig.arm.now.time
    rig.arm.ask("release")
    trial.stays_away(2.0)
    trial.check("nothing is left to be followed at the release", rig.arm.way(since) < 1e-3, rig.arm.way(since))
    trial.recovers()


@row(10, "Application restarted on the pad", "DL", within=1.5, named_by="out of reach|application has ended",
     operator=True, limits=ROBOT_BRAKES, hazards=(1,))  # fmt: skip
def restarted(trial):
    trial.follow()
    trial.fault("arm", "restarted", duration=2.0)
    trial.says("connected again", 20.0)
    trial.stays_away(2.0)
    trial.recovers()


@row(11, "KST velocity mode + link loss", "DL", within=1.5, named_by="out of reach|connection", operator=True,
     limits=ROBOT_BRAKES,
     instead="no part of the rig has a command of the velocity mode (src/modules/kst/tests/test_codec.py), so no speed "
     "can be left behind; provoked is the loss of the link in position servo, and the row looks whether the arm stands "
     "and whether the robot was ever in another servo mode.",
     dangerous="a speed that nobody takes back moves the arm until something stops it", hazards=(7,))  # fmt: skip
def no_velocity_mode(trial):
    rig = trial.rig
    trial.follow()
    trial.fault("arm", "cut", duration=1.0)
    rig.wait_for_mode("stopped")
    rig.wait(lambda: rig.arm.now.speed == 0.0, "the arm to stand without its client")
    trial.says("connected again", 15.0)
    trial.stays_away(1.0)
    trial.recovers()
    modes = {sample.mode for sample in rig.arm.samples} - {"idle", "ptp", "servo"}
    trial.check("the robot was in no other servo mode", not modes, modes)
    foreign = [text for _, text in rig.arm.events if re.search("vel(DC|Dc)|stVel|DcSeCar|stDc|SmartImp", text)]
    trial.check("no other servo mode was asked for", not foreign, foreign[:1])


@row(12, "60 s accept window missed", "R", within=30.0, named_by="start MatlabToolboxServer", still=True, hazards=(7,))
def missed_window(trial):
    rig = trial.rig
    rig.arm.ask("fault", name="window", value=1.0)  # instead of 60 s
    trial.signal(CONTROLLER, signal.SIGTERM)
    rig.wait(lambda: any("no client within" in text for _, text in rig.arm.events), "the window to close", 15.0)
    rig.start(CONTROLLER)
    trial.says("start MatlabToolboxServer", 20.0)
    rig.watch(1.0)
    trial.operator()
    rig.arm.ask("fault", name="window", on=False)  # somebody starts the application
    rig.wait_for_mode("home")
    trial.recovers()


@row(13, "Round-trip time spikes to 200 ms", "", within=1.0, named_by="not answered for", limits=ROBOT_BRAKES,
     argued="lost-robot.md", hazards=(3,))  # fmt: skip
def spikes(trial):
    rig = trial.rig
    trial.follow()
    holds = rig.count("kuka_control", "holds")
    trial.fault("arm", "slow", value=0.2)
    rig.watch(1.0)
    began = rig.arm.now.time
    trial.says("not answered for", 3.0)
    rig.watch(2.0)
    fastest = max(sample.tool_speed for sample in rig.arm.since(began))
    trial.check("the arm is slow", fastest < SLOW_LINK_M_S, f"{fastest:.3f} m/s")
    trial.check("the goals hold", rig.count("kuka_control", "holds") > holds + 2, rig.count("kuka_control", "holds"))
    trial.mend("arm", "slow")
    trial.recovers()


@row(14, "1 % / 10 % loss, reordering, 50 ms jitter", "", within=1.0, variant="shipped/arm", limits=ROBOT_BRAKES,
     dangerous="bursts of late goals could make the arm faster than its limits", hazards=(3,))  # fmt: skip
def bad_link(trial):
    rig = trial.rig
    trial.follow()
    stops = rig.arm.now.stops
    for what, link, allowed in (
        ("1 % loss", {"loss": 0.01}, {"servo"}),
        ("10 % loss", {"loss": 0.1}, {"servo", "stopped"}),
        ("reordering", {"delay": 0.01, "reordered": 0.25}, {"servo"}),
        ("50 ms jitter", {"delay": 0.05, "jitter": 0.05}, {"servo", "stopped"}),
    ):
        if rig.mode != "servo":
            trial.recovers()
            rig.hand.sway(1.0, right=0.06)
        began, before = clock.monotonic(), len(rig.statuses)
        trial.link(**link)
        rig.watch(4.0)
        error = tracking_error(rig, began, clock.monotonic())
        modes = {mode for _, mode, _ in rig.statuses[before:]}
        lost = trial.link()["lost"]
        trial.check(f"it stays in the modes {sorted(allowed)}: {what}", modes and modes <= allowed, modes)
        near = error is not None and error < 120.0
        trial.check(f"it follows to within 0.12 m: {what}", near or rig.mode != "servo", error)
        trial.check(f"packets are lost: {what}", lost > 0 or "loss" not in link, lost)
    trial.check("the robot never stopped the arm", rig.arm.now.stops == stops, rig.arm.now.safety_stop)
    trial.recovers()


# No limit of the stream's 12 rad/s^2: on a busy machine too few goals leave.
@row(
    15,
    "Nagle / delayed ACK stalls",
    "",
    within=1.0,
    limits=ROBOT_BRAKES,
    real="the options are the kernel's",
    hazards=(7,),
)
def nagle(trial):
    rig = trial.rig
    trial.follow()
    port = rospy.get_param("kuka/port")
    to_robot = [c for c in connections(rig.pid(CONTROLLER)).values() if c.peer_port == port]
    trial.check("TCP_NODELAY to the robot", [c.no_delay for c in to_robot] == [True], to_robot)
    for node in (DRIVER, TELEOP, CONTROLLER):
        found = connections(rig.pid(node))
        for number, topic, reader in rig.streams_of(node):
            trial.check(f"TCP_NODELAY of {topic} from {node} to {reader}", found[number].no_delay)
    trial.fault("arm", "nagle")  # as the published server, whose socket has no option
    since = rig.arm.now.time
    moves_on(trial, "with such a server", 3.0)
    # An acknowledgement that is waited for comes after 40 ms; the best half second leaves out a busy machine's pauses.
    seen = [(sample.time, sample.goals) for sample in rig.arm.since(since)]
    best = max((g - g0) / (t - t0) for t0, g0 in seen for t, g in seen if 0.4 < t - t0 < 0.6)
    trial.check("no goal waits for an acknowledgement", best > 30.0, f"{best:.0f} goals a second at best")
    trial.mend("arm", "nagle")
