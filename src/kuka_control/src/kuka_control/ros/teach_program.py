"""The program teach.py: way points that a hand shows the arm, kept in a file and played back by the action kuka/move,
each by a motion of the running controller."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rospy
import yaml

from common import clock
from common.command_line import real
from common.errors import ConfigError, DeviceError, RigError
from common.ros.action_client import ActionClient
from common.ros.files import read_yaml, user_file, write_whole
from common.ros.node import INTERRUPTED, join, run_program
from common.ros.params import arm_frames
from iiwa_kinematics import RobotModel, robot_model
from kuka_control.model.config import robot_address
from kuka_control.model.taught import SAME_RAD, TaughtArm, content_of, points_of, reduced
from kuka_control.ros.move_program import SERVER_S, SILENCE_S, carry_out
from kuka_control.ros.parameter_server import parameters
from kuka_control.ros.simple_program import noted_interruptions
from kuka_msgs.msg import MoveAction, MoveFeedback, MoveGoal, MoveResult

KIND = "taught_motion"
POLL_S = 0.05
HOLD = "Hold the enabling switch and move the arm; each release keeps a way point. Ctrl-C ends the recording."


def main() -> None:
    """Runs the program and exits the process. The exit code is 0 when all was done, 1 after a sentence that says why
    not, 130 after an interruption of a playback."""
    options = _parser().parse_args(rospy.myargv()[1:])
    run_program("teach", lambda: options.run(options), "Interrupted before anything moved.")


def _record(options: argparse.Namespace) -> int:
    path = user_file(KIND, options.name)
    if path.exists() and not options.replace:
        raise RigError(f"{path} exists; choose another name, or add --replace.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{path.parent} cannot be made: {error.strerror}; nothing could be stored.") from error
    if not os.access(path.parent, os.W_OK):
        raise RigError(f"{path.parent} cannot be written; nothing could be stored.")
    join("kuka_teach", anonymous=True)
    arm, _ = _arm()
    points: list[np.ndarray] = []

    def keep(q: np.ndarray) -> None:
        if not points or np.max(np.abs(q - points[-1])) > SAME_RAD:
            points.append(q)

    fault = _guide(keep, options.path, lambda: print(f"{_counted(len(points))} kept."))
    if not points:
        raise RigError(f"No way point was kept. {fault}".strip())
    kept = reduced(np.array(points)) if options.path else np.array(points)
    content = yaml.safe_dump(content_of(kept, arm), sort_keys=False)
    try:
        write_whole(path, content)
    except OSError as error:
        print(content)
        raise RigError(f"{path} cannot be written: {error.strerror}; what belongs in it is printed above.") from error
    print(f"{path} has {_counted(len(kept))}.")
    if fault:
        print(fault, file=sys.stderr)
    return 1 if fault else 0


def _guide(keep: Callable[[np.ndarray], None], path: bool, released: Callable[[], None]) -> str:
    """Lets a hand guide the arm again and again until Ctrl-C; keeps where it was left, and with `path` the way there.
    Returns why it ended early, a sentence, or nothing."""
    client = ActionClient("kuka/move", MoveAction)
    if not client.wait_for_server(rospy.Duration(SERVER_S)):
        raise DeviceError("Nobody offers kuka/move: start a controller first, such as with make demo.")
    heard = [0.0]
    said: list[str] = []

    def take(feedback: MoveFeedback) -> None:
        if not said:
            said.append(HOLD)
            print(HOLD)
        heard[0] = clock.monotonic()
        if path:
            keep(np.array(feedback.joints))

    with noted_interruptions() as noted:
        while not noted:
            heard[0] = clock.monotonic()
            client.send_goal(MoveGoal(kind=MoveGoal.GUIDED), feedback_cb=take)
            cancelled = False
            while not client.wait_for_result(rospy.Duration(POLL_S)):
                if noted and not cancelled:
                    cancelled = True
                    client.cancel_goal()
                if clock.monotonic() - heard[0] > SILENCE_S:
                    return f"kuka/move has reported nothing for {SILENCE_S:g} s; the controller may have ended."
            result: MoveResult = client.get_result()
            if cancelled:
                break
            if not result.success:
                return result.message
            keep(np.array(result.joints))
            released()
    return ""


def _counted(points: int) -> str:
    return f"{points} way point{'s' * (points != 1)}"


def _list(_: argparse.Namespace) -> int:
    folder = user_file(KIND, "any").parent
    files = sorted(folder.glob("*.yaml"))
    if not files:
        print(f"No motion is kept in {folder}.")
    for path in files:
        content = read_yaml(path)
        known = isinstance(content, dict)
        print(f"{path.stem:<24} {content.get('count', '?') if known else 'no taught motion'} way points")
    return 0


def _play(options: argparse.Namespace) -> int:
    path = user_file(KIND, options.name)
    join("kuka_teach", anonymous=True)
    arm, model = _arm()
    points = _read(path, arm, model)
    for number, q in enumerate(points, 1):
        goal = MoveGoal(kind=MoveGoal.JOINTS, joints=q.tolist(), velocity=options.velocity)
        result, interrupted = carry_out(goal)
        if interrupted or not result.success:
            print(f"Way point {number} of {len(points)}: {result.message}", file=sys.stderr)
            return INTERRUPTED if interrupted else 1
    print(f"The arm is at the last way point, number {len(points)}.")
    return 0


def _read(path: Path, arm: TaughtArm, model: RobotModel) -> np.ndarray:
    try:
        return points_of(read_yaml(path), arm, model)
    except ConfigError:
        raise
    except RigError as error:
        raise RigError(f"{path} is refused: {error}") from error


def _arm() -> tuple[TaughtArm, RobotModel]:
    address = robot_address(parameters("kuka"), {}, "kuka/")
    return TaughtArm(address.robot, address.flange, arm_frames().tf_prefix), robot_model(address.robot, address.flange)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="teach.py",
        description="Teaches the arm a motion by hand, and plays it back (robot_server: leap_rig).",
        epilog="Recording needs control on, the arm at home or where a program left it, and no hand over the tracker.",
    )
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    record = commands.add_parser("record", help="keep where a hand leaves the arm, until Ctrl-C")
    record.add_argument("--path", action="store_true", help="keep the way between, too")
    record.add_argument("--replace", action="store_true", help="replace a motion of this name")
    play = commands.add_parser("play", help="move the arm from way point to way point; Ctrl-C stops it")
    play.add_argument(
        "--velocity", type=real(0.0, 1.0), default=0.0, help="fraction of full speed; 0: the usual one (%(default)s)"
    )
    for command, run in ((record, _record), (play, _play)):
        command.add_argument("name", metavar="NAME", help="of the motion")
        command.set_defaults(run=run)
    commands.add_parser("list", help="the motions that are kept").set_defaults(run=_list)
    return parser
