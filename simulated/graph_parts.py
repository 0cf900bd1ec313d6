"""What a ROS graph in virtual time consists of: parameters, topics, services, and what its master answers."""

from __future__ import annotations

import contextlib
import copy
import io
import itertools
import traceback
import xmlrpc.client
from collections import deque
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import genpy
import rosgraph
import rospy

from common import clock
from common.ros.master import LOGGERS

if TYPE_CHECKING:
    from simulated.graph import Graph, Node

DELAY_S, CONNECT_S = 0.002, 0.01
"""Longest times of a message, and of the connection of a subscriber with a publisher."""


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


class GraphConnection:
    """One publisher's messages to one subscriber."""

    def __init__(self, graph: Graph, publisher: GraphPublisher, subscriber: GraphSubscriber) -> None:
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
        while self.publisher.node.group in self.graph.scheduler.suspended and not self.closed:
            clock.sleep(DELAY_S)
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


class GraphPublisher:
    def __init__(self, graph: Graph, node: Node, name: str, kind: type, latch: bool) -> None:
        self.graph, self.node, self.name, self.kind, self.latch = graph, node, name, kind, latch
        self.connections: list[GraphConnection] = []
        self.last: Any = None
        self.count, self.closed = itertools.count(1), False
        node.topics.append(self)
        graph.publishers.append(self)
        for subscriber in list(graph.subscribers):
            self.connect(subscriber)

    def connect(self, subscriber: GraphSubscriber) -> None:
        if subscriber.name != self.name or subscriber.closed or self.closed:
            return
        if subscriber.kind._type not in ("*", self.kind._type) or subscriber.kind._md5sum not in (
            "*",
            self.kind._md5sum,
        ):
            text = f"topic types do not match: [{subscriber.kind._type}] vs. [{self.kind._type}]"
            subscriber.node.say("ERROR", f"Unable to connect to {self.node.name}: {text}")
            return
        self.connections.append(GraphConnection(self.graph, self, subscriber))

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


class GraphSubscriber:
    def __init__(self, graph: Graph, node: Node, name: str, kind: type, queue_size: int | None) -> None:
        self.graph, self.node, self.name, self.kind, self.queue_size = graph, node, name, kind, queue_size
        self.callback: Callable[..., None] | None = None
        self.callback_args: Any = None
        self.closed = False
        node.topics.append(self)
        graph.subscribers.append(self)

    @property
    def connections(self) -> list[GraphConnection]:
        """Those over which messages come; as of rospy's topics, for actionlib."""
        everyone = (each for publisher in self.graph.publishers for each in publisher.connections)
        return [each for each in everyone if each.subscriber is self and each.open and not each.closed]

    @property
    def callbacks(self) -> list[tuple[Any, Any]]:
        """Those of all subscribers of the node to this topic, as rospy keeps them."""
        return [(each.callback, each.callback_args) for each in self._of_the_node()]

    def _of_the_node(self) -> list[GraphSubscriber]:
        found = (each for each in self.node.topics if isinstance(each, GraphSubscriber) and not each.closed)
        return [each for each in found if each.name == self.name]

    def connect(self) -> None:
        for publisher in list(self.graph.publishers):
            publisher.connect(self)

    def take(self, data: bytes, publisher: GraphPublisher) -> None:
        if self.closed or self.callback is None:
            return
        message = self._of_the_node()[0].kind()  # rospy has one connection of a topic, of the type that came first
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
                text = f"bad callback: {self.callback}\n{traceback.format_exc()}"
                if self.node.logs(SimpleNamespace(msg=text)):
                    self.node.say("ERROR", text)

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            self.graph.subscribers.remove(self)
            for publisher in list(self.graph.publishers):
                for connection in list(publisher.connections):
                    if connection.subscriber is self:
                        publisher.connections.remove(connection)
                        connection.close()


class GraphService:
    def __init__(self, graph: Graph, node: Node, name: str, kind: type, handler: Callable[[Any], Any]) -> None:
        self.graph, self.node, self.name, self.kind, self.handler = graph, node, name, kind, handler
        self.closed = False
        self._calls: list[clock.Event] = []  # that wait for an answer
        node.services.append(self)
        graph.services[name] = self

    def close(self) -> None:
        self.closed = True
        if self.graph.services.get(self.name) is self:
            del self.graph.services[self.name]

    def abandon(self) -> None:
        """The node has ended: nobody answers."""
        for answered in list(self._calls):
            answered.set()

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
        self._calls.append(answered)
        if self.node.returncode is None:
            answered.wait()
        self._calls.remove(answered)
        if not answer:
            raise rospy.ServiceException("transport error completing service call: the node has ended")
        if isinstance(answer[0], Exception):
            raise answer[0]
        return answer[0]


def _as_received(message: Any, kind: type) -> Any:
    buffer = io.BytesIO()
    message.serialize(buffer)
    return kind().deserialize(buffer.getvalue())


class GraphMaster:
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
        """The address of a node; raises rosgraph.MasterError if no node has that name."""
        resolved = self._graph.here.resolve(name)
        for number, each in reversed(list(enumerate(self._graph.nodes, 1))):
            if each.name == resolved and each.initialized and each.is_known and not each.shut:
                return f"http://localhost:{number}/"
        raise rosgraph.MasterError(f"unknown node [{resolved}]")

    def lookupService(self, name: str) -> str:
        """An address of the service; raises rosgraph.MasterError if nobody offers it."""
        resolved = self._graph.here.resolve(name)
        if resolved.endswith(LOGGERS):
            return self.lookupNode(resolved[: -len(LOGGERS)])
        if resolved not in self._graph.services:
            raise rosgraph.MasterError(f"no provider of [{resolved}]")
        return f"rosrpc://localhost{resolved}"

    def getParam(self, name: str) -> Any:
        """The value of a parameter; raises rosgraph.MasterError if it is not set."""
        try:
            return self._graph.parameters.get(self._graph.here.resolve(name))
        except KeyError as error:
            raise rosgraph.MasterError(f"Parameter [{name}] is not set") from error

    def getPid(self) -> int:
        """The number of its process."""
        return 1


class MasterProxy:
    """The same as rospy.get_master() has it: code, text and value of each answer; with `caller`, as xmlrpc has it."""

    def __init__(self, graph: Graph, caller: bool = False) -> None:
        self._graph, self._master, self._caller = graph, GraphMaster(graph), caller

    def __getattr__(self, name: str) -> Callable[..., tuple[int, str, Any]]:
        def ask(*args: Any) -> tuple[int, str, Any]:
            while self._graph.master_hangs:
                clock.sleep(DELAY_S)
            if not self._graph.master_answers:
                raise ConnectionRefusedError("no master")
            try:
                return 1, "", getattr(self._master, name)(*args[self._caller :])
            except rosgraph.MasterError as error:
                return -1, str(error), 0

        return ask


class NodeOutput(io.TextIOBase):
    """Where a node prints: its log."""

    def __init__(self, node: Node) -> None:
        self._node = node

    def write(self, text: str) -> int:
        """Adds to the log."""
        self._node.log += text
        return len(text)

    def reconfigure(self, **_: Any) -> None:
        """Takes what a program asks of its output."""
