"""Rows 22 to 32, 82 and 83: orientations, the tf chain to the desired tool frame, stamps and clocks."""

from __future__ import annotations

import math
import signal
from dataclasses import replace

import numpy as np
import rospy
from tf2_msgs.msg import TFMessage

from campaign import hostile
from campaign.hostile import MOUNT, Frame, FrameStream, about, swaying, turning
from campaign.judge import Limits
from campaign.rig import CONTROLLER, DRIVER, TELEOP
from campaign.trial import SHIFTED, SIMULATED, row
from common import clock
from common.frames import BASE, FLANGE_MEASURED
from common.poses import inverse, pose, translation
from common.ros.conversions import pose_from_transform, stamped_pose
from common.rotations import rotation_angle, zyx_from_rotation

UP = np.array([0.0, 0.0, 1.0])
SWAY = (0.0, 0.0, 0.08)  # of the desired tool [m]
T_BASE_MOUNT = translation(0.2, -0.1, 0.1)
OFF_RAD = math.radians(8.0)  # an arm that follows a turn is off it by less than 2 deg
NO_SPIN = replace(Limits(), joint_speed=0.6)  # a joint that turns around for a wrapped angle is at its limit, 0.9


def follow_frames(trial, stream):
    """Lets the arm follow a stream of desired tool frames that begins while control is on."""
    rig = trial.rig
    if not stream.silent:
        stream.silent = True
        rig.watch(1.0)
    assert rig.control(True).success
    stream.silent = False
    rig.wait_for_mode("servo")
    rig.watch(0.5)
    rig.modes.clear()


def followed(trial, what):
    """Notes whether the arm has followed all the time since `rig.modes` was cleared."""
    rig = trial.rig
    trial.check(what, {rig.mode, *rig.modes} == {"servo"}, f"{rig.modes}; {rig.status.reason}")


def error_of(trial, T):
    """Returns how far the tool's orientation is from that of a pose [deg]."""
    return math.degrees(rotation_angle(trial.rig.arm.now.T_base_tool[:3, :3].T @ T[:3, :3]))


def off_the_turn(R, R_start, axis, least, most):
    """Returns how far an orientation R is from a turn by `least` to `most` about an axis of the base that begins at
    R_start, shapes (3, 3) and (3,), and where on the turn it is nearest, both in rad."""
    R_turned = R @ R_start.T
    sine = axis @ (R_turned[[2, 0, 1], [1, 2, 0]] - R_turned[[1, 2, 0], [2, 0, 1]])
    turn = min(max(math.atan2(sine, np.trace(R_turned) - axis @ R_turned @ axis), least), most)
    return rotation_angle(about(axis, turn).T @ R_turned), turn


def stays_on_the_turn(trial, what, T_start, axis, least, most, since):
    """Notes whether the tool has made at least half of a turn since a time of the arm's clock, and has not left it. An
    angle that wraps on the way sends it elsewhere for a moment, from where a pick-up motion may bring it back."""
    seen = [
        off_the_turn(sample.T_base_tool[:3, :3], T_start[:3, :3], axis, least, most)
        for sample in trial.rig.arm.since(since)
    ]
    off, turns = zip(*seen)
    trial.check(f"the tool stays on the turn: {what}", max(off) < OFF_RAD, f"off by {math.degrees(max(off)):.1f} deg")
    way = max(turns) - min(turns)
    trial.check(f"the tool turns: {what}", way > 0.5 * (most - least), f"only by {math.degrees(way):.1f} deg")


@row(22, "Angle wrap at +-pi (A/B/C Euler)", "", limits=NO_SPIN, hazards=(11,))
def wrap(trial):
    rig, T_home = trial.rig, trial.rig.arm.now.T_base_tool
    turn = turning(T_home, UP, math.radians(90.0), 8.0)
    T_rolled = pose(about(T_home[:3, 0], math.radians(-20.0)) @ T_home[:3, :3], T_home[:3, 3])
    roll = turning(T_rolled, T_home[:3, 0], math.radians(40.0), 5.0)
    sign = [1.0]

    def flipped(t):
        frame = Frame(turn(t)).message.transform
        sign[0] = -sign[0]
        p, q = frame.translation, frame.rotation
        return [Frame((p.x, p.y, p.z, *(sign[0] * x for x in (q.x, q.y, q.z, q.w))))]

    with FrameStream(lambda t: [Frame(turn(t))], silent=True) as stream:
        follow_frames(trial, stream)
        trial.begins()
        since = rig.arm.now.time
        rig.watch(8.0)
        followed(trial, "the arm follows A over 180 deg and back")
        angles = [zyx_from_rotation(sample.T_base_tool[:3, :3]) for sample in rig.arm.since(since)]
        turned = [math.degrees(a) % 360.0 for a, _, _ in angles]
        trial.check("A passes 180 deg", min(turned) < 170.0 and max(turned) > 190.0, f"{min(turned)} to {max(turned)}")
        stream.path = flipped
        rig.watch(4.0)
        followed(trial, "the arm follows quaternions whose sign changes with each frame")
        stays_on_the_turn(trial, "A", T_home, UP, 0.0, math.radians(90.0), since)
    trial.operator()
    rig.wait_for_mode("home")
    with FrameStream(lambda t: [Frame(roll(t))], silent=True) as stream:
        follow_frames(trial, stream)
        since = rig.arm.now.time
        rig.watch(5.0)
        stays_on_the_turn(trial, "C", T_rolled, T_home[:3, 0], 0.0, math.radians(40.0), since)
        angles = [zyx_from_rotation(sample.T_base_tool[:3, :3]) for sample in rig.arm.since(since)]
        turned = [math.degrees(c) % 360.0 for _, _, c in angles]
        trial.check("C passes 180 deg", min(turned) < 170.0 and max(turned) > 190.0, f"{min(turned)} to {max(turned)}")
        followed(trial, "the arm follows C over 180 deg and back")
    rig.wait_for_mode("home")
    rig.follow(yaw=165.0)  # of somebody who stands on the other side
    rig.modes.clear()
    since, T_start = rig.arm.now.time, rig.arm.now.T_base_tool
    rig.hand.sway(1.5, yaw=195.0)
    rig.watch(4.0)
    stays_on_the_turn(trial, "the hand", T_start, UP, math.radians(-30.0), 0.0, since)
    followed(trial, "the arm follows a hand that turns over 180 deg and back")


@row(23, "Euler singularity B = +-90 deg", "", limits=NO_SPIN, hazards=(11,))
def singularity(trial):
    """The round trip within 1e-9 is test_codec.py::test_poses_survive_the_wire_units_even_at_the_euler_singularity."""
    rig, T_home = trial.rig, trial.rig.arm.now.T_base_tool
    radial = T_home[:3, 0]
    T_start = pose(about(UP, math.pi / 2.0) @ T_home[:3, :3], T_home[:3, 3])
    trial.begins()
    for sign in (1.0, -1.0):
        path = turning(T_start, radial, sign * math.radians(110.0), 8.0)
        with FrameStream(lambda _: [Frame(T_start)], silent=True) as stream:
            follow_frames(trial, stream)
            rig.wait(lambda: error_of(trial, T_start) < 1.0, "the tool with its x axis to the side", 10.0)
            begin = []

            def passes(t, begin=begin, path=path):
                begin[:] = begin or [t]
                return [Frame(path(t - begin[0]))]

            before = pose_b(rig.arm.now.T_base_tool)
            since = rig.arm.now.time
            stream.path = passes
            rig.watch(8.0)
            steepest = max(abs(pose_b(sample.T_base_tool) - before) for sample in rig.arm.since(since))
            trial.check("the tool passes B = 90 deg", steepest > math.radians(87.0), f"{math.degrees(steepest):.1f}")
            followed(trial, "the arm follows through it and back")
        rig.control(False)
        rig.wait_for_mode("home")
    steep = pose(about(radial, math.pi / 2.0) @ T_start[:3, :3], T_start[:3, 3])
    rig.control(True)
    goal = rig.move(kind=1, pose=stamped_pose(steep, BASE, rospy.Time.now()))
    trial.check("a program moves the tool to B = 90 deg", goal.success, goal.message)
    rig.watch(0.5)
    measured, true = measured_flange(rig), rig.arm.now.T_base_tool @ translation(0.0, 0.0, -0.106)
    error = float(np.max(np.abs(measured - true)))
    trial.check("the pose that the robot reports there is the true one", error < 1e-4, f"{error:.2g}")
    rig.control(False)


def measured_flange(rig):
    """Returns the newest pose of the flange in the base on tf, shape (4, 4)."""
    heard = []

    def take(message):
        heard.extend(t for t in message.transforms if t.child_frame_id == FLANGE_MEASURED)

    subscriber = rospy.Subscriber("/tf", TFMessage, take)
    rig.wait(lambda: heard, "the measured flange")
    subscriber.unregister()
    return pose_from_transform(heard[-1].transform)


def pose_b(T):
    """Returns the angle B of a pose [rad]."""
    return math.asin(max(-1.0, min(1.0, -T[2, 0])))


@row(
    24,
    "tf frame missing at start",
    "R",
    within=2.0,
    named_by="nobody publishes where that is",
    still=True,
    hazards=(10,),
)
def missing(trial):
    rig, T_home = trial.rig, trial.rig.arm.now.T_base_tool
    path = swaying(inverse(T_BASE_MOUNT) @ T_home, SWAY, 3.0)
    assert rig.control(True).success
    with FrameStream(lambda t: [Frame(path(t), MOUNT)]) as stream:
        trial.begins()
        rig.watch(3.0)
        reported = [text for _, who, text in list(rig.said) if who == "rosout" and "nobody publishes where" in text]
        trial.check("it is said once, not with each frame", 1 <= len(reported) <= 3, str(len(reported)))
        rig.control(False)
        trial.operator()
        stream.path = lambda t: [Frame(T_BASE_MOUNT, child=MOUNT), Frame(path(t), MOUNT)]
        follow_frames(trial, stream)


@row(25, "tf stale (publisher died)", "HD", within=2.0, operator=True,
     dangerous="a chain of frames looks whole while one of them is of the past", hazards=(10,))  # fmt: skip
def stale(trial):
    rig, T_home = trial.rig, trial.rig.arm.now.T_base_tool
    path = swaying(inverse(T_BASE_MOUNT) @ T_home, SWAY, 3.0)
    with hostile.mount(trial, *T_BASE_MOUNT[:3, 3]) as process, FrameStream(
        lambda t: [Frame(path(t), MOUNT)], silent=True
    ) as stream:
        process.send_signal(signal.SIGUSR1)
        rig.watch(1.0)  # with the mount, a desired frame of an earlier row is whole again, and refused for its age
        follow_frames(trial, stream)
        rig.wait(lambda: rig.arm.now.tool_speed > 0.05, "the arm to move")
        trial.begins()
        process.send_signal(signal.SIGKILL)
        rig.watch(4.0)


@row(26, "tf jump (re-calibration while running)", "DL", within=1.0, named_by="jumped by", operator=True,
     dangerous="the tool would leap to where the new calibration says it should be", hazards=(10,))  # fmt: skip
def jump(trial):
    rig, T_home = trial.rig, trial.rig.arm.now.T_base_tool
    path = swaying(inverse(T_BASE_MOUNT) @ T_home, SWAY, 3.0)
    mounts = [T_BASE_MOUNT]

    def frames(t):
        return [Frame(mounts[-1], child=MOUNT), Frame(path(t), MOUNT)]

    with FrameStream(frames, silent=True) as stream:
        follow_frames(trial, stream)
        trial.begins()
        mounts.append(translation(0.05, 0.05, 0.0) @ T_BASE_MOUNT)
        rig.watch(3.0)
        trial.operator()
        rig.control(False)
        assert rig.control(True).success
        rig.wait_for_mode("home")
        path = lambda _: inverse(T_BASE_MOUNT) @ T_home  # noqa: E731 - it rests now
        follow_frames(trial, stream)
        goal = (T_home[:3, 3] + (0.05, 0.05, 0.0)).round(3)
        rig.wait(lambda: np.allclose(rig.arm.now.T_base_tool[:3, 3], goal, atol=5e-3), "the tool at the new place", 8.0)


@row(27, "Two publishers of the same frame", "L", within=1.0, named_by="both publish", operator=True,
     dangerous="the desired tool alternates between two places at the rate of the frames", hazards=(10,))  # fmt: skip
def two_publishers(trial):
    rig, T_home = trial.rig, trial.rig.arm.now.T_base_tool
    path = swaying(inverse(T_BASE_MOUNT) @ T_home, SWAY, 3.0)
    other = (T_BASE_MOUNT[:3, 3] + (0.05, 0.0, 0.0)).tolist()
    with FrameStream(lambda t: [Frame(T_BASE_MOUNT, child=MOUNT), Frame(path(t), MOUNT)], silent=True) as stream:
        with hostile.mount(trial, *other, name="campaign_second") as second:
            follow_frames(trial, stream)
            rig.wait(lambda: rig.arm.now.tool_speed > 0.05, "the arm to move")
            trial.begins()
            second.send_signal(signal.SIGUSR1)
            trial.says("both publish")
            both = next(text for _, _, text in list(rig.said) if "both publish" in text)
            names = "/campaign_second", rospy.get_name()
            trial.check("both are named", all(name in both for name in names), both)
            rig.watch(2.0)
        rig.watch(2.0)


@row(28, "tf extrapolation into the future", "H", within=1.0, named_by="whose newest transform is", hazards=(10,))
def extrapolation(trial):
    rig, T_home = trial.rig, trial.rig.arm.now.T_base_tool
    path = swaying(inverse(T_BASE_MOUNT) @ T_home, SWAY, 3.0)
    late = [0.0]

    def frames(t):
        found = [Frame(path(t), MOUNT)]
        return found if late[0] is None else [Frame(T_BASE_MOUNT, child=MOUNT, ahead=-late[0]), *found]

    with FrameStream(frames, silent=True) as stream:
        follow_frames(trial, stream)
        late[0] = 0.1
        rig.watch(3.0)
        followed(trial, "the arm follows where a frame of the chain is 0.1 s older")
        rig.wait(lambda: rig.arm.now.tool_speed > 0.05, "the arm to move")
        trial.begins()
        late[0] = None
        rig.wait_for_mode("home")  # after time_out; it stays there until the fault has ended
        rig.watch(0.3)
        trial.ends()
        late[0] = 0.0
        rig.watch(2.0)
        trial.check(
            "the arm follows again, or goes home", rig.mode in ("servo", "returning", "home", "pick_up"), rig.mode
        )


@row(29, "Stamps in the future / past by > 0.5 s (clock skew)", "R", within=1.0, still=True, variant=SHIFTED,
     named_by="its stamp is [0-9.]+ s (ahead|behind)", hazards=(10,))  # fmt: skip
def skew(trial):
    rig, T_home = trial.rig, trial.rig.arm.now.T_base_tool
    T = translation(0.0, 0.0, 0.05) @ T_home
    assert rig.control(True).success
    trial.begins()
    hostile.attack(trial, [
        hostile.by_frames(
            f"a desired tool stamped {ahead:+g} s", rf"its stamp is {abs(ahead) - 0.05:.1f}\d* s .*{side}|"
            rf"its stamp is {abs(ahead):.1f}\d* s .*{side}", Frame(T, ahead=ahead),
        )
        for ahead, side in ((2.0, "ahead of"), (-2.0, "behind"), (0.7, "ahead of"), (-0.7, "behind"))
    ])  # fmt: skip
    trial.check("the controller stays at home", rig.mode == "home", rig.mode)
    rig.control(False)
    trial.operator()
    path = swaying(T_home, SWAY, 3.0)
    rig.watch(1.0)  # the frames so far are another stream
    assert rig.control(True).success
    with FrameStream(lambda t: [Frame(path(t), ahead=-1.0)]):  # a backlog, as of a queue that is never empty
        rig.watch(5.0)
        trial.check("frames that are steadily late are not followed", rig.mode == "home", rig.mode)
        trial.check("that they are late is said", "runs on this machine" in rig.status.reason, rig.status.reason)
    rig.control(False)
    rig.watch(1.5)  # so long this program counts as a second publisher
    trial.follow()
    for seconds in (5.0, -5.0):  # the clock of the tracker's machine
        rig.listen_anew()
        rig.clock.step(seconds, DRIVER)
        trial.says(f"stamps of the tracking frames are .* s {'in the future' if seconds > 0.0 else 'old'}")
        rig.wait(lambda: rig.mode not in ("pick_up", "servo"), "the end of servo mode", 5.0)
        rig.clock.step(-seconds, DRIVER)
        rig.watch(0.5)
        trial.check("a hand that is still there does not engage", rig.mode not in ("pick_up", "servo"), rig.mode)
        trial.recovers()


@row(30, "ROS time goes backwards (bag loop)", "DL", within=1.0, named_by="went back by", operator=True,
     variant=SIMULATED, hazards=(10,))  # fmt: skip
def backwards(trial):
    trial.follow()
    trial.begins()
    trial.rig.clock.step(-5.0)
    trial.stays_away(3.0)
    trial.recovers()
    counted = trial.rig.count("leap_kuka", "frames")
    trial.rig.wait(lambda: trial.rig.count("leap_kuka", "frames") > counted, "diagnostics of the time after", 5.0)


@row(31, "Wall clock stepped by NTP", "", variant=SHIFTED, hazards=(10,))
def stepped(trial):
    rig = trial.rig
    trial.follow()
    trial.begins()
    rig.modes.clear()
    states = len(rig.stream)
    for seconds in [3.0, -3.0] * 10 + [3600.0, -3600.0]:  # a frame is on its way at some of these moments
        rig.clock.step(seconds)
        rig.watch(0.25)
    followed(trial, "the arm follows over all steps")
    # A small step forwards looks as if frames were lost on their way: the arm brakes, and goes home if it is longer
    # than the time-out; it comes back to the hand by planned motions.
    for seconds in (0.3, -0.3) * 2:
        rig.clock.step(seconds)
        rig.watch(0.5)
    rig.wait_for_mode("servo")
    trial.check("the arm stays with the hand over small steps", "stopped" not in rig.modes, rig.modes)
    left = [why for state, why in rig.stream[states:] if state != "running"]
    trial.check("the stream of the hand runs on", not left, left)


@row(32, "use_sim_time true and no /clock", "R", within=15.0, named_by="nobody publishes /clock", still=True,
     variant=SIMULATED, hazards=(10,))  # fmt: skip
def no_clock(trial):
    rig, nodes = trial.rig, (CONTROLLER, TELEOP, DRIVER)
    rig.clock.pause(True)
    trial.begins()
    assert rig.control(True).success
    rig.hand.show(right=-0.04)
    rig.watch(3.0)
    trial.check("nothing engages while the time stands", rig.mode == "home", rig.mode)
    trial.says("ROS time has stood still", 1.0)
    rig.hand.hide()
    for node in nodes:
        trial.signal(node, signal.SIGTERM)
    rig.wait(lambda: not any(rig.pid(node) for node in nodes), "the end of the nodes", 15.0)
    for node in nodes:
        rig.start(node)
    for node in nodes:
        trial.check(f"{node} ends with a fault", rig.exit_code(node) == 1)
    reported = rig.log.count("use_sim_time is true, but nobody publishes /clock")
    trial.check("each says why", reported >= len(nodes), str(reported))
    trial.operator()
    rig.clock.pause(False)
    for node in nodes:
        rig.start(node)
    rig.wait(lambda: rig.mode == "home", "the controller at home", 40.0)
    trial.follow()


def pick_ups(rig):
    """Returns how often the arm went somewhere since `rig.modes` was cleared, and how often home."""
    return rig.modes.count("pick_up"), rig.modes.count("returning")


@row(82, "Frames slower than the time-out, or interrupted", "R", within=1.0,
     named_by="comes only every 0.25 s, but time_out is 0.2 s",
     dangerous="the arm would go there and back for ever, by motions that the PC cannot stop",
     hazards=(4,))  # fmt: skip
def slow_frames(trial):
    rig, T = trial.rig, translation(0.0, 0.0, 0.05) @ trial.rig.arm.now.T_base_tool
    assert rig.control(True).success
    trial.begins()
    with FrameStream(lambda t: [Frame(T)], rate=4.0):
        rig.modes.clear()
        rig.watch(6.0)
        trial.check("four frames a second move nothing", rig.mode == "home" and not rig.modes, str(rig.modes))
    trial.ends()
    with FrameStream(lambda t: [Frame(T)] if t % 1.0 < 0.4 else []):
        rig.modes.clear()
        rig.watch(10.0)
        went, returned = pick_ups(rig)
        trial.check("bursts are followed once in 10 s", 1 <= went <= 2 and returned <= 2, str(rig.modes))
        trial.says("asked for only after 10 s: it waits")


@row(
    83,
    "Frames come already when control is switched on",
    "",
    dangerous="the arm moves as soon as control is switched on",
    hazards=(1,),
)
def early_frames(trial):
    rig, T_home = trial.rig, trial.rig.arm.now.T_base_tool
    far, near = (translation(0.0, 0.0, z) @ T_home for z in (-0.35, 0.1))
    place = [far]
    with FrameStream(lambda t: [Frame(place[0])]) as stream:
        rig.watch(1.0)
        answer = rig.control(True)
        trial.check("the answer says that far ones are not followed", "350 mm" in answer.message, answer.message)
        rig.watch(2.0)
        trial.check("far ones are not", rig.mode == "home", rig.mode)
        place[0] = near
        rig.watch(2.0)
        trial.check("nor when they come nearer by themselves", rig.mode == "home", rig.mode)
        rig.control(False)
        rig.watch(1.0)
        answer, begun = rig.control(True), clock.monotonic()
        trial.check("the answer says that near ones are", "goes there slowly" in answer.message, answer.message)
        trial.begins()
        rig.wait_for_mode("pick_up")
        trial.check("after it was announced", clock.monotonic() - begun > 0.9, f"{clock.monotonic() - begun:.2f} s")
        rig.wait_for_mode("servo")
        trial.check("slowly", rig.arm.now.tool_speed < 0.2, f"{rig.arm.now.tool_speed:.2f} m/s")
        trial.ends()
        stream.silent = True
        rig.wait_for_mode("home")
