"""The program reflex_hand.py: the simulated hand on its network, with a control port."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import wraps
from typing import Any

from common.errors import RigError
from rig_simulation.command_line import parse_options, port
from rig_simulation.control_port import ControlPort
from rig_simulation.devices.reflex.hand import PERIOD_S, SimulatedHand
from rig_simulation.devices.reflex.link import HandLink
from rig_simulation.devices.reflex.wire import read_command
from rig_simulation.faults.hand import HAND_FAULTS
from rig_simulation.faults.injection import add_option, switch_all

LONGEST_STEP_S = 0.1


def main(arguments: list[str] | None = None) -> int:
    """Runs the simulated hand until it is interrupted; returns the exit code."""
    options = _options(arguments)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    try:
        link = HandLink(options.interface, options.port)
        try:
            hand, lock = SimulatedHand(options.seed), threading.Lock()
            switch_all(link.faults, options.fault)
            requests = {**handlers(hand, lock), **link.faults.requests}
            with ControlPort(requests, port=options.control_port) as control:
                print(
                    f"reflex_hand: on {options.interface}, UDP port {link.port}, "
                    f"control port {control.host}:{control.port}",
                    flush=True,
                )
                run(hand, link, lock, stop)
        finally:
            link.close()
    except RigError as error:
        print(f"reflex_hand: {error}", file=sys.stderr)
        return 1
    return 0


def run(hand: SimulatedHand, link: HandLink, lock: threading.Lock, stop: threading.Event) -> None:
    """Lives the hand's cycle: measure, send the state, then follow what was received meanwhile."""
    before = time.monotonic()
    due = before
    while not stop.wait(max(0.0, due - time.monotonic())):
        now = time.monotonic()
        with lock:
            hand.step(min(now - before, LONGEST_STEP_S))
            exchange(hand, link)
        before = now
        due = max(due + PERIOD_S, now)


def exchange(hand: SimulatedHand, link: HandLink) -> None:
    """Sends the hand's state, then follows what was received, with the faults of the link."""
    link.wire.follow(hand)
    if not hand.silent:
        link.send(hand.packet())
    for data in link.collect():
        command = read_command(data)
        if command and not hand.silent:
            hand.handle(command)


def handlers(hand: SimulatedHand, lock: AbstractContextManager[bool]) -> dict[str, Callable[..., Any]]:
    """Returns what the hand's control port does; each request holds the lock."""

    def locked(method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)
        def call(**fields: Any) -> Any:
            with lock:
                return method(**fields)

        return call

    names = (
        "state",
        "set_load",
        "press",
        "block",
        "stick_encoder",
        "unplug_servo",
        "jump",
        "set_servo",
        "set_silent",
        "power_cycle",
    )
    return {name: locked(getattr(hand, name)) for name in names}


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="reflex_hand.py", description="Simulated ReFlex TakkTile hand.")
    parser.add_argument("--interface", default="lo", help="network interface (default: lo)")
    parser.add_argument("--port", type=port, default=11333, help="UDP port; 0: any free one (default: 11333)")
    parser.add_argument("--control-port", type=port, default=11433, help="TCP port; 0: any free one (default: 11433)")
    parser.add_argument("--seed", type=int, default=0, help="of the hand's slack, zeros and noise (default: 0)")
    add_option(parser, HAND_FAULTS)
    return parse_options(parser, arguments)
