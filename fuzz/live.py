#!/usr/bin/env python3
"""Services and topics of the running rig with random values of the right type, while control is off.

Findings: a node that dies or is started again, an exception in a callback, an arm that moves, a number on tf that is
not finite, memory that grows, and a rig that afterwards does not follow a hand. What was sent stands in
build/fuzz/live.log, the newest at the end.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import random
import re
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from campaign.growth import growth
from campaign.soak import Rig, until_home
from common.errors import RigError
from fuzz.mutations import NASTY
from fuzz.run import INTERRUPTED, MINUTES, ROOT
from tools.options import new_folder

FRAMES = (
    "kuka/base_frame",
    "kuka/tool_frame/desired",
    "leap_motion/virtual_frame",
    "/kuka/flange_frame/desired",
    "x",
    "",
)
MEANT = ("exit_app", "exit_app_emergency", "get_loggers", "set_logger_level")  # that end a node, or are roscpp's own
NOT_OURS = ("/rosout", "/rosout_agg", "/clock", "/diagnostics", "/tf_static")
"""Of no node of the rig, or what a frame of the arm is for ever after."""

STILL = 1e-3
"""Largest change of the flange's pose, of an arm that stands [m, 1]."""

LEAK_MIB_H = 300.0
"""A process that grows faster leaks: a kilobyte a message would be far more."""

LEAK_RUN_S = 120.0
SHARE = 0.1  # of the minutes of `make fuzz`
PAUSE_S, SAMPLE_S, TIMEOUT_S, FOLLOW_S = 0.02, 5.0, 15.0, 120.0


def random_message(kind: type, rng: random.Random) -> Any:
    """Returns a message or request of a type, with any values that its fields can hold."""
    return kind(*(_value(name, rng) for name in kind._slot_types))


def _value(name: str, rng: random.Random) -> Any:
    from genpy import Duration, Time
    from roslib.message import get_message_class

    if name.endswith("]"):
        item, _, length = name[:-1].partition("[")
        count = int(length) if length else rng.choice((0, 1, 2, 7, 30))
        if item in ("uint8", "char"):
            return bytes(rng.randrange(256) for _ in range(count))
        return [_value(item, rng) for _ in range(count)]
    if name == "bool":
        return rng.random() < 0.5
    if name == "string":
        text = rng.choice((*FRAMES, *(v for v in NASTY if isinstance(v, str))))
        return text.encode("utf-8", "replace").decode()
    if name in ("time", "duration"):
        now = time.time() if name == "time" else 0.0
        stamp = (Time if name == "time" else Duration).from_sec(now + rng.choice((0.0, 0.0, -1.0, 0.4, 1e3)))
        return stamp if rng.random() < 0.8 else type(stamp)()
    if name.startswith("float"):
        value = rng.choice((*(v for v in NASTY if isinstance(v, float)), rng.uniform(-1.0, 1.0), rng.gauss(0.0, 100.0)))
        return value if name == "float64" or not abs(value) > 3e38 or math.isinf(value) else math.inf
    if re.fullmatch(r"u?int\d+|byte|char", name):
        bits = int("".join(filter(str.isdigit, name)) or 8)
        low = 0 if name.startswith("u") or name == "char" else -(2 ** (bits - 1))
        return rng.choice((low, low + 2**bits - 1, 0, 1, 2, rng.randrange(low, low + 2**bits)))
    return random_message(get_message_class("std_msgs/Header" if name == "Header" else name), rng)


class Border:
    """All services and topics of the rig; each call of `act` uses one of them."""

    def __init__(self, rng: random.Random, log: Any) -> None:
        import rosgraph
        import rospy
        import rosservice
        from roslib.message import get_message_class

        self._rng, self._log = rng, log
        _, subscribed, services = rosgraph.Master("/fuzz").getSystemState()
        types = dict(rosgraph.Master("/fuzz").getTopicTypes())
        names = [name for name, _ in services if name.rpartition("/")[2] not in MEANT]
        self._services = [(name, rosservice.get_service_class_by_name(name)) for name in sorted(names)]
        self._publishers = [
            rospy.Publisher(name, kind, queue_size=5)
            for name, nodes in sorted(subscribed)
            if name not in NOT_OURS and nodes != ["/soak"] and (kind := get_message_class(types[name])) is not None
        ]
        self.counts: dict[str, int] = {}

    def act(self) -> None:
        """Calls a service or publishes a message."""
        import rospy

        from common.ros.service_calls import ServiceFailed, call

        if self._rng.random() < 0.25:
            name, kind = self._rng.choice(self._services)
            request = random_message(kind._request_class, self._rng)
            if name.endswith("/kuka_control"):
                request.data = False
            self._note(name, request)
            with contextlib.suppress(ServiceFailed):
                call(name, kind, *(getattr(request, slot) for slot in request.__slots__), timeout=TIMEOUT_S)
            return
        publisher = self._rng.choice(self._publishers)
        message = random_message(publisher.data_class, self._rng)
        self._note(publisher.name, message)
        with contextlib.suppress(rospy.ROSException):  # not serialisable after all
            publisher.publish(message)

    def _note(self, name: str, message: Any) -> None:
        self.counts[name] = self.counts.get(name, 0) + 1
        self._log.write(f"{time.time():.3f} {name} {' '.join(repr(message).split())[:2000]}\n")

    def close(self) -> None:
        """Publishes no longer."""
        for publisher in self._publishers:
            publisher.unregister()


def listen_to_tf(findings: list[str]) -> None:
    """Adds a finding for each node whose transforms are not finite."""
    import rospy
    from tf2_msgs.msg import TFMessage

    def take(message: Any) -> None:
        sender = message._connection_header["callerid"]
        for t in message.transforms:
            place, turn = t.transform.translation, t.transform.rotation
            numbers = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
            text = f"{sender} sends {t.child_frame_id} with numbers that are not finite"
            if sender != "/soak" and not all(map(math.isfinite, numbers)) and text not in findings:
                findings.append(text)

    rospy.Subscriber("/tf", TFMessage, take, queue_size=100)


def run(seconds: float, seed: int, folder: Path) -> tuple[dict[str, int], list[str]]:
    """Fuzzes a rig; returns how often each service and topic was used, and the findings."""
    from common.ros.service_calls import call
    from kuka_msgs.srv import setKukaControl

    findings: list[str] = []
    with tempfile.TemporaryDirectory(prefix="fuzz") as home, open(folder / "live.log", "w", buffering=1) as log:
        rig = Rig(Path(home))
        try:
            ears = until_home(rig, Path(home) / "rig.log")
            listen_to_tf(findings)
            border = Border(random.Random(seed), log)
            start, samples, began = np.array(rig.arm.ask("state")["flange"]), [], time.monotonic()
            rig.died(rig.processes(1.0))
            while time.monotonic() - began < seconds and not findings:
                due = time.monotonic() + SAMPLE_S
                while time.monotonic() < due:
                    border.act()
                    time.sleep(PAUSE_S)
                processes = rig.processes(SAMPLE_S)
                findings += rig.died(processes) + _tracebacks(Path(home) / "rig.log")
                moved = float(np.abs(np.array(rig.arm.ask("state")["flange"]) - start).max())
                if moved > STILL:
                    findings.append(f"the arm moved by {moved:.4f} though control is off")
                samples.append((time.monotonic() - began, {name: p["rss"] for name, p in processes.items()}))
                done = sum(border.counts.values())
                print(f"\r\x1b[Klive: {done} messages and calls, {len(findings)} findings", end="", flush=True)
            border.close()
            findings += _leaks(samples) if time.monotonic() - began > LEAK_RUN_S else []
            deadline = time.monotonic() + FOLLOW_S
            for on in (False, True):
                call("kuka/kuka_control", setKukaControl, on, timeout=TIMEOUT_S, wait=TIMEOUT_S)
            while ears.mode != "servo" and not findings:
                if time.monotonic() > deadline:
                    findings.append(f"afterwards the rig follows no hand: {ears.mode}, {ears.status.reason}")
                time.sleep(0.2)
            if findings:
                (folder / "live-rig.log").write_text((Path(home) / "rig.log").read_text(errors="replace"))
        finally:
            for number in (signal.SIGINT, signal.SIGTERM):  # a second Ctrl-C would leave nodes behind
                signal.signal(number, signal.SIG_IGN)
            rig.end()
    return border.counts, findings


def _tracebacks(log: Path) -> list[str]:
    """Returns the callbacks and services of the rig that ended with an exception, each once with the exception."""
    lines = re.sub(r"\x1b\[[0-9;]*m", "", log.read_text(errors="replace")).splitlines()
    found = {}
    for i, line in enumerate(lines):
        if "Traceback" in line:
            trace = lines[i + 1 : i + 30]
            end = next((j for j, text in enumerate(trace) if text and not text.startswith(" ")), 0)
            where = next((text.strip() for text in reversed(trace[:end]) if "/src/" in text), "")
            found[f"{where}: {trace[end] if trace else ''}"] = None
    return list(found)


def _leaks(samples: list[tuple[float, dict[str, float]]]) -> list[str]:
    found = []
    for name in samples[-1][1]:
        curve = [(t / 3600.0, rss[name]) for t, rss in samples if name in rss]
        slope = growth(*np.array(curve).T)
        if slope is not None and slope.verdict(LEAK_MIB_H) == "grows":
            found.append(f"{name}: memory grows by {slope.slope:.0f} MiB/h")
    return found


def main(argv: list[str] | None = None) -> int:
    """Fuzzes a rig; returns 1 if something was found."""
    parser = argparse.ArgumentParser(prog="live", description="Random messages and calls for the running rig.")
    parser.add_argument("--minutes", type=MINUTES, default=60.0, help="as of fuzz.run: a tenth of them is used")
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--out", type=new_folder, default=str(ROOT / "build" / "fuzz"))
    options = parser.parse_args(argv)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        counts, findings = run(60.0 * options.minutes * SHARE, options.seed, options.out)
    except RigError as error:
        print(f"live: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nInterrupted; no rig runs any more.")
        return INTERRUPTED
    print(f"\nseed {options.seed}; {sum(counts.values())} messages and calls on {len(counts)} topics and services")
    for text in findings:
        print(f"live: {text}, see {options.out / 'live.log'}")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
