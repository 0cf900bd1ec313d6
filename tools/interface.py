"""The page of the running graph: nodes, topics, services and frames, as they are while launch files run.

`python -m tools.interface` writes docs/reference/interface.md, with `--check` it compares the page with the graphs, and
`python -m tools.interface vision camera.launch` prints the page of any launch file with its arguments.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import re
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Collection
from dataclasses import dataclass, field

import rosgraph
import rospy
import rosservice
from tf2_msgs.msg import TFMessage

from tools.reference import markdown
from tools.reference.sources import REFERENCE
from tools.running_parts import PARTS, Part, running

PAGE = REFERENCE / "interface.md"
START_S, STEADY_S, LIMIT_S = 150.0, 20.0, 300.0
"""A graph is complete after the first time, if it did not change for the second; the third is the longest wait [s]."""

NOISE = re.compile(r"/(rosout|rosout_agg|clock|tf2_.*)$|/(get_loggers|set_logger_level|tf2_frames)$")
ANONYMOUS = re.compile(r"_\d+_\d+$|^/rosout$")
HEAD = """# The running graph

<!-- Made by `python -m tools.interface` from running launch files; changes here are lost. -->

Nodes, topics, services and frames while these run with the simulated devices; a test compares them with this page.
On the real rig the nodes `operator`, `camera_truth`, `simulation_*` and `world_*` are missing, and all else is the
same. Definitions of the types: [messages and services](messages.md).
"""


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

    @property
    def nodes(self) -> set[str]:
        """All nodes."""
        pairs = [*self.publishers.values(), *self.subscribers.values(), {node for _, node in self.services.values()}]
        return {node for nodes in pairs for node in nodes}


def section(graph: Graph, part: Part, known: Collection[str] = ()) -> str:
    """Returns a graph's section of the page.

    Args:
        graph: what runs.
        part: what was started.
        known: nodes and lines of tables that another section has; they are left out.
    """
    topics = sorted({*graph.publishers, *graph.subscribers})
    tables = {
        "Topics": (
            ["topic", "type", "published by", "subscribed by"],
            [
                [f"`{t}`", graph.types.get(t, ""), _nodes(graph.publishers, t), _nodes(graph.subscribers, t)]
                for t in topics
            ],
        ),
        "Services": (
            ["service", "type", "offered by"],
            [[f"`{name}`", kind, node] for name, (kind, node) in sorted(graph.services.items())],
        ),
        "Frames": (
            ["frame", "in", "published by"],
            [
                [f"`{child}`", f"`{parent}`", node + (", static" if static else "")]
                for child, (parent, node, static) in sorted(graph.frames.items())
            ],
        ),
    }
    nodes = ", ".join(name for name in (f"`{node}`" for node in sorted(graph.nodes)) if name not in known)
    parts = [f"## {part.title}\n", f"{part.says}\n", f"**Nodes:** {nodes}\n"]
    for title, (head, rows) in tables.items():
        new = [row for row in rows if markdown.table(head, [row]).splitlines()[-1] not in known]
        if new:
            parts += [f"### {title}\n", markdown.table(head, new)]
    return "\n".join(parts)


def known_from(section: str) -> set[str]:
    """Returns what a section shows, for `section` to leave out."""
    nodes = re.search(r"^\*\*Nodes:\*\* (.*)$", section, re.MULTILINE)
    return {*section.splitlines(), *(nodes[1].split(", ") if nodes else ())}


def sections(page: str) -> dict[str, str]:
    """Returns the sections of the page by their titles."""
    found = re.split(r"^(?=## )", page, flags=re.MULTILINE)[1:]
    return {text.splitlines()[0][3:]: text.rstrip("\n") + "\n" for text in found}


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

    def differences(self, part: Part, expected: str, known: Collection[str]) -> str:
        """Returns how a section of the page differs from the graph, once they agree or the graph is complete."""
        began = time.monotonic()
        while time.monotonic() - began < LIMIT_S:
            found = section(self.graph(), part, known)
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


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tools.interface", description=__doc__.splitlines()[0])
    parser.add_argument("launch", nargs="*", help="package, launch file and its arguments; none: those of the page")
    parser.add_argument("--check", action="store_true", help="compare the page in the handbook with the graphs")
    parser.add_argument("--part", choices=PARTS, help="one part of the page alone: print it, or compare it")
    options = parser.parse_args()
    if options.launch:
        part = Part(" ".join(options.launch[:2]), "", lambda: [["roslaunch", *options.launch]])
        with running(part):
            sys.stdout.write(section(Observer().steady_graph(), part))
    elif options.part:
        sys.exit(_one(options.part, options.check))
    elif options.check:
        # A process can be a node of one master alone.
        codes = [subprocess.call([sys.executable, "-m", "tools.interface", "--check", "--part", p]) for p in PARTS]
        sys.exit(any(codes))
    else:
        text = HEAD
        for name in PARTS:
            command = [sys.executable, "-m", "tools.interface", "--part", name]
            text += "\n" + subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
            PAGE.write_text(text)


def _one(name: str, check: bool) -> int | str:
    """Prints a part of the page as it should be, or returns how it differs from that."""
    part, page = PARTS[name], sections(PAGE.read_text())
    first = next(iter(PARTS.values())).title
    known = set() if part.title == first else known_from(page.get(first, ""))
    with running(part):
        observer = Observer()
        if check:
            return observer.differences(part, page.get(part.title, ""), known) or 0
        sys.stdout.write(section(observer.steady_graph(), part, known))
    return 0


def _nodes(of: dict[str, set[str]], topic: str) -> str:
    return ", ".join(sorted(of.get(topic, ())))


if __name__ == "__main__":
    main()
