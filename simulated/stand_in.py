"""Lets rospy, and what stands on it, work on a graph in virtual time: methods and functions of theirs are replaced."""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import signal
import socket
import sys
import threading
import traceback
import xmlrpc.client
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import message_filters
import pytest
import rosgraph
import rospy
import tf2_ros

from common import clock
from common.ros import master, node, publishing, service_calls
from leap_kuka.ros.hand_to_arm import DelayMonitor
from simulated.graph_parts import (
    DELAY_S,
    GraphMaster,
    GraphPublisher,
    GraphService,
    GraphSubscriber,
    MasterProxy,
    NodeOutput,
)  # fmt: skip

if TYPE_CHECKING:
    from simulated.graph import Graph, Node

HANDSHAKE_S = 5.0  # after which a call gives up a node that stands still, see common.ros.service_calls
MASTER_PORT = 11311


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


def stand_in(graph: Graph, patch: pytest.MonkeyPatch) -> None:
    """Lets rospy work on the graph."""
    scheduler = graph.scheduler

    real = sys.argv, sys.stdin, sys.stdout, sys.stderr

    def turned(group: str) -> None:
        """Gives the thread what its process would have of its own."""
        nonlocal real
        if not isinstance(sys.stdout, NodeOutput):
            real = sys.argv, sys.stdin, sys.stdout, sys.stderr
        node = graph._by_group[group]
        own = node.argv, node.stdin, node.output, node.output
        sys.argv, sys.stdin, sys.stdout, sys.stderr = own if group else real
        rospy.rostime._rostime_current = node.ros_time

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
    names.update({**_parameters(graph), **_waits(graph)}, get_master=lambda *_: MasterProxy(graph))
    for module in (rospy, rospy.core, rospy.names, rospy.client, rospy.impl.tcpros_service):
        for name, function in names.items():
            if hasattr(module, name):
                patch.setattr(module, name, function)
    for module in (rosgraph, rosgraph.masterapi):
        patch.setattr(module, "Master", lambda *_: GraphMaster(graph))
    for module in (message_filters, tf2_ros.transform_listener):  # they call back while they hold their locks
        patch.setattr(module, "threading", clock)
    _topics(graph, patch)
    _services(graph, patch)
    _process(graph, patch)
    _timers_and_actions(patch)


def _parameters(graph: Graph) -> dict[str, Any]:
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

    functions = {
        "get_param": get_param,
        "get_param_cached": get_param,
        "get_param_names": parameters.names,
        "set_param": lambda name, value: parameters.set(graph.here.resolve(name), value),
        "has_param": lambda name: parameters.has(graph.here.resolve(name)),
        "delete_param": delete_param,
        "search_param": lambda name: parameters.search(name, graph.here.name),
    }
    return {name: _asked(graph, function) for name, function in functions.items()}


def _asked(graph: Graph, function: Callable[..., Any]) -> Callable[..., Any]:
    """Returns a function that asks the master first, and so waits while that hangs."""

    def ask(*args: Any, **named: Any) -> Any:
        while graph.master_hangs:
            clock.sleep(DELAY_S)
        return function(*args, **named)

    return ask


def _waits(graph: Graph) -> dict[str, Any]:
    """rospy's functions that wait for others or ask for what there is."""
    scheduler = graph.scheduler

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

    return {
        "wait_for_service": wait_for_service,
        "wait_for_message": wait_for_message,
        "get_published_topics": lambda _="/": [[p.name, p.kind._type] for p in graph.publishers],
    }


def _topics(graph: Graph, patch: pytest.MonkeyPatch) -> None:
    def publisher(self, name, data_class, subscriber_listener=None, tcp_nodelay=False, latch=False, headers=None,
                  queue_size=None):  # fmt: skip
        self.name = self.resolved_name = graph.here.resolve(name)
        self.data_class, self.type, self.md5sum = data_class, data_class._type, data_class._md5sum
        self.impl = GraphPublisher(graph, graph.here, self.resolved_name, data_class, latch)
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
        self.impl = GraphSubscriber(graph, graph.here, self.resolved_name, data_class, queue_size)
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
        if isinstance(self.impl, GraphPublisher):
            return sum(each.open and not each.closed for each in self.impl.connections)
        return len(self.impl.connections)

    for kind, init in ((rospy.Publisher, publisher), (rospy.Subscriber, subscriber)):
        patch.setattr(kind, "__init__", _asked(graph, init))
        patch.setattr(kind, "unregister", _asked(graph, unregister))
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
        self.impl = GraphService(graph, graph.here, self.resolved_name, service_class, handler)

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

    patch.setattr(xmlrpc.client, "ServerProxy", lambda *_, **__: MasterProxy(graph, caller=True))
    patch.setattr(rospy.Service, "__init__", service)
    patch.setattr(rospy.Service, "shutdown", lambda self, reason="": self.impl.close())
    patch.setattr(rospy.Service, "spin", lambda self: rospy.spin())
    patch.setattr(rospy.ServiceProxy, "__init__", proxy)
    patch.setattr(rospy.ServiceProxy, "call", call)
    patch.setattr(rospy.ServiceProxy, "close", lambda self: None)
    wait = lambda self, timeout=None: rospy.wait_for_service(self.resolved_name, timeout)  # noqa: E731
    patch.setattr(rospy.ServiceProxy, "wait_for_service", wait)
    patch.setattr(service_calls.ServiceClient, "connected", connected)
    patch.setattr(service_calls.ServiceClient, "look_up", lambda self: graph.here.resolve(self.name) in graph.services)
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
    patch.setattr(DelayMonitor, "_looked", {})  # it is that of one process
    patch.setattr(node, "prepare_log", lambda: setattr(graph.here, "logs", node.RepeatedExceptions().filter))
    for name in ("prepare_process", "end_closed_servers", "hide_closed_connections"):
        patch.setattr(node, name, lambda *_: None)
    patch.setattr(node, "leave_after_all_threads", leave)
    patch.setattr(master, "check_host", lambda: None)
    patch.setattr(master, "check_log_folder", lambda: Path("/"))
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
