"""A ROS graph in one process and in virtual time.

    with Graph(seed=1) as graph:
        node = graph.run("leap_hand", "leap_hand_node.py", "_hand_only:=true")
        commands = graph.record("reflex_takktile/radian_hand_command", RadianServoCommands)
        graph.wait_until(lambda: commands, 5.0, "a command")

A node is a group of threads. rospy's own classes and functions work on the graph while it is there, so tf2_ros and
message_filters do, too. As with rospy, a message is written to bytes by its publisher and read by each subscriber, in a
thread of its own; it takes up to DELAY_S, what is sent before the connection is there is lost, and a full queue loses
the oldest. The thread that made the graph is a node, /test.
"""

from __future__ import annotations

import contextlib
import copy
import importlib
import io
import itertools
import logging
import os
import re
import runpy
import shlex
import signal
import socket
import sys
import threading
import traceback
import xmlrpc.client
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import genpy
import message_filters
import pytest
import rosgraph
import rospy
import tf2_ros
import yaml

from common import clock
from common.ros import master, node, publishing, service_calls
from simulated.clock import virtual_time
from simulated.wires import Wires
from tools import launched

ROOT = Path(__file__).parents[1]
DELAY_S, CONNECT_S = 0.002, 0.01
"""Longest times of a message, and of the connection of a subscriber with a publisher."""
HANDSHAKE_S = 5.0  # after which a call gives up a node that stands still, see common.ros.service_calls
OWN, MASTER_PORT = "/test", 11311


class Node:
    """A node, or a program; looks to a test as a process does.

    Attributes:
        name: of the node, once it has one; before, that of the program.
        returncode: None while it runs.
        log: what it has printed and logged.
    """

    def __init__(self, graph: Graph, group: str, argv: list[str]) -> None:
        self.graph, self.group, self.argv, self.args = graph, group, argv, argv
        self.name = group
        self.mappings = dict(rosgraph.names.load_mappings(argv))
        self.namespace = rosgraph.names.make_global_ns(self.mappings.get("__ns", "/"))
        self.remaps: dict[str, str] = {}
        self.log = ""
        self.log_path, self.output = _Log(self), _Output(self)
        self.returncode: int | None = None
        self.initialized = self.shutting = self.shut = False
        self.hooks: list[Callable[[], None]] = []
        self.handlers: dict[int, Any] = {}
        self.topics: list[_Publisher | _Subscriber] = []
        self.services: list[_Service] = []
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

    def say(self, level: str, text: str) -> None:
        """Writes a line of the log."""
        self.log += f"[{level}] [{clock.time():.6f}]: {text}\n"

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


class Parameters:
    """The parameter server."""

    def __init__(self) -> None:
        self.tree: dict[str, Any] = {}

    def get(self, name: str) -> Any:
        """A value or the dictionary of a namespace; raises KeyError."""
        found: Any = self.tree
        for part in _parts(name):
            if not isinstance(found, dict) or part not in found:
                raise KeyError(name)
            found = found[part]
        return copy.deepcopy(found)

    def has(self, name: str) -> bool:
        """Whether it is there."""
        try:
            self.get(name)
        except KeyError:
            return False
        return True

    def set(self, name: str, value: Any) -> None:
        """Sets a value, or all values of a namespace; raises what it raises to send them to the master."""
        ((value,), _) = xmlrpc.client.loads(xmlrpc.client.dumps((value,)))
        parts = _parts(name)
        if not parts:
            self.tree = value
            return
        found = self.tree
        for part in parts[:-1]:
            if not isinstance(found.get(part), dict):
                found[part] = {}
            found = found[part]
        found[parts[-1]] = value

    def delete(self, name: str) -> None:
        """Removes it; raises KeyError."""
        self.get(name)
        *parts, last = _parts(name)
        found = self.tree
        for part in parts:
            found = found[part]
        del found[last]

    def names(self) -> list[str]:
        """All names of values."""

        def below(prefix: str, value: Any) -> Iterator[str]:
            if isinstance(value, dict) and value:
                for key, each in value.items():
                    yield from below(f"{prefix}/{key}", each)
            else:
                yield prefix

        return [name for key, value in self.tree.items() for name in below(f"/{key}", value)]

    def search(self, name: str, namespace: str) -> str | None:
        """The nearest name upwards of a namespace whose first part is there."""
        if name.startswith("/"):
            return name if self.has(name) else None
        parts = _parts(namespace)
        for count in range(len(parts), -1, -1):
            base = "/" + "/".join(parts[:count])
            if self.has(rosgraph.names.ns_join(base, _parts(name)[0])):
                return rosgraph.names.ns_join(base, name)
        return None


def _parts(name: str) -> list[str]:
    return [part for part in name.split("/") if part]


class _Connection:
    """One publisher's messages to one subscriber."""

    def __init__(self, graph: Graph, publisher: _Publisher, subscriber: _Subscriber) -> None:
        self.graph, self.publisher, self.subscriber = graph, publisher, subscriber
        self.open, self.closed = False, False
        self.callerid_pub = publisher.node.name
        self._messages: deque[tuple[float, bytes]] = deque()
        self._there = clock.Event()
        with graph.scheduler.in_group(subscriber.node.group):
            clock.Thread(target=self._run, name=f"reads {subscriber.name}", daemon=True).start()

    def put(self, data: bytes) -> None:
        """Takes a message of the publisher."""
        limit = self.subscriber.queue_size
        if limit is not None and len(self._messages) >= limit:
            self._messages.popleft()
        self._messages.append((self.graph.scheduler.now + self.graph.scheduler.drawn(DELAY_S), data))
        self._there.set()

    def close(self) -> None:
        """No more messages come; those that were sent are still read."""
        self.closed = True
        self._there.set()

    def _run(self) -> None:
        clock.sleep(self.graph.scheduler.drawn(CONNECT_S))
        if self.closed:
            return
        self.open = True
        if self.publisher.latch and self.publisher.last is not None:
            self.put(self.publisher.written(self.publisher.last))
        while not self.subscriber.closed:
            if not self._messages:
                if self.closed:
                    return
                self._there.clear()
                self._there.wait()
                continue
            due, data = self._messages[0]
            if due > self.graph.scheduler.now:
                clock.sleep(due - self.graph.scheduler.now)
            with contextlib.suppress(IndexError):  # a full queue lost it
                self.subscriber.take(self._messages.popleft()[1], self.publisher)


class _Publisher:
    def __init__(self, graph: Graph, node: Node, name: str, kind: type, latch: bool) -> None:
        self.graph, self.node, self.name, self.kind, self.latch = graph, node, name, kind, latch
        self.connections: list[_Connection] = []
        self.last: Any = None
        self.count, self.closed = itertools.count(1), False
        node.topics.append(self)
        graph.publishers.append(self)
        for subscriber in list(graph.subscribers):
            self.connect(subscriber)

    def connect(self, subscriber: _Subscriber) -> None:
        if subscriber.name != self.name or subscriber.closed or self.closed:
            return
        if subscriber.kind._type not in ("*", self.kind._type) or subscriber.kind._md5sum not in (
            "*",
            self.kind._md5sum,
        ):
            text = f"topic types do not match: [{subscriber.kind._type}] vs. [{self.kind._type}]"
            subscriber.node.say("ERROR", f"Unable to connect to {self.node.name}: {text}")
            return
        self.connections.append(_Connection(self.graph, self, subscriber))

    def written(self, message: Any) -> bytes:
        buffer = io.BytesIO()
        try:
            rospy.msg.serialize_message(buffer, next(self.count), message)
        except genpy.SerializationError as error:
            raise rospy.ROSSerializationException(str(error)) from error
        return buffer.getvalue()[4:]

    def has_connection(self, name: str) -> bool:
        """Whether a node hears it; as of rospy's topics, for actionlib."""
        return any(each.open and not each.closed for each in self.connections if each.subscriber.node.name == name)

    def publish(self, message: Any) -> None:
        if self.closed:
            return  # as rospy does after its shutdown
        self.last = message
        data = self.written(message)
        for connection in self.connections:
            if connection.open and not connection.closed:
                connection.put(data)

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            self.graph.publishers.remove(self)
            for connection in self.connections:
                connection.close()


class _Subscriber:
    def __init__(self, graph: Graph, node: Node, name: str, kind: type, queue_size: int | None) -> None:
        self.graph, self.node, self.name, self.kind, self.queue_size = graph, node, name, kind, queue_size
        self.callback: Callable[..., None] | None = None
        self.callback_args: Any = None
        self.closed = False
        node.topics.append(self)
        graph.subscribers.append(self)

    @property
    def connections(self) -> list[_Connection]:
        """Those over which messages come; as of rospy's topics, for actionlib."""
        everyone = (each for publisher in self.graph.publishers for each in publisher.connections)
        return [each for each in everyone if each.subscriber is self and each.open and not each.closed]

    @property
    def callbacks(self) -> list[tuple[Any, Any]]:
        """Those of all subscribers of the node to this topic, as rospy keeps them."""
        others = (each for each in self.node.topics if isinstance(each, _Subscriber) and not each.closed)
        return [(each.callback, each.callback_args) for each in others if each.name == self.name]

    def connect(self) -> None:
        for publisher in list(self.graph.publishers):
            publisher.connect(self)

    def take(self, data: bytes, publisher: _Publisher) -> None:
        if self.closed or self.callback is None:
            return
        message = self.kind()
        message.deserialize(data)
        message._connection_header = {
            "callerid": publisher.node.name,
            "topic": self.name,
            "type": publisher.kind._type,
            "md5sum": publisher.kind._md5sum,
            "latching": "1" if publisher.latch else "0",
            "message_definition": getattr(publisher.kind, "_full_text", ""),
        }
        try:
            self.callback(message, *([] if self.callback_args is None else [self.callback_args]))
        except Exception:
            if not self.node.shut:
                self.node.say("ERROR", f"bad callback: {self.callback}\n{traceback.format_exc()}")

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            self.graph.subscribers.remove(self)
            for publisher in self.graph.publishers:
                for connection in publisher.connections:
                    if connection.subscriber is self:
                        connection.close()


class _Service:
    def __init__(self, graph: Graph, node: Node, name: str, kind: type, handler: Callable[[Any], Any]) -> None:
        self.graph, self.node, self.name, self.kind, self.handler = graph, node, name, kind, handler
        self.closed = False
        node.services.append(self)
        graph.services[name] = self

    def close(self) -> None:
        self.closed = True
        if self.graph.services.get(self.name) is self:
            del self.graph.services[self.name]

    def _failed(self, text: str) -> rospy.ServiceException:
        return rospy.ServiceException(f"service [{self.name}] responded with an error: {text.encode()!r}")

    def call(self, request: Any, caller: str) -> Any:
        """Lets the node answer in a thread of its own, and waits for that."""
        answered, answer = clock.Event(), []

        def handle() -> None:
            clock.sleep(self.graph.scheduler.drawn(DELAY_S))
            given = _as_received(request, self.kind._request_class)
            given._connection_header = {"callerid": caller}
            try:
                response = rospy.impl.tcpros_service.convert_return_to_response(
                    self.handler(given), self.kind._response_class
                )
                answer.append(_as_received(response, self.kind._response_class))
            except rospy.ServiceException as error:
                answer.append(self._failed(f"service cannot process request: {error}"))
            except Exception as error:
                self.node.say("ERROR", f"Error processing request: {error}\n{traceback.format_exc()}")
                answer.append(self._failed(f"error processing request: {error}"))
            finally:
                answered.set()

        with self.graph.scheduler.in_group(self.node.group):
            clock.Thread(target=handle, name=f"answers {self.name}", daemon=True).start()
        answered.wait()
        if not answer:
            raise rospy.ServiceException("transport error completing service call: the node has ended")
        if isinstance(answer[0], Exception):
            raise answer[0]
        return answer[0]


def _as_received(message: Any, kind: type) -> Any:
    buffer = io.BytesIO()
    message.serialize(buffer)
    return kind().deserialize(buffer.getvalue())


class _Master:
    """What the ROS master answers about the graph, as rosgraph.Master returns or raises it."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph

    def getSystemState(self) -> list[list[list[Any]]]:
        """Topics with their publishers, topics with their subscribers, services with their nodes."""
        offered = self._graph.publishers, self._graph.subscribers, self._graph.services.values()
        return [
            [[name, sorted({e.node.name for e in kind if e.name == name})] for name in sorted({e.name for e in kind})]
            for kind in map(list, offered)
        ]

    def lookupNode(self, name: str) -> str:
        """An address of the node; raises rosgraph.MasterError if there is none of that name."""
        resolved = self._graph.here.resolve(name)
        for number, each in reversed(list(enumerate(self._graph.nodes, 1))):
            if each.name == resolved and each.initialized and not each.shut:
                return f"http://localhost:{number}/"
        raise rosgraph.MasterError(f"unknown node [{resolved}]")

    def lookupService(self, name: str) -> str:
        """An address of the service; raises rosgraph.MasterError if nobody offers it."""
        resolved = self._graph.here.resolve(name)
        if resolved not in self._graph.services:
            raise rosgraph.MasterError(f"no provider of [{resolved}]")
        return f"rosrpc://localhost{resolved}"

    def getParam(self, name: str) -> Any:
        """A parameter; raises rosgraph.MasterError if there is none of that name."""
        try:
            return self._graph.parameters.get(self._graph.here.resolve(name))
        except KeyError as error:
            raise rosgraph.MasterError(f"Parameter [{name}] is not set") from error

    def getPid(self) -> int:
        """The number of its process."""
        return 1


class _MasterProxy:
    """The same as rospy.get_master() has it: code, text and value of each answer; with `caller`, as xmlrpc has it."""

    def __init__(self, graph: Graph, caller: bool = False) -> None:
        self._graph, self._master, self._caller = graph, _Master(graph), caller

    def __getattr__(self, name: str) -> Callable[..., tuple[int, str, Any]]:
        def ask(*args: Any) -> tuple[int, str, Any]:
            if not self._graph.master_answers:
                raise ConnectionRefusedError("no master")
            try:
                return 1, "", getattr(self._master, name)(*args[self._caller :])
            except rosgraph.MasterError as error:
                return -1, str(error), 0

        return ask


class Graph:
    """The graph; a context, in which rospy works on it.

    Attributes:
        scheduler: its virtual time.
        nodes: all that were started.
        master_answers: whether a node that asks the master learns something; topics and services go on without.
    """

    def __init__(self, seed: int = 0, trace: bool = False) -> None:
        self.master_answers = True
        self.scheduler = virtual_time(seed, trace)
        self.wires = Wires(self.scheduler)
        self.parameters = Parameters()
        self.publishers: list[_Publisher] = []
        self.subscribers: list[_Subscriber] = []
        self.services: dict[str, _Service] = {}
        self.handles: list[Any] = []  # rospy's objects of the topics
        self.nodes: list[Node] = []
        self.numbers = itertools.count(1)
        self._by_group: dict[str, Node] = {}
        self._patch = pytest.MonkeyPatch()

    def __enter__(self) -> Graph:
        self.scheduler.__enter__()
        own = Node(self, "", ["test"])
        self._by_group[""] = own
        self.nodes.append(own)
        own.begin(OWN.lstrip("/"), False)
        stand_in(self, self._patch)
        return self

    def __exit__(self, *error: Any) -> None:
        try:
            self.scheduler.__exit__(*error)
        finally:
            self._patch.undo()
            for handle in self.handles:
                handle.impl = None  # whose owner may unregister it when it is destroyed

    @property
    def here(self) -> Node:
        """The node of the thread that asks."""
        return self._by_group[self.scheduler.current.group]

    def run(self, package: str, executable: str, *args: str) -> Node:
        """Starts a program of a package as rosrun does; returns it."""
        (script,) = ROOT.glob(f"src/**/{package}/scripts/{executable}")
        return self.start(executable, lambda: runpy.run_path(str(script), run_name="__main__"), str(script), *args)

    def launch(self, package: str, file: str, **args: Any) -> Launch:
        """Sets the parameters of a launch file, and starts its nodes."""
        loaded = launched.config(package, file, tuple(f"{key}:={value}" for key, value in args.items()))
        for name in loaded.clear_params:
            with contextlib.suppress(KeyError):
                self.parameters.delete(name)
        for name, parameter in loaded.params.items():
            self.parameters.set(name, parameter.value)
        nodes = []
        for each in loaded.nodes:
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


class _LogHandler(logging.Handler):
    LEVELS = (("WARNING", "WARN"), ("CRITICAL", "FATAL"))

    def __init__(self, graph: Graph) -> None:
        super().__init__()
        self._graph = graph

    def emit(self, record: logging.LogRecord) -> None:
        self._graph.here.say(dict(self.LEVELS).get(record.levelname, record.levelname), record.getMessage())


class _OfEachNode:
    """One object of a class of rospy's for each node; called in place of it, with what stands in its class anew."""

    def __init__(self, graph: Graph, kind: type) -> None:
        self._graph, self._kind = graph, kind
        self._objects: dict[Node, Any] = {}

    def __call__(self, *args: Any) -> Any:
        if self._graph.here not in self._objects:
            made = self._objects[self._graph.here] = self._kind()
            for name, value in vars(self._kind).items():
                if isinstance(value, (dict, set)):
                    setattr(made, name, type(value)())
        return self._objects[self._graph.here](*args)


class _Output(io.TextIOBase):
    """Where a node prints: its log."""

    def __init__(self, node: Node) -> None:
        self._node = node

    def write(self, text: str) -> int:
        """Adds to the log."""
        self._node.log += text
        return len(text)

    def reconfigure(self, **_: Any) -> None:
        """Takes what a program asks of its output."""


def stand_in(graph: Graph, patch: pytest.MonkeyPatch) -> None:
    """Lets rospy work on the graph."""
    scheduler = graph.scheduler

    real = sys.argv, sys.stdout, sys.stderr

    def turned(group: str) -> None:
        """Gives the thread what its process would have of its own."""
        nonlocal real
        if not isinstance(sys.stdout, _Output):
            real = sys.argv, sys.stdout, sys.stderr
        node = graph._by_group[group]
        sys.argv, sys.stdout, sys.stderr = (node.argv, node.output, node.output) if group else real

    scheduler.on_turn = turned
    log = logging.getLogger("rosout")
    handler = _LogHandler(graph)
    patch.setattr(log, "handlers", [handler])
    patch.setattr(log, "propagate", False)
    patch.setattr(log, "level", logging.INFO)
    patch.setattr(log, "filters", [])
    for name in ("throttle", "identical", "once"):  # each node remembers what it has logged, and forgets it
        kind = type(getattr(rospy.core, f"_logging_{name}"))
        patch.setattr(rospy.core, f"_logging_{name}", _OfEachNode(graph, kind))
    log.manager._clear_cache()
    # Time.
    patch.setattr(rospy.rostime, "time", SimpleNamespace(time=lambda: clock.time(), sleep=lambda s: clock.sleep(s)))
    patch.setattr(rospy.rostime, "_rostime_initialized", True)
    patch.setattr(rospy.rostime, "_rostime_current", None)
    for module in (rospy, rospy.timer):
        patch.setattr(module, "sleep", lambda d: clock.sleep(max(d.to_sec() if hasattr(d, "to_sec") else d, 0.0)))
    # Nodes.
    names = {
        "init_node": lambda name, *_, anonymous=False, **__: graph.here.begin(name, anonymous),
        "get_name": lambda: graph.here.name,
        "get_caller_id": lambda: graph.here.name,
        "get_namespace": lambda: graph.here.namespace,
        "resolve_name": lambda name, caller_id=None: graph.here.resolve(name, caller_id),
        "myargv": lambda argv=None: [
            w for w in (graph.here.argv if argv is None else argv) if not rosgraph.names.is_legal_remap(w)
        ],
        "is_shutdown": lambda: graph.here.shut,
        "is_shutdown_requested": lambda: graph.here.shutting,
        "is_initialized": lambda: graph.here.initialized,
        "signal_shutdown": lambda _reason: graph.here.shut_down(),
        "on_shutdown": lambda hook: graph.here.hooks.append(hook),
        "spin": lambda: graph.here.spun.wait(),
    }
    parameters = graph.parameters
    unset = object()

    def get_param(name: str, default: Any = unset) -> Any:
        try:
            return parameters.get(graph.here.resolve(name))
        except KeyError:
            if default is unset:
                raise KeyError(name) from None
            return default

    def delete_param(name: str) -> None:
        get_param(name)
        parameters.delete(graph.here.resolve(name))

    names.update(
        get_param=get_param,
        get_param_cached=get_param,
        get_param_names=parameters.names,
        set_param=lambda name, value: parameters.set(graph.here.resolve(name), value),
        has_param=lambda name: parameters.has(graph.here.resolve(name)),
        delete_param=delete_param,
        search_param=lambda name: parameters.search(name, graph.here.name),
    )

    def seconds(timeout: Any) -> float | None:
        return timeout.to_sec() if hasattr(timeout, "to_sec") else timeout

    def wait_for_service(name: str, timeout: Any = None) -> None:
        limit, resolved = seconds(timeout), graph.here.resolve(name)
        if limit == 0.0:
            raise ValueError("timeout must be non-zero")
        begun = scheduler.now
        while resolved not in graph.services:
            if graph.here.shut:
                raise rospy.ROSInterruptException("rospy shutdown")
            if limit is not None and scheduler.now - begun >= limit:
                raise rospy.ROSException(f"timeout exceeded while waiting for service {resolved}")
            clock.sleep(0.1)

    def wait_for_message(topic: str, kind: type, timeout: Any = None) -> Any:
        limit, found, begun = seconds(timeout), [], scheduler.now
        subscriber = rospy.Subscriber(topic, kind, found.append)
        try:
            while not graph.here.shut and not found:
                clock.sleep(0.01)
                if limit is not None and scheduler.now - begun >= limit:
                    raise rospy.ROSException(f"timeout exceeded while waiting for message on topic {topic}")
        finally:
            subscriber.unregister()
        if graph.here.shut:
            raise rospy.ROSInterruptException("rospy shutdown")
        return found[0]

    names.update(
        wait_for_service=wait_for_service,
        wait_for_message=wait_for_message,
        get_published_topics=lambda _="/": [[p.name, p.kind._type] for p in graph.publishers],
    )
    names["get_master"] = lambda *_: _MasterProxy(graph)
    for module in (rospy, rospy.core, rospy.names, rospy.client, rospy.impl.tcpros_service):
        for name, function in names.items():
            if hasattr(module, name):
                patch.setattr(module, name, function)
    for module in (rosgraph, rosgraph.masterapi):
        patch.setattr(module, "Master", lambda *_: _Master(graph))
    for module in (message_filters, tf2_ros.transform_listener):  # they call back while they hold their locks
        patch.setattr(module, "threading", clock)
    _topics(graph, patch)
    _services(graph, patch)
    _process(graph, patch)
    _timers_and_actions(patch)


def _topics(graph: Graph, patch: pytest.MonkeyPatch) -> None:
    def publisher(self, name, data_class, subscriber_listener=None, tcp_nodelay=False, latch=False, headers=None,
                  queue_size=None):  # fmt: skip
        self.name = self.resolved_name = graph.here.resolve(name)
        self.data_class, self.type, self.md5sum = data_class, data_class._type, data_class._md5sum
        self.impl = _Publisher(graph, graph.here, self.resolved_name, data_class, latch)
        graph.handles.append(self)

    def publish(self, *args, **kwds):
        if self.impl is None:
            raise rospy.ROSException("publish() to an unregistered() handle")
        self.impl.publish(rospy.msg.args_kwds_to_message(self.data_class, args, kwds))

    def subscriber(self, name, data_class, callback=None, callback_args=None, queue_size=None, buff_size=65536,
                   tcp_nodelay=False):  # fmt: skip
        self.name = self.resolved_name = graph.here.resolve(name)
        self.data_class, self.type, self.md5sum = data_class, data_class._type, data_class._md5sum
        self.callback, self.callback_args = callback, callback_args
        self.impl = _Subscriber(graph, graph.here, self.resolved_name, data_class, queue_size)
        self.impl.callback, self.impl.callback_args = callback, callback_args
        self.impl.connect()
        graph.handles.append(self)

    def unregister(self):
        if self.impl is not None:
            self.impl.close()
            self.impl = None

    def connections(self):
        if self.impl is None:
            return 0
        if isinstance(self.impl, _Publisher):
            return sum(each.open and not each.closed for each in self.impl.connections)
        return len(self.impl.connections)

    for kind, init in ((rospy.Publisher, publisher), (rospy.Subscriber, subscriber)):
        patch.setattr(kind, "__init__", init)
        patch.setattr(kind, "unregister", unregister)
        patch.setattr(kind, "get_num_connections", connections)
    patch.setattr(rospy.Publisher, "publish", publish)
    patch.setattr(
        publishing.DirectPublisher, "__init__",
        lambda self, name, kind, queue_size, latch=False: publisher(self, name, kind, latch=latch),
    )  # fmt: skip


def _services(graph: Graph, patch: pytest.MonkeyPatch) -> None:
    scheduler = graph.scheduler

    def service(self, name, service_class, handler, buff_size=65536, error_handler=None):
        self.resolved_name, self.service_class, self.handler = graph.here.resolve(name), service_class, handler
        self.request_class, self.response_class = service_class._request_class, service_class._response_class
        if any(each.name == self.resolved_name and not each.closed for each in graph.here.services):
            raise rospy.ServiceException(f"service [{self.resolved_name}] already registered")
        self.impl = _Service(graph, graph.here, self.resolved_name, service_class, handler)

    def proxy(self, name, service_class, persistent=False, headers=None):
        self.resolved_name, self.service_class = graph.here.resolve(name), service_class
        self.request_class, self.response_class = service_class._request_class, service_class._response_class
        self.transport = None

    def call(self, *args, **kwds):
        request = rospy.msg.args_kwds_to_message(self.request_class, args, kwds)
        offered = graph.services.get(self.resolved_name)
        if offered is None:
            raise rospy.ServiceException(f"service [{self.resolved_name}] unavailable")
        return offered.call(request, graph.here.name)

    def connected(self, proxy):
        offered = graph.services.get(proxy.resolved_name)
        if offered is None:
            raise service_calls.ServiceAbsent(self.name, "nobody offers it")
        begun = scheduler.now
        while offered.node.group in scheduler.suspended:
            if scheduler.now - begun >= HANDSHAKE_S:
                text = f"did not answer the handshake within {HANDSHAKE_S:g} s"
                raise service_calls.ServiceFailed(self.name, text, sent=False)
            clock.sleep(DELAY_S)
        return SimpleNamespace(close=lambda: None)

    patch.setattr(xmlrpc.client, "ServerProxy", lambda *_, **__: _MasterProxy(graph, caller=True))
    patch.setattr(rospy.Service, "__init__", service)
    patch.setattr(rospy.Service, "shutdown", lambda self, reason="": self.impl.close())
    patch.setattr(rospy.Service, "spin", lambda self: rospy.spin())
    patch.setattr(rospy.ServiceProxy, "__init__", proxy)
    patch.setattr(rospy.ServiceProxy, "call", call)
    patch.setattr(rospy.ServiceProxy, "close", lambda self: None)
    wait = lambda self, timeout=None: rospy.wait_for_service(self.resolved_name, timeout)  # noqa: E731
    patch.setattr(rospy.ServiceProxy, "wait_for_service", wait)
    patch.setattr(service_calls.ServiceClient, "connected", connected)
    patch.setattr(service_calls.ServiceClient, "look_up", lambda self: None)
    patch.setattr(service_calls._Attempt, "_hang_up", lambda self: None)

    def reached(address: tuple[str, int], timeout: float | None = None) -> contextlib.AbstractContextManager[None]:
        """As socket.create_connection, to the master or to the address that it tells of a node."""
        number = address[1]
        alive = 0 < number <= len(graph.nodes) and graph.nodes[number - 1].returncode is None
        if not (graph.master_answers if number == MASTER_PORT else alive):
            raise ConnectionRefusedError("nobody listens")
        return contextlib.nullcontext()

    patch.setenv("ROS_MASTER_URI", f"http://localhost:{MASTER_PORT}")
    patch.setattr(service_calls, "socket", SimpleNamespace(**{**vars(socket), "create_connection": reached}))


def _process(graph: Graph, patch: pytest.MonkeyPatch) -> None:
    """What common.ros.node does to the process of a node."""

    def leave(code: int) -> None:
        raise SystemExit(code)

    def exit_at_once(code: int) -> None:
        graph.here.end(code)
        raise SystemExit(code)

    def handle(number: int, handler: Any) -> Any:
        before = graph.here.handlers.get(number, signal.SIG_DFL)
        graph.here.handlers[number] = handler
        return before

    def report(args: Any) -> None:
        if graph.here.group:
            graph.here.log += f"Exception in thread {args.thread.name}:\n"
            graph.here.log += "".join(traceback.format_exception(args.exc_type, args.exc_value, args.exc_traceback))
        else:
            threading.excepthook(args)

    graph.scheduler.on_crash = report
    patch.setattr(os, "_exit", exit_at_once)
    patch.setattr(signal, "signal", handle)
    patch.setattr(sys, "setswitchinterval", lambda seconds: None)  # it is that of all nodes
    graph.wires.stand_in(patch)
    for name in ("prepare_process", "prepare_log", "end_closed_servers", "hide_closed_connections"):
        patch.setattr(node, name, lambda *_: None)
    patch.setattr(node, "leave_after_all_threads", leave)
    patch.setattr(master, "watch", SimpleNamespace(start=lambda: None, fault=None, lost=[]))


def _timers_and_actions(patch: pytest.MonkeyPatch) -> None:
    """What rospy and actionlib have of threads."""
    timer = rospy.timer.Timer
    own = type("Timer", (clock.Thread,), {name: vars(timer)[name] for name in ("__init__", "run", "shutdown")})
    for module in (rospy, rospy.timer):
        patch.setattr(module, "Timer", own)
    patch.setattr(rospy.timer, "time", clock)
    for name in ("action_client", "action_server", "simple_action_client", "simple_action_server"):
        module = importlib.import_module(f"actionlib.{name}")
        patch.setattr(module, "threading", clock)
        if hasattr(module, "time"):
            patch.setattr(module, "time", clock)
