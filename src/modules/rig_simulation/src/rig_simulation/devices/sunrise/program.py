"""The program `sunrise_controller.py`: arguments in, one ready line out, then the server until it is to end."""

from __future__ import annotations

import argparse
import math
import signal
import sys
import time
from collections.abc import Callable
from typing import NoReturn

from common.errors import DeviceError
from rig_simulation.command_line import angle, not_negative, parse_options, port, positive
from rig_simulation.devices.sunrise.application import VERSIONS
from rig_simulation.devices.sunrise.arm import ArmEnvironment, ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.description import FLANGES, ROBOTS, read_urdf
from rig_simulation.devices.sunrise.robot import Robot
from rig_simulation.devices.sunrise.server import AT_ONCE_S, ServerSettings, SunriseServer
from rig_simulation.devices.sunrise.servo import LAWS
from rig_simulation.faults.arm import ARM_FAULTS
from rig_simulation.faults.injection import add_option, switch_all

NAME = "sunrise_controller"


def main(arguments: list[str] | None = None) -> int:
    """Runs the simulated controller; returns the exit code."""
    parser = Parser(NAME, description="Simulated KUKA Sunrise controller with the toolbox server on it.")
    add_options(parser)
    parser.add_argument("--control-port", type=port, default=30011, help="port for tests; 0 takes any free port")
    options = parse_options(parser, arguments)
    try:
        server = make_server(options)
    except (DeviceError, FileNotFoundError, ValueError) as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        return 1
    switch_all(server.faults, options.fault)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: server.stop())
    print(ready_line(server), flush=True)
    server.run()
    return 0


def make_server(
    options: argparse.Namespace,
    surroundings: ArmEnvironment | None = None,
    clock: Callable[[], float] = time.monotonic,
    at_once: float = AT_ONCE_S,
) -> SunriseServer:
    """Returns the server that the options describe, with an arm of its own.

    Args:
        options: with what `add_options` adds, and `control_port`.
        surroundings: what the arm moves in.
        clock: time that it lives in [s].
        at_once: see Server.

    Raises:
        DeviceError: a port is not to be had.
        FileNotFoundError: there is no description of the robot.
    """
    arm_settings = ArmSettings(options.safety_torque, options.safety_speed, options.servo_law, options.trajectory_time)
    settings = ServerSettings(
        options.wiped_window,
        options.wait_for_client,
        options.deaf_after_lost_client,
        options.end_exits,
        options.toolbox_version,
    )
    arm = SimulatedArm(Robot(read_urdf(options.robot, options.flange), options.mounting), arm_settings, surroundings)
    return SunriseServer(arm, settings, options.host, options.port, options.control_port, _log, clock, at_once)


def ready_line(server: SunriseServer) -> str:
    """Returns what a program prints when the server listens."""
    return f"{NAME}: listening on {server.host}:{server.port}, control port {server.host}:{server.control_port}"


def _log(sentence: str) -> None:
    print(f"{NAME}: {sentence}", file=sys.stderr, flush=True)


class Parser(argparse.ArgumentParser):
    """A command line of which a mistake is one sentence and exit code 1."""

    def __init__(self, name: str, description: str) -> None:
        super().__init__(prog=f"{name}.py", description=description)
        self._name = name

    def error(self, message: str) -> NoReturn:
        """Ends the program."""
        self.exit(1, f"{self._name}: {message}\n")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options of the simulated controller, apart from its control port."""
    parser.add_argument("--host", default="127.0.0.1", help="loopback address to listen on")
    parser.add_argument("--port", type=port, default=30001, help="port of the toolbox server; 0 takes any free port")
    parser.add_argument("--robot", choices=ROBOTS, default=ROBOTS[0], help="which arm")
    parser.add_argument("--flange", choices=FLANGES, default=FLANGES[0], help="which media flange")
    parser.add_argument(
        "--mounting",
        nargs=3,
        type=angle,
        default=(0.0, 0.0, 0.0),
        metavar=("ROLL", "PITCH", "YAW"),
        help="attitude of the base in an upright world, deg, such as 180 0 0 on a ceiling; gravity follows it",
    )
    parser.add_argument(
        "--servo-law",
        choices=sorted(LAWS),
        default="lts",
        help="how joint servo approaches a goal: lts = law of the published server, none = straight to the goal",
    )
    parser.add_argument(
        "--trajectory-time", type=positive, default=0.04, help="minimum trajectory time of DirectServo, s"
    )
    parser.add_argument(
        "--wiped-window",
        type=not_negative,
        default=0.0,
        help="seconds after an answer in which a main command is lost",
    )
    parser.add_argument(
        "--wait-for-client",
        type=positive,
        default=math.inf,
        help="seconds without a client after which it ends",
    )
    parser.add_argument(
        "--deaf-after-lost-client", action="store_true", help="a client lost without `end` leaves the port deaf"
    )
    parser.add_argument("--end-exits", action="store_true", help="the command `end` ends the program")
    parser.add_argument(
        "--toolbox-version",
        choices=VERSIONS,
        default=VERSIONS[-1],
        help="which server: before 2019-05 servo goals bring no pose, and the force as the answer to another word",
    )
    parser.add_argument("--safety-torque", type=positive, default=25.0, help="external torque of the safety stop, Nm")
    parser.add_argument("--safety-speed", type=positive, default=0.8, help="tool speed of the safety stop, m/s")
    add_option(parser, ARM_FAULTS)
