"""Rows 33 to 42: the master, the nodes, their queues and their processor, and the disk."""

from __future__ import annotations

import os
import signal
import sys
import tempfile

import rospy
from tf2_msgs.msg import TFMessage

from campaign.judge import Expected, Limits
from campaign.rig import CONTROLLER, DRIVER, HAND, HAND_DRIVER, TELEOP
from campaign.trial import row
from common import clock
from common.modes import TO_DESIRED_TOOL

ROBOT_BRAKES = Limits.of_the_drives()
"""Where goals fail to come in time the drives brake by themselves: a node dies, or stands still."""
POSE = ("0.42", "-0.42", "0.5", "135", "0", "180")  # in the workspace [m, deg]
STALE_S = 0.5  # a desired tool frame older than this when it is published comes out of a queue [s]


def moves(trial) -> bool:
    """Returns whether the arm follows the swaying hand within the next seconds."""
    return bool(trial.rig.wait(lambda: trial.rig.mode == "servo" and trial.rig.arm.now.tool_speed > 0.05, "the arm"))


def pause(rig, node: str, seconds: float) -> None:
    """Lets a node stand still for so long."""
    pid = rig.pid(node)  # which nobody answers while it does
    rig.suspend(node)
    try:
        rig.watch(seconds)
    finally:
        rig.kill(pid, signal.SIGCONT)


@row(33, "roscore killed", "D", within=1.5, named_by="ROS master .* is gone", operator=True,
     spoils=True, dangerous="no service reaches the controller any more", hazards=(9,))  # fmt: skip
def master_killed(trial):
    rig = trial.rig
    trial.follow()
    # A master that hangs: nobody waits for it, and the hand still lets go of the arm.
    trial.begins()
    with rig.core.hanging():
        rig.watch(1.0)
        trial.check("the arm follows on while the master hangs", rig.mode in TO_DESIRED_TOOL, rig.mode)
        rig.hand.hide()
        rig.wait_for_modes("returning", "home")
        trial.stays_away(2.0)
    trial.part("the master hangs", Expected("D", 4.0))
    trial.follow()
    trial.killed.add("/rosout")
    trial.begins()
    rig.core.kill()
    trial.reads("ROS master at .* is gone")
    trial.stays_away(4.0)  # with the hand in the box all the time
    trial.check("control is off", not rig.status.control_on, rig.status.reason)
    trial.check("the arm is at home", rig.mode == "home", rig.mode)


@row(34, "roscore restarted", "DS", within=1.5, named_by="started anew", operator=True, spoils=True, hazards=(9,))
def master_restarted(trial):
    rig = trial.rig
    trial.follow()
    nodes = (CONTROLLER, DRIVER, TELEOP, HAND, HAND_DRIVER)
    pids = {name: rig.pid(name) for name in nodes}
    trial.killed.update(f"/{name}" for name in (*nodes, "rosout"))
    trial.begins()
    rig.core.kill()
    trial.reads("ROS master at .* is gone")
    rig.core.start()
    trial.reads("started anew")
    for name in nodes:
        trial.check(f"{name} exits for a new start", rig.exit_code(name) == 1)
    rig.wait(lambda: not rig.arm.now.connected, "the end of the connection")
    trial.check("the robot got `end`", any("received end" in text for _, text in list(rig.arm.events)))
    rig.status, rig.mode = None, ""
    rig.listen()
    rig.launch(devices=False)
    rig.wait(lambda: rig.mode == "home", "the rig that was started again", 60.0)
    trial.check("all are new", not set(pids.values()) & {rig.pid(name) for name in nodes})
    trial.check("control is off", not rig.status.control_on)
    stood = rig.arm.now.time
    trial.stays_away(3.0)  # the hand has been in the box all the time
    trial.check("no hand moves the arm", rig.arm.way(stood) < 2e-3, f"{rig.arm.way(stood):.4f} rad")
    trial.recovers()


@row(35, "Any of our nodes killed (-9)", "H", within=1.5, named_by=f"{CONTROLLER}.*process has died", operator=True,
     limits=ROBOT_BRAKES, spoils=True, dangerous="a program that crashed sends no stop", hazards=(9,))  # fmt: skip
def node_killed(trial):
    rig = trial.rig
    trial.follow()
    # The robot hand is another device: its nodes take the arm nothing.
    for name in (HAND, HAND_DRIVER):
        trial.signal(name, signal.SIGKILL)
        trial.reads(f"{name}.*process has died")
        trial.check(f"the arm follows on without {name}", moves(trial), rig.mode)
        trial.part(name, Expected("", 1.5, limits=ROBOT_BRAKES, named_by=f"{name}.*process has died"))
    trial.check("leap_hand_node was not alone", rig.pid(HAND) is None and rig.pid(HAND_DRIVER) is None)
    # Without tracker or teleoperation the stream ends.
    for name in (DRIVER, TELEOP):
        rig.modes.clear()
        trial.signal(name, signal.SIGKILL)
        trial.reads(f"{name}.*process has died")
        rig.wait_for_modes("returning", "home")
        trial.stays_away(2.0)
        trial.part(name, Expected("D", 4.0, f"{name}.*process has died", operator=True, limits=ROBOT_BRAKES))
        rig.hand.hide()
        rig.start(name)
        rig.wait(lambda: rig.stream_state == "waiting", "the stream to wait")
        trial.follow()
    # Without the controller the robot's own one brakes.
    trial.signal(CONTROLLER, signal.SIGKILL)
    trial.reads(f"{CONTROLLER}.*process has died")
    trial.stays_away(2.0)


@row(36, "Node started twice (same name)", "DS", within=10.0, named_by="new node registered with same name",
     operator=True, dangerous="two controllers, each with goals of its own", hazards=(9,))  # fmt: skip
def started_twice(trial):
    rig = trial.rig
    trial.follow()
    trial.killed.add(f"/{CONTROLLER}")
    old = rig.pid(CONTROLLER)
    rig.start(CONTROLLER)
    bumped = "new node registered with same name"
    looked = [clock.monotonic()]

    def asked_to_end() -> bool:
        looked.append(clock.monotonic())
        return bumped in rig.log_since_calm

    rig.wait(asked_to_end, "the older one to be asked to end", 60.0)
    trial.begins(looked[-2])  # it may have ended before it was seen to be asked
    trial.reads(bumped)
    rig.wait(lambda: not rig.runs(old), "the end of the older one")
    rig.watch(3.0)
    left = [when - trial.begins() for when, text in list(rig.arm.events) if "stopDirectServoJoints" in text]
    trial.check("the older one has left servo mode at once", left and 0.0 < left[-1] < 1.5, left)
    rig.wait_for_mode("home")  # only the newer one says so, once it is connected
    trial.stays_away(2.0)
    trial.check("the newer one is alone", rig.pid(CONTROLLER) not in (None, old))
    trial.check("and waits with control off", not rig.status.control_on, rig.status.reason)
    trial.recovers()


@row(37, "Two command sources at once", "R", within=10.0, named_by="A program may move the arm at home",
     dangerous="a program moves the arm while a person steers it", hazards=(12,))  # fmt: skip
def two_sources(trial):
    rig = trial.rig
    trial.follow()
    trial.begins()
    # A program while a hand steers: the hand keeps the arm.
    text = rig.finish(program := rig.run("kuka_control", "move.py", "home"))
    trial.check("move.py is refused", program.returncode == 1 and "mode is servo" in text, text)
    text = rig.finish(program := rig.run("kuka_control", "simple_controller.py", "zero", "--yes"))
    trial.check("simple_controller.py is refused", program.returncode not in (0, None), text)
    trial.check("the arm follows on", moves(trial), rig.modes[-5:])
    trial.check("and did so ever since", {mode for _, mode, _ in rig.statuses[-20:]} <= set(TO_DESIRED_TOOL))


@row(38, "Subscriber queue builds up", "H", within=0.8, limits=ROBOT_BRAKES, hazards=(9,))
def queue_builds_up(trial):
    rig = trial.rig
    ages: list[float] = []
    subscriber = rospy.Subscriber("/tf", TFMessage, lambda message: ages.extend(
        rospy.get_time() - t.header.stamp.to_sec()
        for t in message.transforms if t.child_frame_id == "kuka/tool_frame/desired"
    ), queue_size=1000)  # fmt: skip
    # Subscribers that never read, of all that stands between hand and arm: the nodes do not wait for them.
    deaf = [
        rig.deaf(topic, node)
        for topic, node in (
            ("/leap_motion/leap_device", DRIVER), ("/tf", TELEOP), ("/leap_kuka/stream", TELEOP),
            ("/tf", CONTROLLER), ("/kuka/status", CONTROLLER), ("/kuka/joint_positions", CONTROLLER),
            ("/reflex_takktile/hand_state", HAND_DRIVER),
        )
    ]  # fmt: skip
    try:
        trial.follow()
        rig.watch(3.0)
        trial.check("nobody waits for those who do not read", moves(trial), rig.modes[-5:])
        # The hand moves on while the teleoperation stands still: frames that waited are those of a stream that is over.
        ages.clear()
        rig.modes.clear()
        trial.begins()
        pause(rig, TELEOP, 0.9)
        trial.ends()
        rig.wait_for_modes("home")
        trial.stays_away(2.0)
        old = [age for age in ages if age > STALE_S]
        trial.check("no frame comes out of a queue but the one that was at work", len(old) <= 1, old)
        trial.part("the teleoperation stands still", Expected("D", 0.8, operator=True))
        rig.hand.hide()
        trial.follow()
        # Likewise the controller, which takes the newest frame and catches up within the limits.
        trial.begins()
        pause(rig, CONTROLLER, 0.9)
        trial.ends()
        rig.watch(2.0)
        trial.check("the arm is not where it stood", moves(trial), rig.modes[-5:])
    finally:
        subscriber.unregister()
        for connection in deaf:
            connection.close()


@row(39, "Callback raises", "D", within=4.0, named_by="bad callback|no tracking frames", operator=True, hazards=(9,))
def callback_raises(trial):
    rig = trial.rig
    trial.killed.add(f"/{TELEOP}")
    rig.signal(TELEOP, signal.SIGINT)
    rig.exit_code(TELEOP)
    rig.stream_state = ""
    node = rig.program(sys.executable, "-m", "campaign.planted_fault", f"__name:={TELEOP}")
    rig.wait(lambda: rig.stream_state == "waiting", "the node with a fault", 20.0)
    trial.follow()
    trial.begins()
    rig.signal(TELEOP, signal.SIGUSR1)  # from now on each frame raises an exception
    trial.says("no tracking frames", 10.0)
    rig.wait_for_modes("returning", "home")
    rig.signal(TELEOP, signal.SIGUSR1)
    trial.ends()
    trial.stays_away(2.0)
    tracebacks = rig.log_since_calm.count("RuntimeError: planted")
    trial.check("the exception is logged once, with its traceback", tracebacks == 1, tracebacks)
    trial.check("and its node lives", rig.pid(TELEOP) is not None)
    trial.recovers()
    rig.hand.hide()
    rig.wait_for_modes("returning", "home")
    rig.end_program(node)


@row(40, "Control tick overrun", "", limits=ROBOT_BRAKES, hazards=(9,))
def tick_overrun(trial):
    """Each cycle of 10 ms takes 60 ms: the goals start from rest after each, so the arm all but stands."""
    rig = trial.rig
    trial.follow()
    before = rig.count("kuka_control", "goal_gaps")
    pid = rig.pid(CONTROLLER)
    began = trial.begins()
    while clock.monotonic() - began < 2.0:
        rig.kill(pid, signal.SIGSTOP)
        clock.sleep(0.06)
        rig.kill(pid, signal.SIGCONT)
        clock.sleep(0.012)
    trial.ends()
    ended = clock.monotonic()
    rig.wait(lambda: rig.count("kuka_control", "goal_gaps") > before + 10, "the late cycles to be counted")
    way = 1e-3 * sum(speed for when, *_, speed in list(rig.arm.steps) if began < when < ended)
    trial.check("the arm is slow meanwhile", way / (ended - began) < 0.06, f"{way:.3f} m, the hand: 0.12 m/s")
    trial.check("and follows again", moves(trial), rig.modes[-5:])


@row(41, "GC / swap / CPU starvation 300 ms", "H", within=0.7, limits=ROBOT_BRAKES,
     dangerous="nothing on the PC can act while the PC does not run", hazards=(9,))  # fmt: skip
def starvation(trial):
    rig = trial.rig
    trial.follow()
    # As long as the catalogue says: the arm may come to rest, and continues within its limits.
    trial.begins()
    pause(rig, CONTROLLER, 0.3)
    trial.ends()
    trial.check("the arm follows on after 0.3 s", moves(trial), rig.modes[-5:])
    trial.part("0.3 s", Expected("", 1.0, limits=ROBOT_BRAKES))
    # A processor that many share: the controller is late again and again.
    trial.begins()
    with rig.crowded(CONTROLLER):
        rig.watch(2.0)
    trial.ends()
    rig.watch(1.0)
    trial.part("a crowded processor", Expected("", 1.0, limits=ROBOT_BRAKES))
    if rig.mode != "servo":
        trial.recovers()
        trial.operator()
        trial.part("after it", Expected("", 1.0, limits=ROBOT_BRAKES))
        rig.hand.sway(1.0, right=0.06)
    # Longer: the robot's own controller is the watchdog, which holds where the goals end.
    moves(trial)
    trial.begins()
    pause(rig, CONTROLLER, 1.5)
    trial.ends()
    rig.watch(2.0)


DISK = """
set -e
mount -t tmpfs -o size=400k tmpfs {folder}
exec rosrun leap_rig record.py {folder}/run --reserve 65536
"""


@row(42, "Disk full while recording", "", named_by="No space left on device",
     real="the disk is one of the kernel's, mounted for it", hazards=(9,))  # fmt: skip
def disk_full(trial):
    rig = trial.rig
    trial.follow()
    trial.begins()
    with tempfile.TemporaryDirectory(prefix="full-disk-") as folder:
        alone = ["unshare", "-m"] if os.getuid() == 0 else ["unshare", "-rm"]
        recorder = rig.run_command(*alone, "bash", "-c", DISK.format(folder=folder))
        text = rig.finish(recorder, 30.0)
    for line in text.splitlines():
        rig.hear("record.py", line)
    trial.check("the recording ends with 1", recorder.returncode == 1, text)
    trial.check("and with what was recorded", "Recorded " in text, text)
    modes = {mode for when, mode, _ in rig.statuses if when > trial.begins()}
    trial.check("control was switched on", modes <= set(TO_DESIRED_TOOL), modes)
    trial.check("the arm follows on", moves(trial), rig.modes[-5:])
