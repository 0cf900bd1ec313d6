"""The program `world.py`: the simulated arm, the simulated hand and the objects between them in one physics.

The server of the arm drives the time: when it advances, the arm steps, the world with it, and the hand in the world. So
one clock and one lock are enough. Of several arms the first one drives; the others step with it, whose steps are their
clock. The devices speak the same protocols as when they run as programs of their own.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import functools
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco

from common import clock
from common.arms import arms_from
from common.command_line import CommandLine, failed, parse_options, port, positive, stop_on_signals
from common.errors import ConfigError, RigError
from common.ros.files import read_yaml
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
from rig_simulation.world.parts import ArmJoints, CarriedJoints, HandPart, named
from rig_simulation.world.physics import Part, World

NAME = "world"


class WorldRequests:
    """The requests of the world's control port; `server`, of the arm, steps the world and holds its lock."""

    def __init__(self, world: World, server: SunriseServer, pace: Clock) -> None:
        self._world, self._server, self._clock = world, server, pace
        self._started, self._steps_at_start = clock.monotonic(), world.steps
        names = ("state", "snapshot", "scene", "objects", "contacts", "set_scene", "step")
        requests = {"reset": world.reset, **{name: getattr(self, f"_{name}") for name in names}}
        self.handlers = {name: within(server.up_to_date, request) for name, request in requests.items()}

    def _state(self) -> dict[str, Any]:
        world = self._world
        passed = clock.monotonic() - self._started
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
        description = self._world.description
        where = {"mounting": list(description.mounting), "frame": description.frame}
        return {"time": self._world.time, **where, "objects": listed}

    def _contacts(self) -> dict[str, Any]:
        return {"contacts": self._world.contacts()}

    def _set_scene(self, scene: str | Mapping[str, Any]) -> dict[str, Any]:
        self._world.set_scene(read_scene(scene) if isinstance(scene, str) else scene)
        return {"loads": self._world.loads}

    def _step(self, count: int = 1) -> dict[str, Any]:
        most_steps = 1000
        steps_at_once = 20  # fewer than the arm catches up in one go
        if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= most_steps:
            raise ValueError(f"The count of steps is {count!r}, but must be a whole number from 1 to {most_steps}.")
        while count > 0:
            self._clock.move(min(count, steps_at_once) * self._world.timestep)
            self._server.advance()
            count -= steps_at_once
        return {"time": self._world.time, "steps": self._world.steps}


class HandCycle(Part):
    """The network cycle of the hand, in world time."""

    def __init__(self, hand: SimulatedHand, link: reflex.HandLink) -> None:
        self._hand, self._link = hand, link
        self._cycles = 0

    def bind(self, world: World) -> None:
        self._world, self._period = world, round(PERIOD_S / world.timestep)

    def after_step(self) -> None:
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
    arms = None if options.arms is None else read_yaml(options.arms)
    if arms is not None and any(options.mounting):
        raise ConfigError([f"--mounting is {list(options.mounting)} deg, but {options.arms} says how each arm stands."])
    robot = options.robot, options.flange, tuple(options.mounting)
    description = WorldDescription(*robot, read_scene(options.scene), panel, arms, options.panel_arm)
    world = World(description, options.seed)
    hands = {}
    for number, prefix in enumerate(description.placements):
        hands[prefix] = _Hand(world, _of_robot(options, description, prefix, number), prefix, resources)
    pace = Clock(None if options.stepped else options.speed)
    at_once = math.inf if options.stepped else AT_ONCE_S
    lock = clock.RLock()
    servers: dict[str, SunriseServer] = {}
    for number, prefix in enumerate(description.placements):
        own = _of_robot(options, description, prefix, number)
        name = named(prefix, sunrise.NAME)
        if not servers:
            driver = ArmJoints(world, not options.stepped, prefix)
            server = sunrise.make_server(own, driver, pace, at_once, lock, name)
        else:
            carried, steps = CarriedJoints(world, prefix), Clock(None)
            server = sunrise.make_server(own, carried, steps, at_once, lock, name)
            driver.carry(carried, functools.partial(_carry, server, steps))
        resources.callback(server.close)
        switch_all(server.faults, options.fault)
        servers[prefix] = server
    first, *others = servers.values()
    for hand in hands.values():
        hand.open_control(lock, resources)
    world_requests = WorldRequests(world, first, pace).handlers
    control = resources.enter_context(ControlPort(world_requests, options.host, options.world_port))
    threads = [clock.Thread(target=server.run, name="carried arm", daemon=True) for server in others]

    def stop() -> None:
        for server in servers.values():
            server.stop()

    stop_on_signals(stop)
    for prefix, server in servers.items():
        print(sunrise.ready_line(server, named(prefix, sunrise.NAME)), flush=True)
        print(hands[prefix].ready_line, flush=True)
    print(f"{NAME}: scene {options.scene}, control port {control.host}:{control.port}", flush=True)
    for thread in threads:
        thread.start()
    try:
        first.run()
    finally:
        stop()
        for thread in threads:
            thread.join()


def _carry(server: SunriseServer, steps: Clock, dt: float) -> None:
    """Steps an arm that is carried along: its time counts the steps of the arm that drives the time."""
    steps.move(dt)
    server.carry()


def _of_robot(
    options: argparse.Namespace, description: WorldDescription, prefix: str, number: int
) -> argparse.Namespace:
    """Returns the options of one of several robots: its own ports, mounting and seed."""
    if description.arms is None:
        return options
    values = dict(vars(options))
    for key in ("port", "control_port", "hand_port", "hand_control_port"):
        values[key] = values[key] and values[key] + number
    values["seed"] += number
    values["mounting"] = arms_from(description.arms).placements[prefix].rpy
    return argparse.Namespace(**values)


class _Hand:
    """A hand in the world, on its wire."""

    def __init__(self, world: World, options: argparse.Namespace, prefix: str, resources: contextlib.ExitStack) -> None:
        self._options, self._name = options, named(prefix, reflex.NAME)
        part = HandPart(options.seed, prefix)
        world.add(part)
        self._simulated = part.simulated
        self._link = reflex.HandLink(options.interface, options.hand_port)
        resources.callback(self._link.close)
        world.add(HandCycle(self._simulated, self._link))
        switch_all(self._link.faults, options.hand_fault)

    def open_control(self, lock: clock.RLock, resources: contextlib.ExitStack) -> None:
        """Opens its control port, whose requests hold the lock of the world."""
        requests = reflex.handlers(self._simulated, self._link, lock)
        control = ControlPort(requests, self._options.host, self._options.hand_control_port)
        self.ready_line = reflex.ready_line(self._link, resources.enter_context(control), self._name)


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
    add(
        "--panel-arm", default="", metavar="NAME", help="with --arms: the arm that holds the marker board, such as left"
    )
    several = "yaml file of several arms, as of the parameter arms; each has the ports of the one before and 1"
    add("--arms", type=Path, help=several)
    add("--seed", type=int, default=0, help="seed of scattered objects, and of the hand's slack and noise")
    add("--speed", type=positive, default=1.0, help="seconds of the world in a second")
    add("--stepped", action="store_true", help="time stands still until the request `step` moves it")
    return parse_options(parser, arguments)
