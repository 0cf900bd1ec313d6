"""The program move.py: one motion of the arm by the running controller (action kuka/move), with a progress bar."""

from __future__ import annotations

import argparse
import sys

import numpy as np
import rospy
from tqdm import tqdm

from common import clock
from common.errors import DeviceError, RigError
from common.frames import BASE
from common.poses import pose
from common.ros.action_client import ActionClient
from common.ros.conversions import stamped_pose
from common.ros.node import INTERRUPTED, join, run_program
from common.ros.params import arm_frames
from common.rotations import rotation_from_zyx
from kuka_control.ros.simple_program import noted_interruptions
from kuka_msgs.msg import MoveAction, MoveFeedback, MoveGoal, MoveResult

SERVER_S = 5.0  # how long a controller is looked for [s]
SILENCE_S = 5.0  # a controller that reports nothing for so long has ended [s]


def main() -> None:
    """Runs the program and exits the process. The exit code is 0 when the arm is there, 1 after a sentence that says
    why it is not, 130 after an interruption."""
    options = _parser().parse_args(rospy.myargv()[1:])
    run_program("move", lambda: _run(options), "Interrupted before anything moved.")


def _run(options: argparse.Namespace) -> int:
    goal = _goal(options)
    join("kuka_move", anonymous=True)
    if goal.kind == MoveGoal.POSE:
        goal.pose.header.frame_id = arm_frames()(BASE)
    result, interrupted = carry_out(goal)
    print(result.message, file=sys.stdout if result.success else sys.stderr)
    return 0 if result.success else INTERRUPTED if interrupted else 1


def carry_out(goal: MoveGoal) -> tuple[MoveResult, bool]:
    """Moves the arm, with a progress bar; returns the result, and whether Ctrl-C interrupted the motion. Raises
    DeviceError if no controller answers."""
    poll_s = 0.1
    client = ActionClient("kuka/move", MoveAction)
    if not client.wait_for_server(rospy.Duration(SERVER_S)):
        raise DeviceError("Nobody offers kuka/move: start a controller first, such as with make demo.")
    heard = clock.monotonic()
    with noted_interruptions() as noted, tqdm(
        total=100.0, bar_format="{percentage:3.0f} % |{bar}| {postfix[0]}", postfix=[""], disable=None, leave=False
    ) as bar:

        def show(feedback: MoveFeedback) -> None:
            nonlocal heard
            heard = clock.monotonic()
            unit = "m" if goal.straight else "rad"
            bar.postfix = [f"{feedback.left:.3f} {unit} left"]
            bar.update(100.0 * feedback.fraction - bar.n)

        client.send_goal(goal, feedback_cb=show)
        cancelled = False
        while not client.wait_for_result(rospy.Duration(poll_s)):
            if noted and not cancelled:
                cancelled = True
                client.cancel_goal()
            if clock.monotonic() - heard > SILENCE_S:
                raise DeviceError(f"kuka/move has reported nothing for {SILENCE_S:g} s; the controller may have ended.")
    return client.get_result(), cancelled


def _goal(options: argparse.Namespace) -> MoveGoal:
    name, *numbers = options.target
    goal = MoveGoal(straight=options.straight, velocity=options.velocity)
    if name not in ("joints", "pose"):
        if numbers:
            raise RigError(f"After the name {name} no numbers are expected; see --help.")
        goal.kind, goal.name = MoveGoal.NAMED, name
        return goal
    try:
        values = np.array([float(number) for number in numbers])
    except ValueError as error:
        raise RigError(f"{' '.join(numbers)} are not numbers.") from error
    if len(values) != {"joints": 7, "pose": 6}[name]:
        raise RigError("After joints come seven angles in deg; after pose x, y, z in m and A, B, C in deg.")
    if name == "joints":
        goal.kind, goal.joints = MoveGoal.JOINTS, np.radians(values).tolist()
    else:
        T_base_tool = pose(rotation_from_zyx(*np.radians(values[3:])), values[:3])
        goal.kind, goal.pose = MoveGoal.POSE, stamped_pose(T_base_tool, BASE, rospy.Time(0))
    return goal


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="move.py", description="Moves the arm by the running controller, while control is on; Ctrl-C cancels."
    )
    target = "home, zero or another name; or joints and seven angles in deg; or pose, x y z in m and A B C in deg"
    parser.add_argument("target", nargs="+", metavar="TARGET", help=f"{target} (about z, y, x) of the tool in the base")
    parser.add_argument("--straight", action="store_true", help="the tool moves along a straight line, to a pose")
    velocity = "fraction of the full joint speed; with --straight m/s (default: the usual one)"
    parser.add_argument("--velocity", type=float, default=0.0, help=velocity)
    return parser
