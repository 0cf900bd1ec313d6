"""The program `world.py`: the simulated arm, the simulated hand and the objects between them in one physics.

The server of the arm drives the time: when it advances, the arm steps, the world with it, and the hand in the world. So
one clock and one lock are enough. The devices speak the same protocols as when they run as programs of their own.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import sys

import mujoco

from common.errors import RigError
from rig_simulation.command_line import CommandLine, failed, parse_options, port, positive, stop_on_signals
from rig_simulation.control_port import ControlPort
from rig_simulation.devices.reflex import program as reflex
from rig_simulation.devices.reflex.hand import PERIOD_S, SimulatedHand
from rig_simulation.devices.reflex.link import HandLink
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
    """The network cycle of the hand, in world time."""

    def __init__(self, hand: SimulatedHand, link: HandLink) -> None:
        self._hand, self._link = hand, link
        self._steps = 0

    def bind(self, world: World) -> None:
        """Computes the world's steps in a cycle."""
        self._period = round(PERIOD_S / world.timestep)

    def after_step(self) -> None:
        """Exchanges packets once in a cycle."""
        self._steps += 1
        if self._steps % self._period == 0:
            reflex.exchange(self._hand, self._link)


def main(arguments: list[str] | None = None) -> int:
    """Runs the world until it is interrupted; returns the exit code."""
    options = _options(arguments)
    mujoco.set_mju_user_warning(_log)  # otherwise MuJoCo writes them to a file in the current folder
    try:
        with contextlib.ExitStack() as resources:
            _run(options, resources)
    except (RigError, FileNotFoundError, ValueError) as error:
        return failed(NAME, error)
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
    hand_requests = reflex.handlers(hand.simulated, link, server.lock)
    hand_control = resources.enter_context(ControlPort(hand_requests, options.host, options.hand_control_port))
    world_requests = WorldRequests(world, server, clock).handlers
    control = resources.enter_context(ControlPort(world_requests, options.host, options.world_port))
    stop_on_signals(server.stop)
    print(sunrise.ready_line(server), flush=True)
    print(reflex.ready_line(link, hand_control), flush=True)
    print(f"{NAME}: scene {options.scene}, control port {control.host}:{control.port}", flush=True)
    server.run()


def _log(sentence: str) -> None:
    print(f"{NAME}: {sentence.strip()}", file=sys.stderr, flush=True)


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = CommandLine(NAME, "Simulated arm, hand, table and objects in one physics.")
    sunrise.add_options(parser)
    add = parser.add_argument
    add("--interface", default="lo", help="network interface of the hand")
    add("--hand-port", type=port, default=11333, help="UDP port of the hand; 0: any free one")
    add("--hand-control-port", type=port, default=11433, help="port of the hand for tests")
    add_option(parser, HAND_FAULTS, "--hand-fault")
    add("--world-port", type=port, default=30021, help="port of the world; 0: any free one")
    add("--scene", default="cup", help="name of a scene of this package, or path of a yaml file")
    board = "marker board on the flange: single, bundle, or path of a yaml file"
    add("--panel", nargs="?", const=PANELS[0], help=board)
    add("--seed", type=int, default=0, help="seed of scattered objects, and of the hand's slack and noise")
    add("--speed", type=positive, default=1.0, help="seconds of the world in a second")
    add("--stepped", action="store_true", help="time stands still until the request `step` moves it")
    return parse_options(parser, arguments)
