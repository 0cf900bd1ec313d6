"""The program `world.py`: the simulated arm, the simulated hand and the objects between them in one physics.

The server of the arm drives the time: when it advances, the arm steps, the world with it, and the hand in the world. So
one clock and one lock are enough. The devices speak the same protocols as when they run as programs of their own.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import math
import sys
import time
from collections.abc import Mapping
from typing import Any

import mujoco

from common.errors import RigError
from rig_simulation.command_line import CommandLine, failed, parse_options, port, positive, stop_on_signals
from rig_simulation.control_port import ControlPort, within
from rig_simulation.devices.reflex import program as reflex
from rig_simulation.devices.reflex.hand import PERIOD_S, SimulatedHand
from rig_simulation.devices.sunrise import program as sunrise
from rig_simulation.devices.sunrise.server import AT_ONCE_S, SunriseServer
from rig_simulation.faults.hand import HAND_FAULTS
from rig_simulation.faults.injection import add_option, switch_all
from rig_simulation.files import read_board, read_scene
from rig_simulation.world.clock import Clock
from rig_simulation.world.model import WorldDescription
from rig_simulation.world.parts import ArmJoints, HandPart
from rig_simulation.world.physics import Part, World

NAME = "world"
MOST_STEPS = 1000
STEPS_AT_ONCE = 20  # fewer than the arm catches up in one go


class WorldRequests:
    """The requests of the world's control port; `server`, of the arm, steps the world and holds its lock."""

    def __init__(self, world: World, server: SunriseServer, clock: Clock) -> None:
        self._world, self._server, self._clock = world, server, clock
        self._started, self._steps_at_start = time.monotonic(), world.steps
        names = ("state", "snapshot", "scene", "objects", "contacts", "set_scene", "step")
        requests = {"reset": world.reset, **{name: getattr(self, f"_{name}") for name in names}}
        self.handlers = {name: within(server.up_to_date, request) for name, request in requests.items()}

    def _state(self) -> dict[str, Any]:
        world = self._world
        passed = time.monotonic() - self._started
        return {
            "time": world.time,
            "steps": world.steps,
            "timestep": world.timestep,
            "stepped": self._clock.speed is None,
            "speed": self._clock.speed,
            "loads": world.loads,
            "contacts": int(world.data.ncon),
            "real_time_factor": (world.steps - self._steps_at_start) * world.timestep / passed,
        }

    def _snapshot(self) -> dict[str, Any]:
        world = self._world
        return {"time": world.time, "loads": world.loads, "qpos": world.data.qpos.tolist()}

    def _scene(self) -> dict[str, Any]:
        return {"loads": self._world.loads, **dataclasses.asdict(self._world.description)}

    def _objects(self) -> dict[str, Any]:
        listed = {name: dataclasses.asdict(state) for name, state in self._world.objects().items()}
        mounting = list(self._world.description.mounting)
        return {"time": self._world.time, "mounting": mounting, "objects": listed}

    def _contacts(self) -> dict[str, Any]:
        return {"contacts": self._world.contacts()}

    def _set_scene(self, scene: str | Mapping[str, Any]) -> dict[str, Any]:
        self._world.set_scene(read_scene(scene) if isinstance(scene, str) else scene)
        return {"loads": self._world.loads}

    def _step(self, count: int = 1) -> dict[str, Any]:
        if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MOST_STEPS:
            raise ValueError(f"The count of steps is {count!r}, but must be a whole number from 1 to {MOST_STEPS}.")
        while count > 0:
            self._clock.move(min(count, STEPS_AT_ONCE) * self._world.timestep)
            self._server.advance()
            count -= STEPS_AT_ONCE
        return {"time": self._world.time, "steps": self._world.steps}


class HandCycle(Part):
    """The network cycle of the hand, in world time."""

    def __init__(self, hand: SimulatedHand, link: reflex.HandLink) -> None:
        self._hand, self._link = hand, link
        self._cycles = 0

    def bind(self, world: World) -> None:
        """Takes the world, and computes its steps in a cycle."""
        self._world, self._period = world, round(PERIOD_S / world.timestep)

    def after_step(self) -> None:
        """Exchanges packets once in a cycle."""
        if self._world.steps // self._period > self._cycles:
            self._cycles += 1
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
    robot = options.robot, options.flange, tuple(options.mounting)
    world = World(WorldDescription(*robot, read_scene(options.scene), panel), options.seed)
    hand = HandPart(options.seed)
    world.add(hand)
    link = reflex.HandLink(options.interface, options.hand_port)
    resources.callback(link.close)
    world.add(HandCycle(hand.simulated, link))
    clock = Clock(None if options.stepped else options.speed)
    arm = ArmJoints(world, pairs=not options.stepped)
    server = sunrise.make_server(options, arm, clock, math.inf if options.stepped else AT_ONCE_S)
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
    add("--panel", nargs="?", const="single", help=board)
    add("--seed", type=int, default=0, help="seed of scattered objects, and of the hand's slack and noise")
    add("--speed", type=positive, default=1.0, help="seconds of the world in a second")
    add("--stepped", action="store_true", help="time stands still until the request `step` moves it")
    return parse_options(parser, arguments)
