"""A ROS graph in one process and in virtual time.

    with Graph(seed=1) as graph:
        node = graph.run("leap_hand", "leap_hand_node.py", "_hand_only:=true")
        commands = graph.record("reflex_takktile/radian_hand_command", RadianServoCommands)
        graph.wait_until(lambda: commands, 5.0, "a command")

A node is a group of threads. rospy's own classes and functions work on the graph while it is there, so tf2_ros and
message_filters do, too. As with rospy, a message is written to bytes by its publisher and read by each subscriber, in a
thread of its own; it takes up to DELAY_S, what is sent before the connection is there is lost, and a full queue loses
the oldest. The thread that made the graph is a node, /test."""

from __future__ import annotations

import contextlib
import io
import itertools
import re
import runpy
import shlex
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rosgraph
import rospy
import yaml
from rosgraph_msgs.msg import Clock

from common import clock
from simulated.clock import virtual_time
from simulated.graph_parts import GraphPublisher, GraphService, GraphSubscriber, NodeOutput, Parameters
from simulated.stand_in import stand_in
from simulated.wires import Wires
from tools import launched

ROOT = Path(__file__).parents[1]
OWN = "/test"
FOREIGN = {"robot_state_publisher", "rviz", "tf2_ros"}


class Node:
    """A node, or a program; looks to a test as a process does.

    Attributes:
        name: of the node, once it has one; before, that of the program.
        returncode: None while it runs.
        log: what it has printed and logged."""

    def __init__(self, graph: Graph, group: str, argv: list[str]) -> None:
        self.graph, self.group, self.argv, self.args = graph, group, argv, argv
        self.name = group
        self.mappings = dict(rosgraph.names.load_mappings(argv))
        self.namespace = rosgraph.names.make_global_ns(self.mappings.get("__ns", "/"))
        self.remaps: dict[str, str] = {}
        self.log = ""
        self.log_path, self.output = _Log(self), NodeOutput(self)
        self.returncode: int | None = None
        self.initialized = self.shutting = self.shut = False
        self.logs: Callable[[Any], bool] = lambda record: True  # which of its log; see stand_in
        self.is_known = True  # to the master, which may have been started anew
        self.ros_time: rospy.Time | None = None  # if it is simulated
        self.stdin = io.StringIO()
        self.hooks: list[Callable[[], None]] = []
        self.handlers: dict[int, Any] = {}
        self.topics: list[GraphPublisher | GraphSubscriber] = []
        self.services: list[GraphService] = []
        self.ended, self.spun = clock.Event(), clock.Event()

    def resolve(self, name: str, node: str | None = None) -> str:
        """The whole name of a topic, service or parameter, to this node or one of another name."""
        node = node or (self.name if name.startswith("~") else rosgraph.names.ns_join(self.namespace, "x"))
        if not name:
            return rosgraph.names.namespace(node)
        name = rospy.names.canonicalize_name(name)
        if name.startswith("~"):
            resolved = rosgraph.names.ns_join(node, name[1:])
        else:
            resolved = name if name.startswith("/") else rosgraph.names.namespace(node) + name
        return self.remaps.get(resolved, resolved)

    def begin(self, name: str, anonymous: bool) -> None:
        """It has its name."""
        base = self.mappings.get("__name", f"{name}_{next(self.graph.numbers)}" if anonymous else name)
        self.name = rosgraph.names.ns_join(self.namespace, base)
        self.remaps = {self.resolve(a): self.resolve(b) for a, b in self.mappings.items() if not a.startswith("_")}
        for word in self.argv[1:]:
            if rosgraph.names.is_legal_remap(word) and re.match(r"_[^_]", word):
                key, _, value = word.partition(":=")
                self.graph.parameters.set(self.resolve(f"~{key[1:]}"), yaml.safe_load(value))
        for other in self.graph.nodes:
            if other is not self and other.name == self.name and other.returncode is None:
                other.say("WARN", f"shutdown request: [{self.name}] Reason: new node registered with same name")
                other.interrupt()
        self.initialized = True
        if self.graph.parameters.tree.get("use_sim_time"):
            self._take_time(Clock())
            rospy.Subscriber("/clock", Clock, self._take_time)

    def _take_time(self, message: Clock) -> None:
        self.ros_time = rospy.rostime._rostime_current = message.clock

    def say(self, level: str, text: str) -> None:
        """Writes a line of the log."""
        self.log += f"[{level}] [{clock.time():.6f}]: {text}\n"
        self.graph.on_log(self.name, text)

    def shut_down(self) -> None:
        """As rospy.signal_shutdown: callbacks first, then the topics close."""
        if self.shutting:
            return
        self.shutting = True
        for hook in self.hooks:
            try:
                hook()
            except (Exception, SystemExit):
                self.log += traceback.format_exc()
        self.shut = True
        self.close()
        self.spun.set()

    def close(self) -> None:
        """Closes topics and services."""
        for offered in [*self.topics, *self.services]:
            offered.close()

    def interrupt(self) -> None:
        """As a signal does."""
        with self.graph.scheduler.in_group(self.group):
            clock.Thread(target=self.shut_down, name="shutdown", daemon=True).start()

    def send_signal(self, number: int) -> None:
        """SIGINT and SIGTERM shut it down, SIGKILL ends it at once; SIGSTOP and SIGCONT as for a process."""
        if self.returncode is not None:
            return
        if number == signal.SIGSTOP:
            self.graph.scheduler.suspended.add(self.group)
        elif number == signal.SIGCONT:
            self.graph.scheduler.suspended.discard(self.group)
        elif number == signal.SIGKILL:
            self.close()
            self.end(-number)
        elif self.handlers.get(number, signal.default_int_handler) not in (
            signal.SIG_DFL, signal.SIG_IGN, signal.default_int_handler,
        ):  # fmt: skip
            with self.graph.scheduler.in_group(self.group):
                clock.Thread(target=self.handlers[number], args=(number, None), name="signal", daemon=True).start()
        else:
            self.interrupt()

    def end(self, code: int) -> None:
        """It has ended: its threads do, too."""
        if self.returncode is None:
            self.returncode = code
            self.close()
            self.ended.set()
            self.graph.scheduler.kill(self.group)
            for service in self.services:
                service.abandon()
            self.graph.wires.end(self.group)

    def poll(self) -> int | None:
        """The exit code, None while it runs."""
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Waits for its end; returns the exit code."""
        if not self.ended.wait(timeout):
            pytest.fail(f"{self.name} has not ended within {timeout} s")
        return self.returncode


class _Log:
    """The file to which the output of a program would go."""

    def __init__(self, node: Node) -> None:
        self._node = node

    def read_text(self, encoding: str = "utf-8", errors: str = "strict") -> str:
        """What the program has said."""
        return self._node.log

    def read_bytes(self) -> bytes:
        """The same as bytes."""
        return self._node.log.encode()


class Graph:
    """The graph; a context, in which rospy works on it.

    Attributes:
        scheduler: its virtual time.
        nodes: all that were started.
        on_log: called with the name of a node and each sentence that it logs.
        master_answers: whether a node that asks the master learns something; topics and services go on without.
        master_hangs: whether the answer does not come."""

    def __init__(self, seed: int = 0, trace: bool = False) -> None:
        self.master_answers, self.master_hangs = True, False
        self.scheduler = virtual_time(seed, trace)
        self.wires = Wires(self.scheduler)
        self.parameters = Parameters()
        self.publishers: list[GraphPublisher] = []
        self.subscribers: list[GraphSubscriber] = []
        self.services: dict[str, GraphService] = {}
        self.handles: list[Any] = []  # rospy's objects of the topics
        self.nodes: list[Node] = []
        self.numbers = itertools.count(1)
        self.on_log: Callable[[str, str], None] = lambda node, text: None
        self._by_group: dict[str, Node] = {}
        self._patch = pytest.MonkeyPatch()

    def __enter__(self) -> Graph:
        self.scheduler.__enter__()
        try:
            own = Node(self, "", ["test"])
            self._by_group[""] = own
            self.nodes.append(own)
            own.begin(OWN.lstrip("/"), False)
            stand_in(self, self._patch)
        except BaseException:
            self.__exit__(*sys.exc_info())
            raise
        return self

    def __exit__(self, *error: Any) -> None:
        try:
            self.scheduler.__exit__(*error)
        finally:
            self._patch.undo()
            for handle in self.handles:
                handle.impl = None  # whose owner may unregister it when it is destroyed
            self.wires.forget()

    @property
    def here(self) -> Node:
        """The node of the thread that asks."""
        return self._by_group[self.scheduler.current.group]

    def run(self, package: str, executable: str, *args: str) -> Node:
        """Starts a program of a package as rosrun does; returns it."""
        (script,) = ROOT.glob(f"src/**/{package}/scripts/{executable}")
        return self.start(executable, lambda: runpy.run_path(str(script), run_name="__main__"), str(script), *args)

    def launch(self, package: str, file: str, **args: Any) -> Launch:
        """Sets the parameters of a launch file, and starts its nodes; without a package, `file` is its path. Those that
        are not this project's, such as RViz and robot_state_publisher, are no Python, and are left out."""
        loaded = launched.config(package, file, tuple(f"{key}:={value}" for key, value in args.items()))
        for name in loaded.clear_params:
            with contextlib.suppress(KeyError):
                self.parameters.delete(name)
        for name, parameter in loaded.params.items():
            self.parameters.set(name, parameter.value)
        nodes = []
        for each in loaded.nodes:
            if each.package in FOREIGN:
                continue
            remaps = [f"{a}:={b}" for a, b in each.remap_args]
            words = [f"__name:={each.name}", f"__ns:={each.namespace}", *shlex.split(each.args), *remaps]
            nodes.append(self.run(each.package, each.type, *words))
        return Launch(nodes)

    def start(self, name: str, main: Callable[[], object], *argv: str) -> Node:
        """Runs a function as the main thread of a node."""
        group = f"{name} {next(self.numbers)}"
        started = Node(self, group, list(argv))
        self._by_group[group] = started
        self.nodes.append(started)

        def run() -> None:
            try:
                main()
                code = 0
            except SystemExit as exit:
                code = exit.code if isinstance(exit.code, int) else int(exit.code is not None)
                if isinstance(exit.code, str):
                    started.log += f"{exit.code}\n"
            except Exception:
                if started.returncode is not None:
                    return  # it was killed: what its ends raise is nobody's
                started.log += traceback.format_exc()
                code = 1
            started.shut_down()
            started.end(code)

        with self.scheduler.in_group(group):
            clock.Thread(target=run, name=name, daemon=True).start()
        return started

    def record(self, topic: str, kind: type) -> Recording:
        """A list that grows by every message on a topic."""
        messages = Recording(self)
        rospy.Subscriber(topic, kind, messages.append)
        return messages

    def names(self, name: str) -> dict[str, set[str]]:
        """The topics that a node publishes and hears, and its services, but for its own and those of every node."""
        found = {
            "publishes": {topic.name for topic in self.publishers if topic.node.name == name},
            "hears": {topic.name for topic in self.subscribers if topic.node.name == name},
            "offers": {service.name for service in self.services.values() if service.node.name == name},
        }
        return {kind: {n for n in names if n != "/rosout" and not n.startswith(name)} for kind, names in found.items()}

    def wait_until(self, condition: Callable[[], Any], timeout: float, what: str, poll: float = 0.02) -> Any:
        """Waits until the condition returns something true, and returns that; fails the test after `timeout` [s]."""
        deadline = self.scheduler.now + timeout
        while True:
            result = condition()
            if result:
                return result
            if self.scheduler.now >= deadline:
                said = "".join(f"\n{each.name} (ended: {each.returncode}):\n{each.log[-2000:]}" for each in self.nodes)
                pytest.fail(f"waited {timeout:g} s in vain for {what}{said}")
            clock.sleep(poll)


class Launch:
    """The nodes of a launch file; looks to a test as the process of roslaunch does."""

    def __init__(self, nodes: list[Node]) -> None:
        self.nodes, self.log_path = nodes, self

    def read_text(self, encoding: str = "utf-8", errors: str = "strict") -> str:
        """What the nodes have said."""
        return "".join(each.log for each in self.nodes)

    def poll(self) -> int | None:
        """None while a node runs, then 0."""
        return None if any(each.poll() is None for each in self.nodes) else 0

    def send_signal(self, number: int) -> None:
        """Sends it to each node."""
        for each in self.nodes:
            each.send_signal(number)


class Recording(list):
    """Messages in the order of their arrival."""

    def __init__(self, graph: Graph) -> None:
        super().__init__()
        self._graph = graph

    def wait(self, count: int = 1, timeout: float = 15.0) -> Recording:
        """Waits until `count` messages came in."""
        self._graph.wait_until(lambda: len(self) >= count, timeout, f"{count} messages (came: {len(self)})")
        return self
