"""Rows 18 to 21: bad values, on every wire of the rig, while the arm is at home and while it follows a hand."""

from __future__ import annotations

import math
import signal

import numpy as np

from campaign import hostile
from campaign.hostile import Frame, by_frames, by_message, by_service, pose_of
from campaign.rig import CONTROLLER
from campaign.trial import row
from kuka_msgs.srv import setPayload, setScalingFactor
from leap_motion.msg import Human
from reflex_msgs.msg import RadianServoCommands
from rig_msgs.srv import CheckToolPose, HoldTool

NAN, INF = math.nan, math.inf
DOWN = (-math.sin(math.pi / 8.0), math.cos(math.pi / 8.0), 0.0, 0.0)  # the tool as at home: z down
HOME = (0.42, -0.42, 0.45)
HUGE = 1e9


def hand_at(x: float, y: float, z: float, **fields: float) -> Human:
    """Returns a message of the tracker's topic with a right hand there [m]."""
    human = Human(lmc_frame_id=1, nr_of_hands=1)
    hand = human.right_hand
    hand.is_present, hand.lmc_hand_id, hand.confidence = True, 1, 0.9
    hand.palm_center.x, hand.palm_center.y, hand.palm_center.z = x, y, z
    hand.direction.z, hand.normal.y = -1.0, -1.0
    for name, value in fields.items():
        setattr(hand.direction, name, value)
    return human


@row(18, "NaN or infinity in any input", "R", within=2.0, named_by="finite", still=True,
     dangerous="a number that compares as neither too large nor too small passes every limit",
     hazards=(11,))  # fmt: skip
def not_finite(trial):
    hostile.at_home_and_while_following(trial, [
        by_frames("a desired tool at NaN", "not finite", Frame((NAN, *HOME[1:], *DOWN))),
        by_frames("a desired tool at infinity", "not finite", Frame((*HOME[:2], INF, *DOWN))),
        by_frames("a desired tool turned by NaN", "not finite", Frame((*HOME, NAN, 0.0, 0.0, 1.0))),
        by_frames(
            "a frame before the desired tool at NaN", "not finite|nobody publishes where",
            Frame((NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), child=hostile.MOUNT), Frame((*HOME, *DOWN), hostile.MOUNT),
        ),
        by_service("kuka/check_tool_pose", CheckToolPose, "not finite", pose_of(NAN, *HOME[1:], *DOWN)),
        by_service("leap_kuka/hold_tool", HoldTool, "finite numbers", pose_of(*HOME, NAN, *DOWN[1:]), 10.0),
        by_service("leap_kuka/hold_tool", HoldTool, "duration is nan", pose_of(*HOME, *DOWN), NAN),
        by_service("kuka/scaling_factor", setScalingFactor, "scaling factor", NAN),
        by_service("kuka/set_payload", setPayload, "payload", NAN),
        by_message("leap_motion/leap_device", "", hand_at(NAN, 0.3, 0.0), "a palm at NaN", following=False),
        by_message("reflex_takktile/radian_hand_command", "finite", RadianServoCommands([NAN] * 4), "NaN"),
        hostile.Attack("NaN from the tracker's service", garbled, "The text|The field"),
    ])  # fmt: skip
    hostile.counted(trial, "kuka_control", "refused_frames")
    hostile.counted(trial, "leap_kuka", "samples_left_out")
    hostile.counted(trial, "leap_motion", "dropped: The text holds the number NaN.")


def garbled(trial) -> None:
    """Lets two in ten frames of the tracker be broken, one way of which is NaN, or all at home."""
    following = trial.rig.mode == "servo"
    trial.rig.leap.ask("fault", name="garbled", value=0.2 if following else 1.0, duration=1.5)
    trial.rig.watch(1.6)


@row(19, "Huge but finite value (1e9, mm vs m mix-up)", "R", within=2.0, named_by="metres|millimetres|outside",
     still=True, hazards=(11,))  # fmt: skip
def huge(trial):
    millimetres = tuple(1e3 * x for x in HOME)
    hostile.at_home_and_while_following(trial, [
        by_frames("a desired tool in millimetres", "is it in metres", Frame((*millimetres, *DOWN))),
        by_frames("a desired tool at 1e9", "is it in metres", Frame((HUGE, *HOME[1:], *DOWN))),
        by_frames("a desired tool at 1e300", "is it in metres|finite", Frame((1e300, 1e300, 1e300, *DOWN))),
        by_service("kuka/check_tool_pose", CheckToolPose, "is it in metres", pose_of(*millimetres, *DOWN)),
        by_service("leap_kuka/hold_tool", HoldTool, "is it in metres", pose_of(*millimetres, *DOWN), 10.0),
        by_service("leap_kuka/hold_tool", HoldTool, "duration", pose_of(*HOME, *DOWN), HUGE),
        by_service("kuka/scaling_factor", setScalingFactor, "scaling factor", HUGE),
        by_service("kuka/set_payload", setPayload, "outside 0 to 5 kg", HUGE),
        by_message("leap_motion/leap_device", "", hand_at(0.0, HUGE, 0.0), "a palm at 1e9", following=False),
        hostile.Attack("a tracker in another unit", scaled, "not millimetres", following=False),
    ])  # fmt: skip


def scaled(trial) -> None:
    """Shows a hand of a tracker that measures in another unit."""
    trial.rig.leap.ask("fault", name="scaled", value=1000.0)
    trial.rig.hand.show(right=0.0)
    trial.rig.watch(2.0)
    trial.rig.hand.hide()
    trial.rig.watch(0.5)
    trial.rig.leap.ask("fault", name="scaled", on=False)


@row(20, "Quaternion not unit / zero", "R", within=2.0, named_by="instead of 1", still=True, hazards=(11,))
def quaternions(trial):
    zero, long, half = (0.0,) * 4, tuple(1.5 * x for x in DOWN), tuple(0.998 * x for x in DOWN)
    attacks = [
        by_frames(f"a desired tool whose quaternion {what}", "norm .* instead of 1", Frame((*HOME, *q)))
        for what, q in (("is zero", zero), ("is too long", long), ("is 0.2 % too short", half))
    ]
    attacks += [
        by_frames(
            "a frame before the desired tool with a zero quaternion", "norm .* instead of 1|nobody publishes where",
            Frame((0.0, 0.0, 0.0, *zero), child=hostile.MOUNT), Frame((*HOME, *DOWN), hostile.MOUNT),
        ),
        by_service("kuka/check_tool_pose", CheckToolPose, "norm 0 instead of 1", pose_of(*HOME, *zero)),
        by_service("leap_kuka/hold_tool", HoldTool, "norm 1.5 instead of 1", pose_of(*HOME, *long), 10.0),
    ]  # fmt: skip
    hostile.at_home_and_while_following(trial, attacks)
    almost = trial.rig.call("kuka/check_tool_pose", CheckToolPose, pose_of(*HOME, *(0.9995 * np.array(DOWN))))
    trial.check("a quaternion within 1e-3 is normalised", almost.success, almost.message)


@row(21, "Non-rigid matrix (scale, mirror)", "R", within=4.0, named_by="mirrored", still=True, hazards=(11,))
def not_rigid(trial):
    """Matrices come as axes of the tracker, and as the tool's pose with the controller's parameters."""
    rig = trial.rig
    assert rig.control(True).success
    trial.begins()
    rig.leap.ask("fault", name="mirrored")
    rig.hand.show(right=-0.04)
    trial.says("axes are mirrored")
    rig.watch(1.5)
    trial.check("a mirrored hand does not engage", rig.mode == "home", rig.mode)
    rig.hand.hide()
    rig.control(False)
    trial.signal(CONTROLLER, signal.SIGTERM)
    rig.wait(lambda: rig.pid(CONTROLLER) is None, "the end of the controller", 15.0)
    for what, axes, fault in (
        ("scaled", (1.1, 1.1, 1.1), "not orthonormal"),
        ("mirrored", (1.0, -1.0, 1.0), "a reflection, not a rotation"),
    ):
        T = np.diag((*axes, 1.0))
        T[2, 3] = 0.106
        rig.start(CONTROLLER, use_tool_transform=True, tool_transform=T.ravel().tolist())
        trial.check(f"the controller does not start with a {what} tool", rig.exit_code(CONTROLLER) == 1)
        reported = [line for line in rig.log.splitlines() if "tool_transform is not a pose" in line and fault in line]
        trial.check(f"it says why, with a {what} tool", bool(reported), rig.log[-300:])
    trial.operator()
    rig.leap.ask("fault", name="mirrored", on=False)
    rig.start(CONTROLLER, use_tool_transform=False)
    rig.wait(lambda: rig.mode == "home", "the controller at home", 40.0)
    trial.follow()
    rig.leap.ask("fault", name="mirrored")
    rig.wait(lambda: rig.mode not in ("pick_up", "servo"), "the arm to leave a hand that is mirrored", 5.0)
