"""Rows 57 to 63: the bounds of the workspace, the reach, singular poses, joint ranges and collisions. Rows without a
letter are no faults that stop the arm: it must continue, more slowly or elsewhere."""

from __future__ import annotations

import signal
import tempfile

import numpy as np
import rospy
import yaml

from campaign.judge import Limits
from campaign.trial import row
from common.frames import BASE
from common.poses import pose
from common.ros.conversions import stamped_pose
from common.rotations import rotation_about, rotation_angle
from kuka_control.limits.collision import CollisionGuard
from kuka_control.model.obstacles import obstacles_from
from kuka_control.model.rig import checked_rig
from kuka_msgs.msg import MoveGoal

AHEAD = np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0)
LEFT = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
"""The centre line of the parameters as shipped, and the horizontal direction to its left."""
RANGES = np.radians([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0])  # of the joints, either way, by the data sheet
HURRIES = Limits.of_the_drives()
"""Behind a quick hand the drives reach 14 rad/s^2 by themselves, for goals within 12: Limits.sustained_acceleration."""
BEYOND_M = 5e-3  # goals leave the workspace by 2 mm; the joints follow them with lags of their own
CORNERS = (
    ({"right": 0.42, "up": -0.3, "back": -0.15}, ("opening angle", "lower z limit", "outer sphere")),
    ({"right": -0.35, "up": 0.3, "back": 0.3}, ("opening angle", "upper z limit", "inner sphere")),
)
"""Hands that are beyond three bounds each, all six together."""
OUT_S = 2.2  # of a hand on its way out or back [s]
MEAN_S = 0.25


def outside(position: np.ndarray) -> float:
    """Returns by how much a tool position is outside of the workspace as shipped [m], 0 inside."""
    along, left, z = position @ AHEAD, position @ LEFT, position[2]
    r = np.linalg.norm(position - [0.0, 0.0, 0.34])
    beyond_plane = np.cos(np.radians(25.0)) * abs(left) - np.sin(np.radians(25.0)) * along
    return max(0.0, 0.2 - z, z - 0.6, 0.5 - r, r - 0.7, beyond_plane)


def off(trial) -> float:
    """Returns how far the tool is from where the hand wants it [m]."""
    return float(np.linalg.norm(trial.rig.arm.now.T_base_tool[:3, 3] - trial.rig.desired[-1][:3, 3]))


def mean_speed(samples) -> float:
    """Returns the largest speed of the tool over MEAN_S [m/s]: goals that a busy machine delays do not count."""
    t = np.array([sample.time for sample in samples])
    way = np.array([sample.T_base_tool[:3, 3] for sample in samples])
    later = np.column_stack([np.interp(t + MEAN_S, t, axis) for axis in way.T])
    return float(np.max(np.linalg.norm(later - way, axis=1)) / MEAN_S)


def comes_back(trial, **to: float) -> None:
    """Moves the hand back to the middle; the arm must follow it there, and not faster than the hand by much."""
    rig = trial.rig
    start, way = rig.arm.now.time, np.linalg.norm(rig.desired[-1][:3, 3] - rig.arm.now.T_base_tool[:3, 3])
    since = len(rig.desired)
    rig.hand.glide(OUT_S, **{"right": 0.0, "up": 0.0, "back": 0.0, **to})
    rig.settle()
    desired = np.array([T[:3, 3] for T in rig.desired[since:]])
    hand = 1.875 / OUT_S * float(np.linalg.norm(desired[-1] - desired[0]))
    fastest = mean_speed(rig.arm.since(start))
    trial.check("the tool is no faster than the hand", fastest < 1.15 * hand + 0.03, f"{fastest:.3f} of {hand:.3f} m/s")
    trial.check("the tool is where the hand is", off(trial) < 2e-3, f"{off(trial):.4f} m, after {way:.3f} m")


def turned(trial) -> float:
    """Returns by how much the tool is turned from what the hand asks for [rad]."""
    return rotation_angle(trial.rig.arm.now.T_base_tool[:3, :3].T @ trial.rig.desired[-1][:3, :3])


def stays_in_servo(trial) -> None:
    """Checks that the arm followed the hand all the time."""
    modes = {mode for when, mode, _ in trial.rig.statuses if when >= trial.begins()}
    trial.check("it follows all the time", modes == {"servo"}, modes)


@row(57, "Target outside workspace box", "", named_by="opening angle", limits=HURRIES,
     dangerous="the workspace keeps the tool away from what stands around the arm", hazards=(14,))  # fmt: skip
def outside_the_workspace(trial):
    rig = trial.rig
    trial.follow(sway=False)
    trial.begins()
    start, clips = rig.arm.now.time, rig.count("kuka_control", "workspace_clips")
    for corner, bounds in CORNERS:
        rig.hand.glide(OUT_S, **corner)
        for bound in bounds:
            rig.wait(lambda bound=bound: bound in rig.status.limited_by, f"the bound {bound}")
        rig.settle()
        trial.check("the hand is far out", outside(rig.desired[-1][:3, 3]) > 0.1)
        comes_back(trial)
    # Along a side plane.
    rig.hand.glide(1.0, right=0.35)
    rig.settle()
    height = rig.arm.now.T_base_tool[2, 3]
    rig.hand.glide(1.0, up=0.1)
    rig.settle()
    slid = rig.arm.now.T_base_tool[2, 3] - height
    trial.check("the tool slides along the bound", abs(slid - 0.1) < 5e-3, f"{slid:.3f} of 0.1 m")
    farthest = max(outside(sample.T_base_tool[:3, 3]) for sample in rig.arm.since(start))
    trial.check("the tool stays in the workspace", farthest < BEYOND_M, f"{1e3 * farthest:.1f} mm")
    aimed = max(outside(T[:3, 3]) for T in rig.commanded)
    trial.check("all goals are in the workspace", aimed < 1e-6, f"{1e3 * aimed:.3f} mm")
    trial.check("the robot never stops the arm", rig.arm.now.safety_stop is None, rig.arm.now.safety_stop)
    rig.wait(lambda: rig.count("kuka_control", "workspace_clips") >= clips + 3, "the clips to be counted")
    stays_in_servo(trial)


@row(58, "Box smaller than current pose / box edited live", "", argued="limits-at-the-start.md", hazards=(14,))
def workspace_changed(trial):
    rig = trial.rig
    low = {"z_upper_limit": 0.45}
    trial.follow(sway=False)
    rig.hand.glide(1.0, up=0.12)
    rig.settle()
    before, high = rig.arm.now.time, rig.arm.now.T_base_tool[2, 3]
    trial.check("the tool is above the new limit", high > 0.5, high)
    trial.begins()
    kept = rig.parameters(*low)
    rig.set(**low)
    try:
        # The values at the start count: nothing moves, and the hand leads on within the old bounds.
        rig.watch(1.5)
        trial.check("the arm stands when the limit is edited", rig.arm.way(before) < 2e-3, rig.arm.way(before))
        rig.hand.glide(1.0, up=0.05)
        rig.settle()
        trial.check("the arm follows on", off(trial) < 2e-3, off(trial))
        rig.hand.glide(1.0, up=0.12)
        rig.settle()
        # A controller that starts with the arm above the limit goes home, down all the way.
        rig.signal("kuka_real_time_node", signal.SIGKILL)
        trial.killed.add("/kuka_real_time_node")
        rig.hand.hide()
        rig.wait(lambda: rig.arm.now.speed == 0.0 and rig.pid("kuka_real_time_node") is None, "the arm to stand")
        again = rig.arm.now.time
    finally:
        rig.set(**kept)
    with trial.controller(**low):
        heights = [sample.T_base_tool[2, 3] for sample in rig.arm.since(again)]
        up = max(np.max(heights) - heights[0], 0.0)
        trial.check(
            "the tool never rises", heights[0] > 0.5 and up < 2e-3, f"by {1e3 * up:.1f} mm from {heights[0]:.3f} m"
        )
        assert rig.control(True).success
        rig.modes.clear()
        rig.bring_hand(up=0.09)
        rig.wait_for_modes("servo")
        within = rig.arm.now.time
        rig.hand.glide(1.0, up=0.3)
        rig.settle()
        highest = max(sample.T_base_tool[2, 3] for sample in rig.arm.since(within))
        trial.check("the tool stays in the smaller workspace", 0.44 < highest < 0.45 + BEYOND_M, f"{highest:.3f} m")


@row(59, "Target out of reach (elbow straight)", "", within=3.0, named_by="out of the arm's reach", hazards=(15,))
def out_of_reach(trial):
    rig = trial.rig
    trial.follow(sway=False)
    trial.begins()
    rig.hand.glide(OUT_S, right=0.0, up=0.3, back=-0.3)
    rig.wait(lambda: "reach" in rig.status.limited_by, "the end of the reach")
    rig.settle()
    stands = rig.arm.now.time
    rig.watch(2.0)
    trial.check("the arm does not shake", rig.arm.way(stands) < 1e-3, rig.arm.way(stands))
    tool = rig.arm.now.T_base_tool
    trial.check("the tool is as far as it may be", outside(tool[:3, 3]) < BEYOND_M and tool[2, 3] > 0.595, tool)
    comes_back(trial)
    trial.check("the orientation comes back", turned(trial) < np.radians(0.5), np.degrees(turned(trial)))
    stays_in_servo(trial)


BEFORE_SINGULAR = np.radians([-45.0, 10.0, 0.0, -115.0, 0.0, 15.0, 0.0])
AFTER_SINGULAR = np.radians([-37.0, 12.0, 0.0, -113.0, 0.0, -15.0, 0.0])


@row(60, "Near singularity", "", limits=HURRIES, hazards=(15,))
def near_singular(trial):
    rig = trial.rig
    trial.follow(sway=False)
    trial.begins()
    start = rig.arm.now.time
    rig.hand.glide(1.5, up=0.3, back=-0.1)
    rig.settle()
    rig.hand.sway(0.7, back=-0.35)
    rig.watch(5.0)
    elbow = min(abs(sample.q[3]) for sample in rig.arm.since(start))
    trial.check("the elbow is nearly straight", np.degrees(elbow) < 12.0, np.degrees(elbow))
    rig.hand.glide(0.01)
    comes_back(trial)
    stays_in_servo(trial)
    # A hand that dashes to and fro: the drives would be quicker than the goals may be.
    rig.hand.sway(0.35, right=0.16)
    rig.wait(lambda: {"arm speed", "frame rate"} & set(rig.status.limited_by), "a hand that is too fast", 5.0)
    dashes = rig.arm.now.time
    rig.watch(3.0)
    fastest = max(sample.tool_speed for sample in rig.arm.since(dashes))
    trial.check("the arm dashes with the hand", fastest > 0.4, f"{fastest:.2f} m/s")
    # A straight line for a program through a pose in which the axes of joints 5 and 7 are one.
    rig.hand.hide()
    rig.wait_for_modes("servo", "home")
    rig.wait(lambda: rig.stream_state == "waiting", "the end of the stream")
    there = rig.move(kind=MoveGoal.JOINTS, joints=BEFORE_SINGULAR.tolist(), velocity=0.25)
    begin, start = rig.arm.now.T_base_tool[:3, 3], rig.arm.now.time
    _, arm = checked_rig(rospy.get_param("kuka"), "kuka/")
    goal = stamped_pose(arm.kinematics.forward(AFTER_SINGULAR), BASE, rospy.Time())
    along = rig.move(kind=MoveGoal.POSE, pose=goal, straight=True, velocity=0.1)
    trial.check("a program can move the arm", there.success and along.success, (there.message, along.message))
    samples = rig.arm.since(start)
    wrist = min(abs(sample.q[5]) for sample in samples)
    trial.check("joint 6 is near zero", wrist < np.radians(3.0), np.degrees(wrist))
    way = samples[-1].T_base_tool[:3, 3] - begin
    beside = [np.linalg.norm(np.cross(s.T_base_tool[:3, 3] - begin, way)) / np.linalg.norm(way) for s in samples]
    trial.check("the tool stays on the line", max(beside) < 5e-3, max(beside))


@row(61, "Joint limit reached", "", hazards=(15,))
def joint_limit(trial):
    rig = trial.rig
    R_base_tool = rotation_about(2, np.radians(120.0)) @ np.diag([-1.0, 1.0, -1.0])  # joint 7 at -162 deg
    tool = pose(R_base_tool, (0.45, -0.40, 0.32))
    assert rig.control(True).success
    rig.wait(lambda: rig.hold_tool(tool, 60.0).success, "the hold", 10.0)
    rig.wait(lambda: rig.mode == "servo" and np.linalg.norm(rig.arm.now.T_base_tool[:3, 3] - tool[:3, 3]) < 2e-3,
             "the arm at the pose", 15.0)  # fmt: skip
    rig.hand.show()
    rig.wait(lambda: rig.stream_state == "running", "the hand that takes over")
    rig.settle()
    trial.begins()
    start = rig.arm.now.time
    rig.hand.glide(1.5, yaw=-30.0)
    rig.settle()
    at_limit = rig.arm.now.q
    trial.check("joint 7 is at its limit", at_limit[6] < np.radians(-169.0), np.degrees(at_limit[6]))
    rig.hand.glide(1.0, right=0.05)
    rig.settle()
    trial.check("the other joints go on", off(trial) < 2e-3, off(trial))
    trial.check("the tool is as the hand asks", turned(trial) < np.radians(0.5), np.degrees(turned(trial)))
    trial.check("the elbow gives way", abs(at_limit[2]) > np.radians(5.0), np.degrees(at_limit[2]))
    rig.hand.glide(1.5, yaw=0.0)
    rig.settle()
    trial.check(
        "joint 7 comes away from its limit", rig.arm.now.q[6] > at_limit[6] + np.radians(5.0), np.degrees(rig.arm.now.q)
    )
    beyond = max(np.max(np.abs(sample.q) - RANGES) for sample in rig.arm.since(start))
    trial.check("the joints stay in their ranges", beyond < 0.0, np.degrees(beyond))
    stays_in_servo(trial)


AROUND = {
    "wall": {"kind": "box", "position": [*(0.6 * AHEAD - 0.25 * LEFT)[:2], 0.3], "rpy": [0, 0, -45],
             "size": [0.5, 0.04, 0.6]},
    "shelf": {"kind": "box", "position": [*(0.6 * AHEAD)[:2], 0.16], "rpy": [0, 0, -45], "size": [0.3, 0.3, 0.04]},
}  # fmt: skip
"""A wall to the right of the tool and a shelf below it, both within the workspace."""
INTO_ITSELF = np.radians([-45.0, 10.0, 0.0, -119.0, 0.0, 115.0, 0.0])  # a finger would hit link 2
SLACK_M = 2e-3  # measured joints may be within the margin by this: drives follow their goals unevenly


@row(62, "Self-collision / table / hand mount predicted", "H", within=6.0, named_by="collision guard",
     dangerous="the arm would break what stands around it, or itself", hazards=(16,))  # fmt: skip
def collision(trial):
    # It rests late: it slides along the wall until it is as near to the hand as it may be.
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        yaml.safe_dump(
            {name: {k: np.array(v).tolist() for k, v in body.items()} for name, body in AROUND.items()}, file
        )
        file.flush()
        with trial.controller(guard_obstacles=file.name):
            _press_against(trial)


def _press_against(trial) -> None:
    rig, (config, arm) = trial.rig, checked_rig(rospy.get_param("kuka"), "kuka/")
    guard = CollisionGuard(arm.kinematics, False, obstacles_from(AROUND, arm.model.wrist_flange), config.guard_margin)
    rig.modes.clear()
    trial.follow(sway=False)
    rig.hand.glide(0.5, right=0.0)
    rig.settle()
    for number, (out, name) in enumerate((({"right": 0.3}, "wall"), ({"up": -0.22}, "shelf"))):
        start = rig.arm.now.time
        trial.begins()
        rig.hand.glide(1.2, **out)
        rig.wait(lambda: "collision guard" in rig.status.limited_by, "the guard")
        rig.settle()
        if not number:
            trial.ends()
        trial.check(f"the hand is beyond the {name}", off(trial) > 0.02, off(trial))
        near = min((guard.nearest_at(s.q.tolist()) for s in rig.arm.since(start)[::4]), key=lambda pair: pair.distance)
        trial.check(f"the {name} is what is met", near.pair[1] == name, near)
        trial.check("it keeps its distance", near.distance > config.guard_margin - SLACK_M, near)
        comes_back(trial)
    stays_in_servo(trial)
    # A motion for a program into its own links.
    rig.hand.hide()
    rig.wait_for_modes("servo", "home")
    start = rig.arm.now.time
    result = rig.move(kind=MoveGoal.JOINTS, joints=INTO_ITSELF.tolist())
    trial.check("the arm does not run into itself", not result.success and "finger" in result.message, result.message)
    trial.check("the arm stands", rig.arm.way(start) < 1e-3, rig.arm.way(start))


@row(63, "IK fails or flips branch", "H", within=4.0, named_by="The arm keeps its joints", hazards=(15,))
def no_solution(trial):
    rig = trial.rig
    trial.follow(sway=False)
    rig.hand.glide(1.5, right=0.3, up=0.2, back=-0.05)
    rig.settle()
    failures = rig.count("kuka_control", "ik_failures")
    branch = np.sign(rig.arm.now.q[[1, 3, 5]])
    trial.begins()
    start = rig.arm.now.time
    rig.hand.glide(1.0, yaw=-30.0, pitch=-30.0, roll=-30.0)
    rig.wait(lambda: rig.count("kuka_control", "ik_failures") > failures, "a pose without joints", 10.0)
    rig.settle()
    held = rig.arm.now.time
    rig.hand.glide(0.5, up=0.3)
    rig.settle()
    trial.check("the arm holds", rig.arm.way(held) < 5e-3, rig.arm.way(held))
    trial.ends()
    comes_back(trial, yaw=0.0, pitch=0.0, roll=0.0)
    trial.check("the tool is as the hand asks", turned(trial) < np.radians(0.5), np.degrees(turned(trial)))
    branches = {tuple(np.sign(sample.q[[1, 3, 5]])) for sample in rig.arm.since(start)}
    trial.check("the arm stays folded as it was", branches == {tuple(branch)}, branches)
    stays_in_servo(trial)
