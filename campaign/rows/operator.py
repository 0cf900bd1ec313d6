"""Rows 74 to 79: the control panel, services, parameters, the end of the programs and of the power."""

from __future__ import annotations

import contextlib
import signal

import numpy as np

from campaign.judge import Expected, Limits
from campaign.rig import CONTROLLER
from campaign.trial import Trial, row
from common import clock
from common.modes import TO_DESIRED_TOOL
from kuka_msgs.srv import setGripperControl, setKukaControl, setPayload, setScalingFactor

MEAN_STEPS = 200  # [ms]
START_S = 30.0  # longest wait for a program with a window [s]


def follows(trial: Trial) -> bool:
    """Returns whether the arm follows the swaying hand and did so ever since the fault; a jump is picked up."""
    rig = trial.rig
    moves = rig.wait(lambda: rig.mode == "servo" and rig.arm.now.tool_speed > 0.05, "the arm to follow")
    return moves and {mode for when, mode, _ in list(rig.statuses) if when > trial.begins()} <= set(TO_DESIRED_TOOL)


@row(74, "GUI closed or frozen", "", real="the panel's window and its event loop are Qt's", hazards=(9,))
def panel(trial):
    """The hand is what holds the arm, not the panel: docs/decisions/control-panel.md."""
    rig = trial.rig

    def opened():
        program = rig.run("kuka_control", "gui.py")
        rig.wait(lambda: rig.pid("kuka_panel") is not None, "the panel", START_S)
        rig.watch(2.0)  # it subscribes
        return program

    program = opened()
    trial.follow()
    for name, number in (("frozen", signal.SIGSTOP), ("killed", signal.SIGKILL), ("closed", signal.SIGTERM)):
        if program.poll() is not None:
            program = opened()
            rig.wait(lambda: rig.arm.now.tool_speed > 0.05, "the arm to move")
        trial.begins()
        rig.kill(rig.pid("kuka_panel") if number != signal.SIGKILL else program.pid, number)
        if number != signal.SIGSTOP:
            rig.finish(program)
        rig.watch(2.0)
        trial.check(f"the arm follows on with the panel {name}", follows(trial), rig.modes[-5:])
        trial.part(name, Expected("", 1.0))
    trial.begins()
    trial.check("the services are there without it", rig.control(True).success)
    trial.operator()
    trial.call("kuka/kuka_control", setKukaControl, False)
    rig.wait_for_modes("returning", "home")


@row(75, "GUI double click / out-of-order service calls", "D", within=1.0, operator=True, hazards=(12,))
def service_calls(trial):
    rig = trial.rig
    trial.follow()
    trial.begins()
    # Twice the same is once; what comes at a wrong time is refused, with its reason, and changes nothing.
    for _ in range(2):
        answer = trial.call("kuka/kuka_control", setKukaControl, True)
        trial.check("control on again is accepted", answer.success and "already" in answer.message, answer.message)
        trial.check("gripper control twice", trial.call("kuka/gripper_control", setGripperControl, True).success)
    for factor in (float("nan"), -1.0):
        answer = trial.call("kuka/scaling_factor", setScalingFactor, factor)
        trial.check(f"scaling factor {factor} is refused", not answer.success and "stays 1" in answer.message)
    for mass in (float("nan"), -1.0, 1e9):
        answer = trial.call("kuka/set_payload", setPayload, mass)
        trial.check(f"payload {mass} is refused", not answer.success and "stays 0 kg" in answer.message, answer.message)
    trial.check("the arm follows on", follows(trial), rig.modes[-5:])
    trial.part("the wrong time", Expected("", 1.0))
    # Many at once: off wins if it comes last, and a hand in the box starts nothing, however often that is.
    trial.begins()
    clicks = [clock.Thread(target=rig.control, args=(bool(i % 2),)) for i in range(12)]
    for click in clicks:
        click.start()
    for click in clicks:
        click.join()
    for _ in range(2):
        trial.check("off is accepted", trial.call("kuka/kuka_control", setKukaControl, False).success)
    trial.stays_away(2.0)
    trial.check("control is off", not rig.status.control_on)
    trial.check("the gripper too", trial.call("kuka/gripper_control", setGripperControl, False).success)
    answer = trial.call("kuka/kuka_control", setKukaControl, True)
    trial.check("on is accepted at home", answer.success, answer.message)
    trial.stays_away(2.0)  # with the hand still in the box
    trial.recovers()


BAD = {
    "tcp_speed": (-1.0, "tcp_speed is -1.0, but must be a finite number in (0, 0.8) m/s"),
    "joint_speed": ("fast", "joint_speed is 'fast', but must be a finite number in (0, 1]"),
    "joint_jerk": (float("nan"), "joint_jerk is nan, but must be a finite number in [20, 2000] rad/s^3"),
    "rate_servo": (1e9, "rate_servo is 1000000000.0, but must be a finite number in [50, 1000] Hz"),
    "home_pos": ([0.0, 1.0], "home_pos is [0.0, 1.0], but must be 7 finite numbers, each in [-180, 180] deg"),
    "tcp_sped": (0.3, "tcp_sped is not a known key"),
}
"""Values that no controller starts with, and what it says of them."""


@contextlib.contextmanager
def parameters(rig, **values):
    """Changes parameters under kuka/ for a while."""
    import rospy

    before = {name: rospy.get_param(f"kuka/{name}", None) for name in values}
    rig.set(**values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                rospy.delete_param(f"kuka/{name}")
            else:
                rospy.set_param(f"kuka/{name}", value)


def starts_not(trial: Trial, *command: str) -> str:
    """Starts a second controller under another name, which must refuse its parameters; returns what it says."""
    rig = trial.rig
    program = rig.run(*command, "__name:=second")
    text = rig.finish(program, START_S)
    trial.check(f"{command[1]} ends with 1", program.returncode == 1, text)
    trial.check("it did not reach for the robot", "Connecting to the robot" not in text, text)
    return text


@row(76, "Bad parameter (negative, string, unit)", "R", within=30.0, named_by="tcp_speed is -1", hazards=(13,))
def bad_parameters(trial):
    rig = trial.rig
    trial.follow()
    trial.begins()
    with parameters(rig, **{name: value for name, (value, _) in BAD.items()}):
        text = starts_not(trial, "kuka_control", "real_time_controller.py")
        for line in text.splitlines():
            rig.hear("the second controller", line)
        for sentence in (sentence for _, sentence in BAD.values()):
            trial.check(f"it says: {sentence}", f"kuka/{sentence}" in text, text)
        # The running one has its own values.
        trial.check("the arm follows on", follows(trial), rig.modes[-5:])
    trial.check("one controller runs", rig.pid("second") is None and rig.pid(CONTROLLER) is not None)


@row(77, "Limits raised at run time", "R", within=60.0, named_by="tcp_speed is 5",
     argued="limits-at-the-start.md", hazards=(13,))  # fmt: skip
def limits_raised(trial):
    rig = trial.rig
    with trial.controller(tcp_speed=0.1):
        trial.follow(sway=False)
        rig.hand.sway(0.4, right=0.06)
        rig.watch(1.0)
        # On the parameter server a value is only that: the controller keeps the one it began with.
        began = trial.begins()
        rig.set(tcp_speed=0.65, joint_speed=0.9)
        rig.watch(3.0)
        answer = trial.call("kuka/scaling_factor", setScalingFactor, 1.5)
        trial.check("a larger scale is no limit", answer.success, answer.message)
        rig.watch(3.0)
        # The mean: behind a late goal the robot's drives hurry for a moment.
        speeds = [speed for when, *_, speed in list(rig.arm.steps) if when > began]
        fastest = float(np.max(np.convolve(speeds, np.full(MEAN_STEPS, 1.0 / MEAN_STEPS), "valid")))
        trial.check("the tool keeps to the old limit", 0.05 < fastest < 0.12, f"{fastest:.3f} m/s")
        # Above the hard cap no controller starts.
        rig.set(tcp_speed=5.0)
        for line in starts_not(trial, "kuka_control", "real_time_controller.py").splitlines():
            rig.hear("the second controller", line)
        trial.check("the arm follows on", follows(trial), rig.modes[-5:])
        rig.hand.hide()
    # Within it a deliberate new start takes the value over, and says so.
    trial.reads(r"tcp_speed=0\.65,")
    trial.check("control is off after the start", not rig.status.control_on)


@row(78, "Ctrl-C / SIGTERM / launch shutdown", "HS", within=1.0, spoils=True, hazards=(9,))
def interrupted(trial):
    rig = trial.rig
    for number in (signal.SIGINT, signal.SIGTERM):
        trial.follow()
        rig.modes.clear()
        trial.signal(CONTROLLER, number)
        ends_in_order(trial)
        trial.part(number.name, Expected("HS", 1.0))
        rig.hand.hide()
        rig.start(CONTROLLER)
        rig.wait_for_mode("home")
    # All nodes at once, which crowds the processor: their launch file ends. The devices have one of their own.
    old = rig.pids()
    trial.killed.update(old)
    rig.launch(devices=False)
    rig.wait(lambda: rig.mode == "home" and rig.status.pid not in old.values(), "the new nodes", START_S)
    rosout = {old.get("/rosout")}
    rig.wait(lambda: not set(old.values()) - rosout & set(rig.pids().values()), "the end of the older ones")
    rig.wait(lambda: rig.stream_state == "waiting", "the stream to wait")
    trial.follow()
    pids = {name: pid for name, pid in rig.pids().items() if name != "/rosout"}
    trial.begins()
    rig.interrupt_launch()
    ends_in_order(trial)
    rig.wait(lambda: not any(map(rig.runs, pids.values())), "the end of all nodes", 30.0)


def ends_in_order(trial: Trial) -> None:
    """Waits until the arm stands without a client, and notes whether the client said goodbye in time."""
    rig, began = trial.rig, trial.begins()
    rig.wait(lambda: not rig.arm.now.connected and rig.arm.now.speed == 0.0, "the end of connection and motion")
    rig.watch(0.5)
    goodbye = [when - began for when, text in list(rig.arm.events) if when >= began and text == "received end"]
    trial.check("`end` came once, within 1 s", len(goodbye) == 1 and goodbye[0] < 1.0, goodbye)
    trial.check("the arm is idle", rig.arm.now.mode == "idle" and rig.arm.now.safety_stop is None, rig.arm.now.mode)


@row(79, "Power cut of the PC", "H", within=2.0, spoils=True, variant="deaf", operator=True,
     limits=Limits.of_the_drives(),
     instead="The machine that runs the campaign keeps its power. What the robot sees of a power cut is provoked: its "
     "wire falls silent without a word, then all processes of the rig are killed at once. The simulated controller "
     "does what the published one does: it holds the last goal. Brakes and cabinet are the arm's own.",
     dangerous="no program is left to do anything", hazards=(9,))  # fmt: skip
def power_cut(trial):
    rig = trial.rig
    trial.follow()
    pids = rig.pids()
    trial.killed.update(pids)
    trial.begins()
    rig.suspend(CONTROLLER)  # together with the wire: a goal that waited in it would move the arm when it is back
    rig.arm.ask("fault", name="half_open")
    for pid in pids.values():
        rig.kill(pid, signal.SIGKILL)
    rig.watch(2.0)
    stands = rig.arm.now.time  # but for the last thousandths, to which the law of joint servo takes seconds
    rig.watch(2.0)
    rig.arm.ask("fault", name="half_open", on=False)  # as when the PC starts again, and the robot gets its reset
    rig.watch(2.0)
    trial.check("the arm stays where its last goal was", rig.arm.way(stands) < 5e-3, f"{rig.arm.way(stands):.5f} rad")
    sent = [text for when, text in list(rig.arm.events) if when > trial.begins() and text.startswith("received")]
    trial.check("nobody sent it anything", not sent, sent)
    trial.check("nothing stopped it but that", rig.arm.now.safety_stop is None, rig.arm.now.safety_stop)
