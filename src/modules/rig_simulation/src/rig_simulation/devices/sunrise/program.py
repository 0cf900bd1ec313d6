"""The program `sunrise_controller.py`: options, one line when it is ready, then the server until it stops."""

from __future__ import annotations

import argparse
import functools
import math
import sys
from collections.abc import Callable

from common import clock
from common.command_line import (
    CommandLine,
    angle,
    failed,
    not_negative,
    parse_options,
    port,
    positive,
    stop_on_signals,
)
from common.errors import DeviceError
from rig_simulation.devices.sunrise.application import VERSIONS
from rig_simulation.devices.sunrise.arm import ArmEnvironment, ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.leap_rig_server import LeapRigServer
from rig_simulation.devices.sunrise.robot import LAWS, Robot
from rig_simulation.devices.sunrise.server import AT_ONCE_S, ServerSettings, SunriseServer
from rig_simulation.faults.arm import ARM_FAULTS
from rig_simulation.faults.injection import add_option, switch_all
from rig_simulation.files import FLANGES, ROBOTS, read_urdf

NAME = "sunrise_controller"
ROBOT_SERVERS = {"toolbox": SunriseServer, "leap_rig": LeapRigServer}


def main(arguments: list[str] | None = None) -> int:
    parser = CommandLine(NAME, "Simulated KUKA Sunrise controller with the toolbox server on it.")
    add_options(parser)
    options = parse_options(parser, arguments)
    try:
        server = make_server(options)
    except (DeviceError, FileNotFoundError, ValueError) as error:
        return failed(NAME, error)
    switch_all(server.faults, options.fault)
    stop_on_signals(server.stop)
    print(ready_line(server), flush=True)
    server.run()
    return 0


def make_server(
    options: argparse.Namespace,
    environment: ArmEnvironment | None = None,
    now: Callable[[], float] | None = None,
    at_once: float = AT_ONCE_S,
    lock: clock.RLock | None = None,
    name: str = NAME,
) -> SunriseServer:
    """Returns the server that the options of `add_options` describe, with an arm of its own; see SunriseServer. `name`
    begins what it reports. Raises DeviceError if a port is taken, FileNotFoundError if the robot's description is
    missing."""
    laws = options.servo_law, options.trajectory_time, options.tool_weight
    arm_settings = ArmSettings(options.safety_torque, options.safety_speed, *laws)
    lost_client = options.wait_for_client, options.deaf_after_lost_client, options.end_exits
    settings = ServerSettings(options.wiped_window, *lost_client, options.toolbox_version)
    arm = SimulatedArm(Robot(read_urdf(options.robot, options.flange), options.mounting), arm_settings, environment)
    ports = options.host, options.port, options.control_port
    toolbox_alone = options.wiped_window, options.deaf_after_lost_client, options.toolbox_version != VERSIONS[-1]
    if options.robot_server != "toolbox" and any(toolbox_alone):
        sides = "--wiped-window, --deaf-after-lost-client and --toolbox-version"
        raise ValueError(f"{sides} are sides of the toolbox's server; leave them out with --robot-server leap_rig.")
    return ROBOT_SERVERS[options.robot_server](arm, settings, *ports, functools.partial(_log, name), now, at_once, lock)


def ready_line(server: SunriseServer, name: str = NAME) -> str:
    return f"{name}: listening on {server.host}:{server.port}, control port {server.host}:{server.control_port}"


def _log(name: str, sentence: str) -> None:
    print(f"{name}: {sentence}", file=sys.stderr, flush=True)


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--host", default="127.0.0.1", help="loopback address to listen on")
    add("--port", type=port, default=30001, help="port of the toolbox server; 0 takes any free port")
    add("--control-port", type=port, default=30011, help="port of the arm for tests; 0 takes any free port")
    add("--robot", choices=ROBOTS, default=ROBOTS[0], help="which arm")
    add("--flange", choices=FLANGES, default=FLANGES[0], help="which media flange")
    mounting = "orientation of the base in an upright world, deg, such as 180 0 0 on a ceiling; gravity follows it"
    rpy = ("ROLL", "PITCH", "YAW")
    add("--mounting", nargs=3, type=angle, default=(0.0, 0.0, 0.0), metavar=rpy, help=mounting)
    server = "which application: toolbox, as of 2019, or leap_rig, which watches its client and stops what moves"
    add("--robot-server", choices=ROBOT_SERVERS, default="toolbox", help=server)
    law = "how joint servo approaches a goal: lts = law of the published server, none = straight to the goal"
    add("--servo-law", choices=sorted(LAWS), default="lts", help=law)
    add("--trajectory-time", type=positive, default=0.04, help="minimum trajectory time of DirectServo, s")
    wiped = "seconds after an answer in which a main command is lost"
    add("--wiped-window", type=not_negative, default=0.0, help=wiped)
    wait = "seconds without a client after which the program exits"
    add("--wait-for-client", type=positive, default=math.inf, help=wait)
    deaf = "a client lost without `end` leaves the port deaf"
    add("--deaf-after-lost-client", action="store_true", help=deaf)
    add("--end-exits", action="store_true", help="the command `end` exits the program")
    version = "which server: before 2019-05 servo goals bring no pose, and the force as the answer to another word"
    add("--toolbox-version", choices=VERSIONS, default=VERSIONS[-1], help=version)
    add("--safety-torque", type=positive, default=25.0, help="external torque of the safety stop, Nm")
    weight = "the hand's weight counts as external torque: the toolbox tells the controller of a tool without mass"
    add("--tool-weight", action="store_true", help=weight)
    add("--safety-speed", type=positive, default=0.8, help="tool speed of the safety stop, m/s")
    add_option(parser, ARM_FAULTS)
