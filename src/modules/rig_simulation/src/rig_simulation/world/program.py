"""The program `world.py`: the simulated arm, the simulated hand and the objects between them in one physics.

The arm's controller drives the time: whenever its server moves on, the arm steps, with it the world, and in the world
the hand. So there is one clock and one lock. What the devices speak is what they speak as programs of their own.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import signal
import sys

import mujoco

from common.errors import RigError
from rig_simulation.command_line import parse_options, port, positive
from rig_simulation.control_port import ControlPort
from rig_simulation.devices.reflex.hand import PERIOD_S, SimulatedHand
from rig_simulation.devices.reflex.link import HandLink
from rig_simulation.devices.reflex.program import exchange, handlers
from rig_simulation.devices.sunrise import program as sunrise
from rig_simulation.devices.sunrise.server import AT_ONCE_S
from rig_simulation.faults.hand import HAND_FAULTS
from rig_simulation.faults.injection import add_option, switch_all
from rig_simulation.world.arm import ArmJoints
from rig_simulation.world.clock import Clock
from rig_simulation.world.control import WorldRequests
from rig_simulation.world.files import read_board, read_scene
from rig_simulation.world.hand import HandPart
from rig_simulation.world.model import WorldDescription
from rig_simulation.world.physics import Part, World

NAME = "world"
PANELS = ("single", "bundle")


class HandCycle(Part):
    """The hand's network cycle, in the time of the world."""

    def __init__(self, hand: SimulatedHand, link: HandLink) -> None:
        self._hand, self._link = hand, link
        self._steps = 0

    def bind(self, world: World) -> None:
        """Takes the length of the world's step."""
        self._period = round(PERIOD_S / world.timestep)

    def after_step(self) -> None:
        """Sends the hand's state and follows commands once in a period."""
        self._steps += 1
        if self._steps % self._period == 0:
            exchange(self._hand, self._link)


def main(arguments: list[str] | None = None) -> int:
    """Runs the world until it is interrupted; returns the exit code."""
    options = _options(arguments)
    mujoco.set_mju_user_warning(_log)  # otherwise they go to a file in the folder where the program was started
    try:
        with contextlib.ExitStack() as resources:
            _run(options, resources)
    except (RigError, FileNotFoundError, ValueError) as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        return 1
    return 0


def _run(options: argparse.Namespace, resources: contextlib.ExitStack) -> None:
    panel = None if options.panel is None else read_board(options.panel)
    scene = read_scene(options.scene)
    description = WorldDescription(options.robot, options.flange, tuple(options.mounting), scene, panel)
    world = World(description, options.seed)
    hand = HandPart(options.seed)
    world.add(hand)
    link = HandLink(options.interface, options.hand_port)
    resources.callback(link.close)
    world.add(HandCycle(hand.simulated, link))

    clock = Clock(None if options.stepped else options.speed)
    server = sunrise.make_server(options, ArmJoints(world), clock, math.inf if options.stepped else AT_ONCE_S)
    resources.callback(server.close)
    switch_all(server.faults, options.fault)
    switch_all(link.faults, options.hand_fault)
    hand_requests = {**handlers(hand.simulated, server.lock), **link.faults.requests}
    hand_control = resources.enter_context(ControlPort(hand_requests, options.host, options.hand_control_port))
    world_requests = WorldRequests(world, server, clock).handlers
    control = resources.enter_context(ControlPort(world_requests, options.host, options.world_port))
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: server.stop())
    print(sunrise.ready_line(server), flush=True)
    print(
        f"reflex_hand: on {options.interface}, UDP port {link.port}, control port {_address(hand_control)}", flush=True
    )
    print(f"{NAME}: scene {options.scene}, control port {_address(control)}", flush=True)
    server.run()


def _log(sentence: str) -> None:
    print(f"{NAME}: {sentence.strip()}", file=sys.stderr, flush=True)


def _address(control: ControlPort) -> str:
    return f"{control.host}:{control.port}"


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = sunrise.Parser(NAME, description="Simulated arm, hand, table and objects in one physics.")
    sunrise.add_options(parser)
    parser.add_argument("--control-port", type=port, default=30011, help="port of the arm for tests; 0: any free one")
    parser.add_argument("--interface", default="lo", help="network interface of the hand")
    parser.add_argument("--hand-port", type=port, default=11333, help="UDP port of the hand; 0: any free one")
    parser.add_argument("--hand-control-port", type=port, default=11433, help="port of the hand for tests")
    add_option(parser, HAND_FAULTS, "--hand-fault")
    parser.add_argument("--world-port", type=port, default=30021, help="port of the world; 0: any free one")
    parser.add_argument("--scene", default="cup", help="name of a scene of this package, or path of a yaml file")
    parser.add_argument(
        "--panel", nargs="?", const=PANELS[0], help="marker panel on the flange: single, bundle, or path of a yaml file"
    )
    parser.add_argument("--seed", type=int, default=0, help="of scattered objects, of the hand's slack and noise")
    parser.add_argument("--speed", type=positive, default=1.0, help="seconds of the world in a second")
    parser.add_argument("--stepped", action="store_true", help="time stands until the request `step` moves it")
    return parse_options(parser, arguments)
