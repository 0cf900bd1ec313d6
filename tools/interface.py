"""The page of the running graph: nodes, topics, services and frames, as they are while a launch file runs.

`python -m tools.interface` writes docs/reference/interface.md from the demo, with `--check` it compares the two, and
`python -m tools.interface vision camera.launch` prints the page of any launch file with its arguments.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import rosgraph
import rospy
import rosservice
from tf2_msgs.msg import TFMessage

from common.ports import free_port
from tools.reference import markdown
from tools.reference.sources import REFERENCE

PAGE = REFERENCE / "interface.md"
DEMO = ("leap_rig", "demo.launch")
START_S, STEADY_S, LIMIT_S = 25.0, 8.0, 120.0
"""A graph is complete after the first time, if it did not change for the second; the third is the longest wait [s]."""

NOISE = re.compile(r"/(rosout|rosout_agg|clock|tf2_.*)$|/(get_loggers|set_logger_level|tf2_frames)$")
ANONYMOUS = re.compile(r"_\d+_\d+$|^/rosout$")


@dataclass
class Graph:
    """Who publishes, subscribes and serves what: names without the leading slash, nodes in sets.

    Attributes:
        frames: child -> (parent, node that publishes it, whether it is static).
    """

    types: dict[str, str] = field(default_factory=dict)
    publishers: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    subscribers: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    services: dict[str, tuple[str, str]] = field(default_factory=dict)
    frames: dict[str, tuple[str, str, bool]] = field(default_factory=dict)


def demo_arguments() -> list[str]:
    """Returns the demo's arguments for a run without a screen on ports of its own."""
    tcp = ("robot_port", "robot_control_port", "hand_control_port", "leap_port", "leap_control_port", "world_port")
    ports = {name: free_port() for name in tcp}
    ports["hand_port"] = free_port(socket.SOCK_DGRAM)
    return ["rviz:=false", "gui:=false", *(f"{name}:={port}" for name, port in ports.items())]


def page(graph: Graph, package: str, file: str) -> str:
    """Returns the page of a graph."""
    nodes = sorted({n for names in [*graph.publishers.values(), *graph.subscribers.values()] for n in names})
    nodes = sorted({*nodes, *(node for _, node in graph.services.values())})
    topics = sorted({*graph.publishers, *graph.subscribers})
    return "\n".join([
        "# The running graph\n",
        f"<!-- Made by `python -m tools.interface` from the running {package} {file}; changes here are lost. -->\n",
        f"Nodes, topics, services and frames while `roslaunch {package} {file}` runs with the simulated devices, "
        "without RViz and panel; a test compares them with this page. On the real rig the nodes `operator`, "
        "`simulation_*` and `world_*` are missing, and all else is the same. Definitions of the types: "
        "[messages and services](messages.md).\n",
        "## Nodes\n",
        ", ".join(f"`{node}`" for node in nodes) + "\n",
        "## Topics\n",
        markdown.table(
            ["topic", "type", "published by", "subscribed by"],
            [
                [f"`{t}`", graph.types.get(t, ""), _nodes(graph.publishers, t), _nodes(graph.subscribers, t)]
                for t in topics
            ],
        ),
        "## Services\n",
        markdown.table(
            ["service", "type", "offered by"],
            [[f"`{name}`", kind, node] for name, (kind, node) in sorted(graph.services.items())],
        ),
        "## Frames\n",
        markdown.table(
            ["frame", "in", "published by"],
            [
                [f"`{child}`", f"`{parent}`", node + (", static" if static else "")]
                for child, (parent, node, static) in sorted(graph.frames.items())
            ],
        ),
    ])  # fmt: skip


class Observer:
    """Watches a ROS graph as a node of it."""

    def __init__(self) -> None:
        rospy.init_node("interface", anonymous=True, disable_signals=True)
        self._master = rosgraph.Master(rospy.get_name())
        self._frames: dict[str, tuple[str, str, bool]] = {}
        for topic in ("/tf", "/tf_static"):
            rospy.Subscriber(topic, TFMessage, self._take, callback_args=topic, queue_size=1000)

    def graph(self) -> Graph:
        """Returns the graph as it is now."""
        publishers, subscribers, services = self._master.getSystemState()
        graph = Graph(types={name.strip("/"): kind for name, kind in self._master.getTopicTypes()})
        for found, table in ((publishers, graph.publishers), (subscribers, graph.subscribers)):
            for name, nodes in found:
                seen = {node.strip("/") for node in nodes if self._counts(node)}
                if seen and not NOISE.search(name):
                    table[name.strip("/")] |= seen
        for name, nodes in services:
            if self._counts(nodes[0]) and not NOISE.search(name):
                with contextlib.suppress(rosservice.ROSServiceIOException):
                    graph.services[name.strip("/")] = (rosservice.get_service_type(name) or "", nodes[0].strip("/"))
        graph.frames = dict(self._frames)
        return graph

    def steady_graph(self) -> Graph:
        """Returns the graph once it is complete."""
        began = changed = time.monotonic()
        graph = self.graph()
        while time.monotonic() - began < LIMIT_S:
            time.sleep(1.0)
            newer = self.graph()
            if newer != graph:
                graph, changed = newer, time.monotonic()
            if time.monotonic() - began > START_S and time.monotonic() - changed > STEADY_S:
                break
        return graph

    def differences(self, package: str, file: str) -> str:
        """Returns how the page in the handbook differs from the graph, once they agree or the graph is complete."""
        expected, began = PAGE.read_text(), time.monotonic()
        while time.monotonic() - began < LIMIT_S:
            found = page(self.graph(), package, file)
            if found == expected:
                return ""
            time.sleep(1.0)
        lines = difflib.unified_diff(expected.splitlines(), found.splitlines(), "page", "graph", lineterm="", n=0)
        return "\n".join(lines)

    def _counts(self, node: str) -> bool:
        return node != rospy.get_name() and not ANONYMOUS.search(node)

    def _take(self, message: TFMessage, topic: str) -> None:
        node = message._connection_header["callerid"].strip("/")
        for transform in message.transforms:
            self._frames[transform.child_frame_id] = (transform.header.frame_id, node, topic == "/tf_static")


@contextlib.contextmanager
def running(package: str, file: str, arguments: list[str]) -> Iterator[None]:
    """Runs a launch file on a ROS master of its own, which this process then uses."""
    port = free_port()
    with tempfile.TemporaryDirectory() as folder:
        os.environ.update(ROS_MASTER_URI=f"http://localhost:{port}", ROS_HOSTNAME="localhost", ROS_LOG_DIR=folder)
        with open(Path(folder) / "launch.log", "wb") as log:
            launch = subprocess.Popen(
                ["roslaunch", "-p", str(port), package, file, *arguments],
                stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip
        try:
            while not rosgraph.is_master_online():
                if launch.poll() is not None:
                    raise SystemExit((Path(folder) / "launch.log").read_text())
                time.sleep(0.2)
            yield
        finally:
            launch.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                launch.wait(30.0)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(launch.pid, signal.SIGKILL)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tools.interface", description=__doc__.splitlines()[0])
    parser.add_argument("launch", nargs="*", help="package, launch file and its arguments; none: the demo")
    parser.add_argument("--check", action="store_true", help="compare the demo with the page in the handbook")
    options = parser.parse_args()
    package, file, *rest = options.launch or [*DEMO, *demo_arguments()]
    with running(package, file, rest):
        observer = Observer()
        if options.check:
            sys.exit(observer.differences(package, file) or 0)
        text = page(observer.steady_graph(), package, file)
    if options.launch:
        sys.stdout.write(text)
    else:
        PAGE.write_text(text)


def _nodes(of: dict[str, set[str]], topic: str) -> str:
    return ", ".join(sorted(of.get(topic, ())))


if __name__ == "__main__":
    main()
