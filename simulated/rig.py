"""The whole rig in one process and in virtual time: its programs, devices on their wires, and a hand that a test moves.

    with Graph() as graph, VirtualRig(graph) as rig:
        rig.calm()
        rig.follow(right=-0.06)

It has the methods of campaign.rig.RigUnderTest, so rows of the campaign and tests of the safety run on both.
"""

from __future__ import annotations

import contextlib
import itertools
import signal
from pathlib import Path
from typing import Any

import pytest

from campaign import rig as real
from campaign.arm_trace import ArmTrace
from campaign.hand_puppet import HandPuppet
from rig_simulation.control_port import ControlClient
from rig_simulation.operator.sources import Playback
from simulated.graph import Graph, Node
from simulated.hand_wire import HandNetwork
from simulated.leap_wire import LeapDevice

LAUNCH = Path(real.__file__).with_name("rig.launch")
HOST = "127.0.0.1"
PORTS = itertools.count(20000)


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
    """A rig on a graph; what stands for the number of a process is its node."""

    def __init__(self, graph: Graph, **arguments: str) -> None:
        super().__init__(None, Path(), **arguments)
        self.graph = graph
        self._resources = contextlib.ExitStack()
        self._programs: list[Any] = []

    def __enter__(self) -> VirtualRig:
        try:
            self.bring_up()
        except BaseException:
            self._resources.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.arm.close()
        self._resources.close()

    def bring_up(self) -> None:
        """Starts everything; waits until the arm is at home and the robot hand is steered."""
        enter = self._resources.enter_context
        enter(HandNetwork())
        self.graph.on_log = lambda node, text: self.hear("rosout", f"{node}: {text}")
        self.hand = Hand()
        made: list[LeapDevice] = []
        self.graph.start("leapd", lambda: made.append(LeapDevice(Playback(self.hand))) or made[0].run())
        leap = self.wait(lambda: made and made[0], "the Leap service")
        self.leap = ControlClient(HOST, leap.control_port)
        self.listen()
        robot, hand = next(PORTS), next(PORTS)
        self._arguments = {
            **{"leap_port": leap.port, "robot_port": next(PORTS), "robot_control_port": robot},
            **{"hand_port": next(PORTS), "hand_control_port": hand},
            **self._arguments,
        }
        self.launch()
        self.arm = ArmTrace(HOST, robot)
        self.robot_hand = ControlClient(HOST, hand)
        self.wait(lambda: self.mode == "home", "the arm at home", real.START_S)
        self.wait(lambda: self.count("leap_hand", "commands_sent") > 0, "the robot hand to be steered", real.START_S)

    def launch(self, devices: bool = True) -> None:
        """Starts the nodes, and with `devices` the simulated arm and hand, by rig.launch."""
        arguments = {**self._arguments, "devices": str(devices).lower()}
        self._launch = self.graph.launch("", str(LAUNCH), **arguments)
        self._programs += self._launch.nodes

    def start(self, name: str, **parameters: Any) -> None:
        """Starts a node again that has ended; `parameters` are those under kuka/ that are changed first."""
        self.set(**parameters)
        if name == real.CONTROLLER:
            self.mode = ""
        package, program = self.program_of(name)
        self._started[name] = self.run(package, program, f"__name:={name}")

    def run_command(self, *command: str) -> Node:
        """Starts a program of the workspace."""
        assert command[0] == "rosrun", command
        node = self.graph.run(*command[1:])
        self._programs.append(node)
        return node

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
        return nodes[-1].wait(real.MOVE_S)

    def wait(self, condition: Any, what: str, timeout: float = real.SOON_S) -> Any:
        """Waits until the condition is true and returns its value; fails the test if that takes too long."""
        try:
            return self.graph.wait_until(condition, timeout, what)
        except pytest.fail.Exception as failure:
            pytest.fail(f"{failure.msg}\n{self.situation}")

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
