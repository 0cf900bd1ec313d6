"""The whole rig in one process and in virtual time: its programs, devices on their wires, and a hand that a test moves.

    with Graph() as graph, VirtualRig(graph) as rig:
        rig.calm()
        rig.follow(right=-0.06)

It has the methods of campaign.rig.RigUnderTest, so rows of the campaign and tests of the safety run on both."""

from __future__ import annotations

import contextlib
import functools
import io
import itertools
import re
import runpy
import signal
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rospy

from campaign import rig as real
from campaign.arm_trace import ArmTrace
from campaign.clocks import SimulatedTime
from campaign.hand_puppet import HandPuppet
from campaign.network.headset import HeadsetPage, play
from campaign.trial import SHIFTED, SIMULATED, VARIANTS
from common import clock
from leap_rig.relay.client import PagePort, RelayClient
from leap_rig.relay.server import Relay
from rig_simulation.control_port import ControlClient
from rig_simulation.devices.leap.server import SimulatedLeapService
from rig_simulation.operator.sources import Playback
from simulated.event_loop import EventLoop
from simulated.graph import Graph, Node
from simulated.hand_wire import HandNetwork
from simulated.rig_parts import BadLink, Core, WallClocks
from vision.ros.stereo import web_node

LAUNCH = Path(real.__file__).with_name("rig.launch")
HOST = "127.0.0.1"
PORTS = itertools.count(20000)
NO_TLS = SimpleNamespace(server=lambda: None, fingerprint=lambda: "")  # which wires have not


class Hand(HandPuppet):
    """The hand, as campaign.hand_puppet.PuppetClient has it."""

    @property
    def seen(self) -> int:
        """How many frames with a hand were made so far."""
        return self.state()["seen"]

    @property
    def still(self) -> bool:
        """Whether the last movement is over."""
        return not self.state()["moving"]

    def close(self) -> None:
        """Has nothing to close."""


class VirtualRig(real.RigUnderTest):
    """A rig on a graph, a variant of campaign.trial.VARIANTS; what stands for the number of a process is its node."""

    exact = True

    def __init__(self, graph: Graph, variant: str = "shipped", **arguments: str) -> None:
        kind, _, wire = variant.partition("/")
        super().__init__(None, Path(), BadLink(graph, wire) if wire else None, **{**VARIANTS[kind], **arguments})
        self.graph, self._wait_until = graph, graph.wait_until
        self._resources = contextlib.ExitStack()
        self._programs: list[Any] = []
        if kind == SHIFTED:
            self.clock = WallClocks(graph)
        elif kind == SIMULATED:
            self.clock = SimulatedTime(Path())

    def __enter__(self) -> VirtualRig:
        try:
            self.bring_up()
        except BaseException:
            self._resources.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._resources.close()

    def bring_up(self) -> None:
        """Starts everything; waits until the arm is at home and the robot hand is steered."""
        enter = self._resources.enter_context
        enter(HandNetwork())
        self.core = Core(self.graph, enter(pytest.MonkeyPatch.context()))
        if self.clock is not None:
            self.clock.start()
        self.graph.on_log = lambda node, text: self.hear("rosout", f"{node}: {text}")
        self.hand = Hand()
        made: list[SimulatedLeapService] = []

        def serve() -> None:
            made.append(SimulatedLeapService(Playback(self.hand), HOST, 0, 0))
            made[0].run()

        tracker = self.graph.start("leapd", serve)
        leap = self.wait(lambda: made and made[0], "the Leap service")
        self._resources.callback(lambda: (leap.stop(), tracker.ended.wait(real.SOON_S)))  # else coroutines are left
        self.leap = ControlClient(HOST, leap.control_port)
        self.listen()
        robot, hand = next(PORTS), next(PORTS)
        self._arguments = {
            **{"leap_port": leap.port, "robot_port": next(PORTS), "robot_control_port": robot},
            **{"hand_port": next(PORTS), "hand_control_port": hand},
            **self._arguments,
        }
        if self._sees:
            self._arguments.update(world_port=next(PORTS), camera_control_port=next(PORTS))
        if self.wire is not None and self.wire.name == "afar":
            self._arguments.update(leap_port=next(PORTS), page_port=next(PORTS))
            enter(pytest.MonkeyPatch.context()).setattr(web_node, "own_certificate", lambda _: NO_TLS)
        elif self.wire is not None:
            self.wire.port = self._arguments[{"arm": "robot_port", "leap": "leap_port"}[self.wire.name]]
        self.launch()
        if "page_port" in self._arguments:
            self._connect_headset(str(leap.port))
        self.arm = ArmTrace(HOST, robot)
        self._resources.callback(self.arm.close)
        self.robot_hand = ControlClient(HOST, hand)
        self.wait(lambda: self.mode == "home", "the arm at home", real.START_S)
        if self._sees:
            self.camera = ControlClient(HOST, self._arguments["camera_control_port"])
            self.wait(lambda: self.count("ggcnn", "pictures") > 0, "the network's first image", real.START_S)
        self.wait(lambda: self.count("leap_hand", "commands_sent") > 0, "the robot hand to be steered", real.START_S)

    def _connect_headset(self, leap_port: str) -> None:
        """As in the real rig, but without TLS."""
        said: list[str] = []
        relay = Relay(b"key" * 16, {"headset": 0}, said.append)
        self.wire.port = relay.port
        target = {"headset": PagePort(self._arguments["page_port"])}
        client = RelayClient(f"ws://{HOST}:{relay.port}/rig", b"key" * 16, target, said.append)
        code = self.wait(lambda: re.search(r"next headset is (\d+)", self.log), "the code of the page", real.START_S)[1]
        page = HeadsetPage(code)
        page.on_drive = lambda: said.append("drives")
        self.graph.start("relay", relay.run)
        urls = f"ws://{HOST}:{leap_port}/v6.json", f"ws://{HOST}:{relay.pages['headset']}/hands"
        for name, running in (("relay_client", client.run()), ("headset", play(urls[0], page, urls[1]))):
            self.graph.start(name, functools.partial(EventLoop(self.graph.wires).run_until_complete, running))
        self.wait(lambda: "drives" in said, "the headset to drive", real.START_S)

    def launch(self, devices: bool = True) -> None:
        """Starts the nodes, and with `devices` the simulated arm and hand, by rig.launch."""
        arguments = {**self._arguments, "devices": str(devices).lower()}
        self._launch = self.graph.launch("", str(LAUNCH), **arguments)
        self._programs += self._launch.nodes

    def run_command(self, *command: str) -> Node:
        """Starts a program of the workspace, or a module."""
        if command[:2] == (sys.executable, "-m"):
            path = str(find_spec(command[2]).origin)
            node = self.graph.start(command[2], lambda: runpy.run_path(path, run_name="__main__"), *command[2:])
        else:
            assert command[0] == "rosrun", command
            node = self.graph.run(*command[1:])
        self._programs.append(node)
        return node

    def answer(self, text: str, *command: str) -> Any:
        """Lets a program end that asks and gets this text as its input; returns code and output."""
        node = self.run_command(*command)
        node.stdin = io.StringIO(text)
        self.finish(node, 90.0)
        return SimpleNamespace(returncode=node.returncode, stdout=node.log, stderr=node.log)

    def deaf(self, topic: str, node: str) -> Any:
        """Subscribes to a topic of a node, and never returns from a message."""
        over = clock.Event()
        subscriber = rospy.Subscriber(topic, rospy.AnyMsg, lambda _: over.wait())
        return SimpleNamespace(close=lambda: (subscriber.unregister(), over.set()))

    @contextlib.contextmanager
    def crowded(self, name: str) -> Iterator[None]:
        """Lets a node run now and then only, as on a processor that it shares with many programs."""
        node, over = self.pid(name), clock.Event()

        def share() -> None:
            while not over.is_set():
                node.send_signal(signal.SIGSTOP)
                clock.sleep(self.graph.scheduler.drawn(0.12))
                node.send_signal(signal.SIGCONT)
                clock.sleep(self.graph.scheduler.drawn(0.02))

        thread = clock.Thread(target=share, name="crowd", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    program = run_command

    def finish(self, process: Node, seconds: float = real.MOVE_S) -> str:
        """Waits until a program ends by itself, and returns what it printed."""
        process.wait(seconds)
        return process.log

    def end_program(self, process: Node) -> int:
        """Interrupts a program as Ctrl-C does and returns its exit code."""
        process.send_signal(signal.SIGINT)
        return process.wait(real.MOVE_S)

    def pids(self) -> dict[str, Any]:
        """Returns all nodes that run, by name."""
        running = {node.name: node for node in self.graph.nodes if node.group and node.initialized and self.runs(node)}
        return {name: node for name, node in running.items() if not node.shutting}

    def pid(self, name: str) -> Any:
        """Returns a node, None if it does not run."""
        return self.pids().get(f"/{name.lstrip('/')}")

    def runs(self, pid: Any) -> bool:
        """Returns whether a node runs."""
        return pid.returncode is None

    def kill(self, pid: Any, number: int) -> None:
        """Sends a signal to a node."""
        pid.send_signal(number)

    def suspend(self, name: str) -> None:
        """Lets a node stand still, as if it hung."""
        self.pid(name).send_signal(signal.SIGSTOP)

    def exit_code(self, name: str) -> int:
        """Waits until a node ends and returns its exit code."""
        nodes = [node for node in self._programs if node.name == f"/{name}"]
        return self._started.get(name, *nodes[-1:]).wait(real.MOVE_S)

    @property
    def log(self) -> str:
        """What all programs printed so far."""
        return "".join(self._said_by(node) for node in self._programs)

    @property
    def log_since_calm(self) -> str:
        """What of that they printed since the last `calm`."""
        return "".join(self._said_by(node)[self._marks.get(node, 0) :] for node in self._programs)

    def mark(self) -> None:
        """From now on `log_since_calm` counts."""
        self._marks = {node: len(self._said_by(node)) for node in self._programs}

    def _said_by(self, node: Node) -> str:
        """What a program printed, and roslaunch says of its end."""
        if node.returncode in (None, 0):
            return node.log
        return f"{node.log}[{node.name.lstrip('/')}-1] process has died [pid 1, exit code {node.returncode}]\n"
