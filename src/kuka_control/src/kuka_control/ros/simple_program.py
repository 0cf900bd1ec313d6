"""The simple controller: moves the arm to one joint configuration, after it has asked, and shows how far it is."""

from __future__ import annotations

import argparse
import contextlib
import math
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import rospy

from common.command_line import real
from common.errors import DeviceError, RigError
from common.ros.files import read_yaml
from common.ros.node import INTERRUPTED, join, run_program
from iiwa_kinematics import PTP_M_PER_S, full_speed_time, path_speed, ptp_velocity
from iiwa_kinematics.robot_model import FLANGE_HEIGHTS, ROBOTS, RobotModel, robot_model
from kst import JointLimits, KstClient, KstError, PtpProgress, PtpState, ServerBusy, read_joints, run_ptp
from kuka_control.model.config import OPTIONS, RobotAddress, robot_address
from kuka_control.model.joint_configurations import JointMotion, chosen_configuration, named_configurations
from kuka_control.ros.parameter_server import (
    NoMaster,
    NoParameters,
    living_node,
    master_of_this_graph,
    parameters,
    shipped,
)
from rig_description.hand import CONNECTOR_LENGTH, RING_LENGTH, finger_balls

NODE = "kuka_simple_node"
CONTROLLERS = ("kuka_real_time_node", "kuka_ptp_node", NODE)  # nodes that hold the robot's only connection


@contextlib.contextmanager
def noted_interruptions() -> Iterator[list[int]]:
    """Within the context Ctrl-C and SIGTERM do not interrupt the program; their numbers are added to the list."""
    noted: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, lambda received, _: noted.append(received)) for number in numbers}
    try:
        yield noted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class ProgressLine:
    """One line that changes on a terminal; elsewhere a line for every tenth of the motion."""

    def __init__(self) -> None:
        self._live = sys.stdout.isatty()
        self._open = False
        self._tenths = -1

    def show(self, progress: PtpProgress) -> None:
        if self._live:
            print(f"\r{progress_bar(progress)}", end="", flush=True)
            self._open = True
        elif int(10.0 * progress.fraction) > self._tenths:
            self._tenths = int(10.0 * progress.fraction)
            print(progress_bar(progress))

    def end(self) -> None:
        """Leaves the line as it is; what is printed next starts a new one."""
        if self._open:
            print()
        self._open = False


def progress_bar(progress: PtpProgress) -> str:
    """Returns a line with a bar and the remaining step."""
    bar_characters = 30
    filled = int(progress.fraction * bar_characters)
    remaining = f"{math.degrees(progress.remaining):6.1f} deg left (joint {progress.joint})"
    return f"[{'#' * filled}{'.' * (bar_characters - filled)}] {100.0 * progress.fraction:3.0f} %  {remaining}"


def agrees(question: str) -> bool | None:
    """Returns whether the operator agrees; None after Ctrl-C."""
    try:
        return input(f"{question} [y/N] ").strip().lower() in ("y", "yes")
    except EOFError:
        print()
        return False
    except KeyboardInterrupt:
        print()
        return None


def main() -> None:
    """Runs the program and exits the process. The exit code is 0 when the arm is there, 1 after sentences that say
    why it is not, 130 after an interruption."""
    options = _parser().parse_args(rospy.myargv()[1:])
    run_program("simple_controller", lambda: _run(options), "Interrupted.", (RigError, KstError))


def _run(options: argparse.Namespace) -> int:
    address, from_server = _address(options)
    model = robot_model(address.robot, address.flange)
    named = named_configurations(read_yaml(options.configurations or shipped("joint_configurations.yaml")), model)
    if options.list:
        width = max(map(len, named))
        for name, q in named.items():
            print(f"{name:<{width}}  {', '.join(f'{angle:g}' for angle in np.degrees(q).round(6) + 0.0)} deg")
        return 0
    if not options.target:
        raise RigError("Say where to: a name (see --list) or seven angles in deg.")
    name, target = chosen_configuration(options.target, named, model)
    if not options.yes and not sys.stdin.isatty():
        raise RigError("There is no terminal to ask on whether the arm may move; use --yes.")
    if from_server:
        _refuse_if_held()
    with contextlib.suppress(NoMaster):  # becomes a node where there is a master: others see who has the robot
        master_of_this_graph()  # first: without one it matters not by which name others would reach this computer
        join(NODE)
    T_flange_tool = address.T_flange_tool
    client = _connect(address, model, T_flange_tool)
    try:
        return _move(client, model, T_flange_tool, name, target, options)
    finally:
        client.close()
        print("The connection is closed, and the server on the robot has stopped; start it again for the next program.")


def _move(
    client: KstClient,
    model: RobotModel,
    T_flange_tool: np.ndarray,
    name: str,
    target: np.ndarray,
    options: argparse.Namespace,
) -> int:
    motion = JointMotion(read_joints(client), target)
    print("\n".join(motion.table()))
    if not motion.needed:
        print(f"The arm is at {name} already; nothing was moved.")
        return 0
    joint, step = motion.largest
    balls = ((*T_flange_tool[:3, 3].tolist(), 0.0), *finger_balls(CONNECTOR_LENGTH + RING_LENGTH))
    velocity = ptp_velocity(model, balls, motion.start, motion.target, options.velocity)
    seconds = full_speed_time(model, motion.start, motion.target) / velocity
    fastest = path_speed(model, balls, motion.start, motion.target) / seconds
    print(
        f"Largest step: joint {joint} by {step:+.1f} deg; at {velocity:g} of full speed about {seconds:.1f} s, "
        f"the fastest point from elbow to finger tips at up to {fastest:.2f} m/s."
    )
    if velocity < options.velocity:
        print(f"That is slowed from {options.velocity:g}: no point of the arm may pass {PTP_M_PER_S:g} m/s.")
    agreed = options.yes or agrees(f"Move the arm to {name}?")
    if not agreed:
        print("Nothing was moved.")
        return INTERRUPTED if agreed is None else 1
    line = ProgressLine()

    def show(progress: PtpProgress, _: np.ndarray) -> None:
        line.show(progress)
        if progress.stall_began:
            line.end()
            print("The arm does not move: look at the smartPad (enabling switch, safety stop, speed override).")

    with noted_interruptions() as noted:
        try:
            end = run_ptp(client, target, velocity, report=show, interrupted=lambda: bool(noted))
        finally:
            line.end()
    if end.state is PtpState.INTERRUPTED:
        print(
            "Interrupted, but the toolbox cannot stop a PTP motion: the arm continues to its goal, "
            f"{np.degrees(end.remaining):.1f} deg more.\n"
            "To stop it, press stop or release the enabling switch on the smartPad."
        )
        return INTERRUPTED
    print(f"The arm is at {name}.")
    return 0


def _address(options: argparse.Namespace) -> tuple[RobotAddress, bool]:
    """Returns the robot, and whether it is the one that the controllers of this ROS graph speak to."""
    given = {key: getattr(options, key) for key in OPTIONS}
    try:
        values = parameters("kuka")
    except (NoMaster, NoParameters):
        return robot_address(read_yaml(shipped("kuka_params_rt.yaml")), given), False
    address = robot_address(values, given, "kuka/")
    return address, (address.ip, address.port) == (values.get("ip"), values.get("port"))


def _refuse_if_held() -> None:
    for name in CONTROLLERS:
        if living_node(name):
            cure = "stop it with Ctrl-C" if name == NODE else "end it first: rosservice call kuka/exit_app"
            raise RigError(f"The node {name} is running and holds the robot's only connection; {cure}")


def _connect(address: RobotAddress, model: RobotModel, T_flange_tool: np.ndarray) -> KstClient:
    print(f"Connecting to the {address.robot} at {address.ip}:{address.port}.")
    limits = JointLimits(model.lower, model.upper)
    try:
        return KstClient.connect(address.ip, address.port, tool=T_flange_tool, limits=limits)
    except ServerBusy as error:
        raise DeviceError(
            "The robot serves one program at a time, and another one seems to have it (is a controller node running?): "
            f"{error}."
        ) from error
    except KstError as error:
        raise DeviceError(f"There is no connection to the robot: {error}.") from error


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="simple_controller.py",
        description="Moves the arm to one joint configuration, after it has asked.",
        epilog="The robot is that of the parameters under kuka/ on the ROS master, or else of kuka_params_rt.yaml; the "
        "options below stand above both.",
    )
    parser.add_argument("target", nargs="*", metavar="NAME_OR_ANGLE", help="a name, or the seven joint angles in deg")
    parser.add_argument("--list", action="store_true", help="list the names with their angles, and exit")
    parser.add_argument(
        "--velocity",
        type=real(0.0, 1.0, open_low=True),
        default=0.15,
        help="fraction of full speed, (0, 1] (%(default)s)",
    )
    parser.add_argument("--yes", action="store_true", help="move without asking")
    parser.add_argument("--configurations", type=Path, metavar="FILE.yaml", help="other names than the package's")
    robot = parser.add_argument_group("robot")
    robot.add_argument("--ip", help="address of the robot's controller")
    robot.add_argument("--port", type=int, help="TCP port of the toolbox server")
    robot.add_argument("--robot", choices=ROBOTS, help="the arm")
    robot.add_argument("--flange", choices=tuple(FLANGE_HEIGHTS), help="the media flange")
    robot.add_argument(
        "--tool-length",
        type=float,
        metavar="M",
        help="from the flange to the tool point, m; instead of the parameters' tool",
    )
    return parser
