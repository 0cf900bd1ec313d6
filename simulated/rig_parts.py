"""What stands for clocks, a bad link and the end of the ROS master where the rig is in virtual time."""

from __future__ import annotations

import contextlib
import math
import signal
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from campaign.network.link import CLEAR, Link
from common import clock
from common.ros import master
from simulated.graph import Graph, Node
from simulated.stand_in import MASTER_PORT
from simulated.wires import DELAY_S, Connection, Socket, Way


class WallClocks:
    """As campaign.clocks.ShiftedClock: the wall clocks of all nodes but the test's own."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._ahead: dict[str, float] = {}
        graph.scheduler.ahead = self._of

    def start(self) -> None:
        """Runs already."""

    def step(self, seconds: float, node: str = "all") -> None:
        """Sets the clocks of all nodes forwards by so much, or only that of one."""
        self._ahead[node] = self._ahead.get(node, 0.0) + seconds

    def _of(self, group: str) -> float:
        names = ("all", self._graph._by_group[group].name.lstrip("/")) if group else ()
        return sum(self._ahead.get(name, 0.0) for name in names)


class BadLink:
    """As campaign.network.wire.Wire: the link of the arm, or that of the Leap service.

    Packets that come twice, and a limited rate, are not modelled.

    Attributes:
        port: of the device."""

    def __init__(self, graph: Graph, name: str) -> None:
        self.name, self.port = name, 0
        self._scheduler, self._link = graph.scheduler, CLEAR
        self._ways: list[Way] = []
        self._packets, self._told = 0, {"packets": 0, "lost": 0}
        graph.wires.on_connect = self._take

    def set(self, link: Link) -> dict[str, int]:
        """Changes the link; returns how many packets came and how many were lost on it since the change before."""
        self._link = link
        for way in self._ways:
            self._worsen(way)
        total = {"packets": self._packets, "lost": sum(way.lost for way in self._ways)}
        new = {name: count - self._told[name] for name, count in total.items()}
        self._told = total
        return new

    def _take(self, connection: Connection) -> None:
        if connection.address[1] == self.port:
            for way in (connection.up, connection.down):
                self._ways.append(way)
                way.sent = self._count
                self._worsen(way)

    def _count(self, data: bytes, now: float) -> None:
        self._packets += 1

    def _worsen(self, way: Way) -> None:
        link, now = self._link, self._scheduler.now
        assert not link.duplicated and math.isinf(link.rate) and link.loss < 1.0, link
        way.worsen(DELAY_S + link.delay, link.jitter, link.loss, reordered=link.reordered)
        held = [(now, math.inf)] if link.held else []
        way.stalls = [(begin, min(end, now)) for begin, end in way.stalls] + held


class Core:
    """As campaign.worker.Core: the process of the master, which each node watches, and a row may end."""

    def __init__(self, graph: Graph, patch: pytest.MonkeyPatch) -> None:
        self._graph = graph
        patch.setattr(master, "watch", _WatchOfEachNode(graph))
        patch.setattr(master, "socket", SimpleNamespace(**{**vars(master.socket), "create_connection": self._reached}))
        patch.setattr(master, "select", SimpleNamespace(select=self._select))
        self.start()

    def start(self) -> None:
        """Starts it, without parameters; it knows the nodes that begin from now on."""
        self._graph.master_answers = True
        self._node: Node = self._graph.start("rosmaster", self._listen)

    def kill(self) -> None:
        """Ends it."""
        self._graph.master_answers = False
        self._graph.parameters.tree = {}
        for node in self._graph.nodes:
            node.is_known = False
        self._node.send_signal(signal.SIGKILL)

    @contextlib.contextmanager
    def hanging(self) -> Iterator[None]:
        """Lets it stand still for a while."""
        self._graph.master_hangs = True
        self._node.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self._graph.master_hangs = False
            self._node.send_signal(signal.SIGCONT)

    def _listen(self) -> None:
        listener = Socket(self._graph.wires)
        listener.bind(("localhost", MASTER_PORT))
        listener.listen()
        connections = []
        while True:
            connections.append(listener.accept())

    def _reached(self, address: tuple[str, int], timeout: float) -> Socket:
        return self._graph.wires.connect(address, timeout)

    def _select(self, reading: list[Socket], *_: Any) -> tuple[list[Socket], list[Socket], list[Socket]]:
        (connection,), timeout = reading, _[-1]
        ready = self._graph.wires.wait(connection.readable_at, reading, clock.monotonic() + timeout)
        return reading if ready else [], [], []


class _WatchOfEachNode:
    """common.ros.master.watch, of which each process has its own."""

    def __init__(self, graph: Graph) -> None:
        self.__dict__.update(_graph=graph, _of={})

    def __getattr__(self, name: str) -> Any:
        node = self._graph.here
        if node not in self._of:
            self._of[node] = master.MasterWatch()
        return getattr(self._of[node], name)
