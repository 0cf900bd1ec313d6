"""The program record.py: a run of the rig into one folder, from a process of its own that no controller waits for."""

from __future__ import annotations

import argparse
import math
import os
import platform
import re
import signal
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import rospkg
import rospy
import yaml

from common import clock
from common.command_line import real
from common.errors import RigError
from common.ros.files import file_hash
from common.ros.node import join, run_program
from common.ros.raw_tf import connection_of, data_of
from common.stored_time import utc
from kuka_control.ros.parameter_server import master_of_this_graph
from leap_motion.ros.registrations import registration_file
from leap_rig.recording.fingerprint import address, fingerprint, started_with
from leap_rig.recording.recording_files import (
    PARAMETERS,
    MessageKind,
    RecordingWriter,
    StoredMessage,
    folder_of,
    is_stored_name,
)
from leap_rig.recording.topics import CAMERA, RAW_FRAMES, SENT_GOALS, recorded
from leap_rig.report.ros.live_status import CLEAR_LINE

QUEUE_BYTES = 64 * 2**20  # what waits for a slow disk; more is dropped
TOPIC = re.compile(r"(?:/\w|[A-Za-z])\w*(?:/\w+)*", re.ASCII)
SUFFIXES = (".yaml", ".yml", ".json")
PLAIN = (bool, int, float, str)  # of parameters; XML-RPC also knows bytes and dates
SECRETS = ("code", "password", "token")
PACKAGES = ("leap_rig", "kuka_control", "leap_kuka", "leap_hand", "leap_motion", "reflex", "vision", "grasping")


class Inbox:
    """Messages that wait for the disk, as bytes; the newest are dropped beyond `limit` bytes."""

    def __init__(self, limit: int = QUEUE_BYTES) -> None:
        self._limit, self._bytes = limit, 0
        self._lock = clock.Lock()
        self._waiting: list[StoredMessage] = []
        self._latched: dict[tuple[str, str], StoredMessage] = {}
        self._start, self._zero = clock.time_ns(), clock.monotonic_ns()
        self.received: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()

    @property
    def now(self) -> int:
        """The time [ns]; a step of the clock during a recording does not matter."""
        return self._start + clock.monotonic_ns() - self._zero

    def put(self, topic: str, kind: MessageKind, data: bytes, origin: str = "") -> None:
        """Takes a message of the node `origin`."""
        with self._lock:
            if kind.is_latched:
                self._latched[topic, origin] = StoredMessage(topic, kind, self.now, data)
            self.received[topic] += 1
            if self._bytes + len(data) > self._limit:
                self.dropped[topic] += 1
                return
            self._bytes += len(data)
            self._waiting.append(StoredMessage(topic, kind, self.now, data))

    def take(self) -> list[StoredMessage]:
        with self._lock:
            taken, self._waiting, self._bytes = self._waiting, [], 0
        return taken

    def take_latched(self) -> list[StoredMessage]:
        """Drops what waits, and returns the newest latched messages instead, as if they came now: what a recording that
        begins in the midst would lack. Counts anew."""
        with self._lock:
            self._waiting, self._bytes = [], 0
            self.received, self.dropped = Counter(), Counter()
            return [replace(one, received=self.now) for one in self._latched.values()]


def main() -> None:
    options = _parser().parse_args(rospy.myargv()[1:])
    run_program("record", lambda: record(options), "Interrupted before anything was recorded.")


def record(options: argparse.Namespace) -> int:
    """Records until Ctrl-C, the end of the time, or a full disk; returns the exit code."""
    flush_s = 0.4  # time between two chunks; with the time that the disk takes, what is lost at a power cut
    folder = folder_of(options.name)
    join("leap_rig_record", anonymous=True)
    parameters = master_of_this_graph().getParam("/")  # rospy would return what its cache has of it
    inbox = Inbox()
    interrupted = clock.Event()
    # An exception in the midst of a write would leave a file that differs from its hash.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: interrupted.set())
    writer = writer_of(folder, options, parameters, inbox.now)
    subscribe(inbox, options)
    live, ended_by, began = _LiveLine(inbox, writer), "", clock.monotonic()
    try:
        while not ended_by:
            if interrupted.wait(flush_s):
                ended_by = "Ctrl-C"
            store(inbox, writer)
            live.update(clock.monotonic() - began)
            if not ended_by and options.seconds is not None and clock.monotonic() - began >= options.seconds:
                ended_by = f"the end of {options.seconds:g} s"
    except OSError as error:
        return _end(writer, inbox, live, f"{error.strerror}, so the recording ends; the rig runs on", folder, 1)
    code = _end(writer, inbox, live, ended_by, folder, 0)
    if silent := [topic for topic in options.topic if not inbox.received[topic]]:
        print(f"record: nothing came on {', '.join(silent)}: does anybody publish there?", file=sys.stderr)
    return code


def writer_of(folder: Path, options: argparse.Namespace, parameters: dict[str, Any], now: int) -> RecordingWriter:
    """Returns the writer of a recording that begins `now` [ns]; raises RecordingFault."""
    return RecordingWriter(folder, _about(folder, options, parameters), _files(parameters), now, options.reserve)


def store(inbox: Inbox, writer: RecordingWriter) -> None:
    """Brings what waits to the disk; raises OSError if the disk does not take it."""
    for message in inbox.take():
        writer.add(message)
    writer.flush(dict(inbox.dropped))


def _end(writer: RecordingWriter, inbox: Inbox, live: _LiveLine, ended_by: str, folder: Path, code: int) -> int:
    now, dropped = inbox.now, dict(inbox.dropped)
    live.finish()
    if code:
        print(f"record: {ended_by}.", file=sys.stderr)
    writer.close(now, ended_by, dropped)
    print(f"Recorded {writer.count} messages in {folder}, {live.text}.")
    if dropped:
        lost = ", ".join(f"{count} of {topic}" for topic, count in dropped.items())
        print(f"record: the disk was too slow: {lost} are missing.", file=sys.stderr)
    return code


def subscribe(inbox: Inbox, options: argparse.Namespace) -> None:
    """Lets the inbox receive what the options ask for."""
    for topic in dict.fromkeys((*recorded(options.camera), *options.topic)):
        _subscribe(topic, inbox)


def _subscribe(topic: str, inbox: Inbox) -> rospy.Subscriber:
    read_bytes = 4 * 2**20  # of a subscriber's buffer: rospy's own is smaller than an image
    kinds: dict[tuple[str, str], MessageKind] = {}

    def take(message: rospy.AnyMsg) -> None:
        header = connection_of(message)
        key = header["md5sum"], header.get("latching", "0")
        if key not in kinds:
            kinds[key] = MessageKind(header["type"], header["message_definition"], key[0], key[1] == "1")
        inbox.put(topic, kinds[key], data_of(message), header.get("callerid", ""))

    return rospy.Subscriber(topic, rospy.AnyMsg, take, buff_size=read_bytes)


class _LiveLine:
    """What is recorded, each second on a terminal."""

    def __init__(self, inbox: Inbox, writer: RecordingWriter) -> None:
        self._inbox, self._writer = inbox, writer
        self._terminal = sys.stdout.isatty()
        self._before: Mapping[str, int] = {}
        self._at = self._next = 0.0
        self.text = "0 s"

    def update(self, seconds: float) -> None:
        """Prints the line if it is due; `seconds` since the start."""
        line_s = 5.0  # between two lines where the output is no terminal
        self.text = f"{seconds:.0f} s, {self._writer.size / 1e6:.1f} MB"
        if seconds < self._next:
            return
        received = dict(self._inbox.received)
        rates = ((name, received.get(topic, 0) - self._before.get(topic, 0)) for name, topic in RATES)
        passed = max(seconds - self._at, 1e-3)
        parts = [self.text, *(f"{name} {count / passed:.0f}/s" for name, count in rates)]
        parts.append(f"dropped {sum(self._inbox.dropped.values())}")
        line = " | ".join([*parts, "Ctrl-C ends"])
        print(f"{CLEAR_LINE}{line}" if self._terminal else line, end="" if self._terminal else "\n", flush=True)
        self._before, self._at = received, seconds
        self._next = seconds + (1.0 if self._terminal else line_s)

    def finish(self) -> None:
        if self._terminal:
            print()


RATES = (("frames", RAW_FRAMES), ("goal messages", SENT_GOALS), ("transforms", "/tf"))


def _topic(text: str) -> str:
    """The type of a topic, which becomes absolute: rospy would log one that can be none, and record the others."""
    if not TOPIC.fullmatch(text):
        raise argparse.ArgumentTypeError(f"{text!r} is no topic; one is like /camera/depth/image")
    return text if text.startswith("/") else f"/{text}"


def _about(folder: Path, options: argparse.Namespace, parameters: dict[str, Any]) -> dict[str, Any]:
    kuka = parameters.get("kuka", {})
    kuka = kuka if isinstance(kuka, dict) else {}
    values, files = started_with(kuka)
    robot = {"address": address(kuka), **fingerprint(values, lambda path: files.get(path) or file_hash(path))}
    return {
        "name": folder.name,
        "task": options.task,
        "camera": options.camera,
        "started": utc(clock.time()),
        "robot": robot,
        "versions": _versions(),
    }


def _commit(file: Path) -> str:
    """Returns what git calls the commit of a file, with "-dirty" if any file differs; empty if git does not hold it. An
    install space may lie in a repository of something else. `git describe --dirty` would write the index, and on a full
    disk leave it locked."""
    git_s = 5.0
    answers = []
    commit, changes = ("describe", "--always"), ("status", "--porcelain", "--untracked-files=no")
    for question in (("ls-files", str(file)), commit, changes):
        command = ("git", "--no-optional-locks", "-C", str(file.parent), *question)
        try:
            found = subprocess.run(command, capture_output=True, text=True, timeout=git_s)
        except (OSError, subprocess.TimeoutExpired):
            return ""
        answers.append(found.stdout.strip())
    held, name, changed = answers
    return (f"{name}-dirty" if name and changed else name) if held else ""


def _versions() -> dict[str, Any]:
    packages = rospkg.RosPack()
    return {
        "git": _commit(Path(__file__).resolve()),
        "packages": {name: _version(Path(packages.get_path(name))) for name in PACKAGES},
        "ros": os.environ.get("ROS_DISTRO", ""),
        "python": platform.python_version(),
        "host": platform.node(),
    }


def _version(package: Path) -> str:
    """Returns the version of a package; rospkg would ask rosdep for the operating system, where it is installed."""
    return ElementTree.parse(package / "package.xml").findtext("version", "")


def _files(parameters: dict[str, Any]) -> dict[str, bytes]:
    """Returns the parameters, without secrets, and the files that they name, such as calibrations, by name."""
    largest_file = 2**20  # a larger file is no calibration
    files = {}
    for name, value in _leaves("", parameters):
        path = registration_of(value) if name.endswith(".registration") else Path(value)
        if path is not None and path.is_absolute() and path.suffix in SUFFIXES:
            stored = f"{name}{path.suffix}"
            if not is_stored_name(stored):
                print(f"record: {path} is left out: no file can have the name {stored!r}.", file=sys.stderr)
                continue
            try:
                if path.is_file() and path.stat().st_size <= largest_file:
                    files[stored] = path.read_bytes()
            except OSError as error:
                print(f"record: {path} is left out: {error.strerror}.", file=sys.stderr)
    files[PARAMETERS] = yaml.safe_dump(_without_secrets(parameters)).encode()
    return files


def registration_of(name: str) -> Path | None:
    """Returns the file of a tracker's registration; None if no file can have that name."""
    try:
        return registration_file(name)
    except RigError:
        return None


def _leaves(name: str, value: Any) -> list[tuple[str, str]]:
    if isinstance(value, dict):
        return [leaf for key, below in value.items() for leaf in _leaves(f"{name}.{key}" if name else str(key), below)]
    return [(name, value)] if isinstance(value, str) and 0 < len(value) < 4096 and "\n" not in value else []


def _without_secrets(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: "(left out)" if k in SECRETS and v else _without_secrets(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_secrets(item) for item in value]
    return value if isinstance(value, PLAIN) else f"({type(value).__name__}, left out)"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="record.py", description="Records a run of the rig; Ctrl-C ends it.")
    parser.add_argument("name", help="of the recording, in ~/.ros/leap_rig/recordings; or a path, with a slash")
    parser.add_argument(
        "--seconds", type=real(0.0, math.inf, open_low=True), help="record for so long; without it until Ctrl-C"
    )
    parser.add_argument("--task", default="", help="what is done, in a sentence; exports to LeRobot need it")
    add_content(parser)
    return parser


def add_content(parser: argparse.ArgumentParser) -> None:
    """Adds what is recorded."""
    parser.add_argument("--camera", choices=CAMERA, default="off", help="images to record (default: off)")
    parser.add_argument("--topic", nargs="*", type=_topic, default=[], help="further topics")
    parser.add_argument("--reserve", type=int, default=16 * 2**20, help=argparse.SUPPRESS)
