"""Rows 64 to 66 and 81: motions for programs, and point-to-point motions that do not end as they should."""

from __future__ import annotations

import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus

from campaign.rig import PATIENCE_S
from campaign.trial import row
from common import clock
from common.frames import BASE
from common.ros.conversions import stamped_pose
from kuka_msgs.msg import MoveGoal
from rig_simulation.control_port import ControlClient
from rig_simulation.world.scene import scene_from, table_pose

ASIDE_RAD = 0.9  # joint 1 turns from home so far [rad]
MOST_N = 250.0  # with which an arm that touched a body at a quarter of its speed stands there [N]
AWAY = np.radians([-20.0, 35.0, 0.0, -70.0, 0.0, 75.0, 20.0])  # joints within the workspace


@row(64, "PTP requested while streaming, and vice versa", "R", named_by="A program may move the arm", hazards=(12,))
def motion_while_following(trial):
    rig, program, another = trial.rig, trial.rig.moves(), trial.rig.moves()
    trial.follow()
    trial.begins()
    result = rig.move(program, kind=MoveGoal.NAMED, name="home")
    trial.check("it moves for no program while it follows", not result.success, result.message)
    rig.watch(0.5)
    trial.check("it follows on", rig.mode == "servo", rig.mode)
    # And a hand that comes while a program moves the arm.
    rig.hand.hide()
    rig.wait_for_modes("servo", "home")
    rig.wait(lambda: rig.stream_state == "waiting", "the end of the stream")
    rig.modes.clear()
    program.send_goal(MoveGoal(kind=MoveGoal.JOINTS, joints=AWAY.tolist()))
    rig.wait_for_mode("moving")
    rig.hand.show(right=0.05)
    refused = rig.move(another, kind=MoveGoal.NAMED, name="home")
    trial.check("no two programs at once", not refused.success and "has not ended" in refused.message, refused.message)
    result = rig.moved(program)
    trial.check("the motion ends", result.success, result.message)
    rig.wait_until_at(AWAY)
    rig.wait(lambda: rig.stream_state == "running", "the stream of the hand", 15.0)
    there = rig.arm.now.time
    rig.watch(1.5)
    trial.check("the hand takes nothing over unasked", rig.arm.way(there) < 2e-3, rig.arm.way(there))
    trial.check("the reason is said", "began to move" in rig.status.reason or rig.mode == "holding", rig.status.reason)
    trial.operator()
    rig.modes.clear()
    rig.hand.hide()
    rig.bring_hand(right=-0.04)
    rig.wait_for_modes("servo")
    rig.settle()


@row(65, "PTP never reports done", "L", within=12.0, named_by="does not continue, 0.0 deg are left", operator=True,
     argued="ptp-motions.md", hazards=(4,))  # fmt: skip
def end_of_motion_is_not_reported(trial):
    rig, program = trial.rig, trial.rig.moves()
    assert rig.control(True).success
    trial.fault("arm", "unfinished")
    program.send_goal(MoveGoal(kind=MoveGoal.JOINTS, joints=AWAY.tolist(), velocity=0.25))
    rig.wait_for_mode("moving")
    rig.wait_until_at(AWAY)
    there = clock.monotonic()
    trial.says("does not continue", 10.0)
    named = clock.monotonic() - there
    rig.wait_for_mode("stopped")
    latched = clock.monotonic() - there
    trial.check("it is named before it is latched", 0.8 < named < latched - 1.0, f"{named:.1f}, {latched:.1f} s")
    result = rig.moved(program)
    trial.check("the program is told that it ended badly", not result.success, result.message)
    rig.hand.show()
    trial.stays_away(2.0)
    trial.mend("arm", "unfinished")
    trial.recovers()


@row(66, "PTP cancelled / pre-empted", "", named_by="cancelled", argued="ptp-motions.md",
     dangerous="who cancels a motion expects the arm to stop", hazards=(4,))  # fmt: skip
def cancelled(trial):
    rig, program = trial.rig, trial.rig.moves()
    assert rig.control(True).success
    home = rig.arm.now.T_base_tool
    # A straight line brakes.
    up = home.copy()
    up[2, 3] += 0.15
    pose = stamped_pose(up, BASE, rospy.Time())
    program.send_goal(MoveGoal(kind=MoveGoal.POSE, pose=pose, straight=True, velocity=0.1))
    rig.wait(lambda: rig.arm.now.T_base_tool[2, 3] > home[2, 3] + 0.04, "the arm on the line", 15.0)
    trial.begins()
    program.cancel_goal()
    at = rig.arm.now.T_base_tool[2, 3]
    result = rig.moved(program)
    trial.check("it is cancelled", program.get_state() == GoalStatus.PREEMPTED, program.get_state())
    rig.wait_for_mode("holding")
    ran_on = rig.arm.now.T_base_tool[2, 3] - at
    trial.check("the line brakes", ran_on < 0.06 and not result.success, f"{ran_on:.3f} m, {result.message}")
    # Nothing stops a point-to-point motion: it ends at its goal, and says so.
    program.send_goal(MoveGoal(kind=MoveGoal.JOINTS, joints=AWAY.tolist()))
    rig.wait_for_mode("moving")
    rig.wait(lambda: rig.arm.now.speed > 0.05, "the arm to move")
    program.cancel_goal()
    trial.says("point-to-point motion cannot be stopped")
    result = rig.moved(program)
    answered = rig.arm.now.time
    rig.wait_until_at(AWAY)
    trial.check("the answer comes when the arm stands", rig.arm.way(answered) < 2e-3, rig.arm.way(answered))
    trial.check("the cancel is mentioned", "It was cancelled on the way" in result.message, result.message)
    # Control off: at its goal the arm goes home, and the program hears of it.
    program.send_goal(MoveGoal(kind=MoveGoal.JOINTS, joints=np.radians([-70.0, 35, 0, -70, 0, 75, 20]).tolist()))
    rig.wait_for_mode("moving")
    rig.wait(lambda: rig.arm.now.speed > 0.05, "the arm to move")
    rig.modes.clear()
    assert rig.control(False).success
    result = rig.moved(program)
    rig.wait_for_modes("returning", "home")
    trial.check("it goes home when control is off", np.linalg.norm(rig.arm.now.T_base_tool - home) < 0.01)


@row(81, "A body in the way of a PTP motion", "L", within=0.5, named_by="touched something on its way to home",
     operator=True, variant="seeing",
     dangerous="the PC cannot stop such a motion, and no guard knows of the body", hazards=(4,))  # fmt: skip
def post_on_the_way_home(trial):
    rig = trial.rig
    world = ControlClient("127.0.0.1", int(rig.argument("world_port")), PATIENCE_S)
    home, at_home = rig.arm.now.q, rig.arm.now.T_base_tool[:3, 3]
    assert rig.control(True).success
    aside = home + ASIDE_RAD * np.eye(7)[0]
    rig.move(kind=MoveGoal.JOINTS, joints=aside.tolist(), velocity=0.25)
    rig.wait_until_at(aside)
    # Nobody tells the guard of the post, halfway back.
    scene = world.ask("scene")["scene"]
    c, s = np.cos(0.5 * ASIDE_RAD), np.sin(0.5 * ASIDE_RAD)
    x, y = c * at_home[0] - s * at_home[1], s * at_home[0] + c * at_home[1]
    place = (np.linalg.inv(table_pose(scene_from(scene).table)) @ [x, y, 0.0, 1.0])[:2]
    post = {"position": place.tolist(), "radius": 0.03, "height": 0.6}
    world.ask("set_scene", scene={**scene, "posts": {"post": post}})
    assert rig.control(False).success
    touching = lambda: [c for c in world.ask("contacts")["contacts"] if "post/post" in c["bodies"]]  # noqa: E731
    rig.wait(touching, "the arm at the post")
    trial.begins()
    rig.wait_for_mode("stopped")
    trial.stays_away(2.0)
    trial.check("joint 1 bears it", "joint 1 bears" in rig.status.reason, rig.status.reason)
    force = sum(contact["force"] for contact in touching())
    trial.check("it pushes no more than it did while it braked", 0.0 < force < MOST_N, f"{force:.0f} N")
    world.ask("set_scene", scene=scene)
    trial.ends()
    rig.watch(1.0)  # the arm springs back
    if rig.arm.ask("state")["safety_stop"]:  # the cabinet's own, while the arm braked
        rig.arm.ask("release")
    trial.recovers()
