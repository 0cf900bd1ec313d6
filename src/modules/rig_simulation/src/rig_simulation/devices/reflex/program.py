"""The program `reflex_hand.py`: the simulated hand on its network, with a control port."""

from __future__ import annotations

import argparse
import contextlib
import threading
import time
from collections.abc import Callable
from functools import wraps
from typing import Any

from common.errors import RigError
from rig_simulation.command_line import failed, parse_options, port, stop_on_signals
from rig_simulation.control_port import ControlPort
from rig_simulation.devices.reflex.hand import PERIOD_S, SimulatedHand
from rig_simulation.devices.reflex.link import HandLink
from rig_simulation.devices.reflex.wire import read_command
from rig_simulation.faults.hand import HAND_FAULTS
from rig_simulation.faults.injection import add_option, switch_all

NAME = "reflex_hand"
LONGEST_STEP_S = 0.1
REQUESTS = (
    *("state", "set_load", "press", "block", "stick_encoder"),
    *("unplug_servo", "jump", "set_servo", "set_silent", "power_cycle"),
)


def main(arguments: list[str] | None = None) -> int:
    """Runs the simulated hand until it is interrupted; returns the exit code."""
    options = _options(arguments)
    stop = threading.Event()
    stop_on_signals(stop.set)
    try:
        with contextlib.closing(HandLink(options.interface, options.port)) as link:
            hand, lock = SimulatedHand(options.seed), threading.Lock()
            switch_all(link.faults, options.fault)
            with ControlPort(handlers(hand, link, lock), port=options.control_port) as control:
                print(ready_line(link, control), flush=True)
                run(hand, link, lock, stop)
    except RigError as error:
        return failed(NAME, error)
    return 0


def ready_line(link: HandLink, control: ControlPort) -> str:
    """Returns what a program prints when the hand is on the network."""
    return f"{NAME}: on {link.interface}, UDP port {link.port}, control port {control.host}:{control.port}"


def run(hand: SimulatedHand, link: HandLink, lock: threading.Lock, stop: threading.Event) -> None:
    """Runs the hand's cycle: measure, send the state, then execute the commands received meanwhile."""
    before = due = time.monotonic()
    while not stop.wait(max(0.0, due - time.monotonic())):
        now = time.monotonic()
        with lock:
            hand.step(min(now - before, LONGEST_STEP_S))
            exchange(hand, link)
        before = now
        due = max(due + PERIOD_S, now)


def exchange(hand: SimulatedHand, link: HandLink) -> None:
    """Sends the hand's state, then executes the received commands, with the faults of the link."""
    link.wire.follow(hand)
    if not hand.silent:
        link.send(hand.packet())
    for data in link.collect():
        command = read_command(data)
        if command and not hand.silent:
            hand.handle(command)


def handlers(
    hand: SimulatedHand, link: HandLink, lock: contextlib.AbstractContextManager[bool]
) -> dict[str, Callable[..., Any]]:
    """Returns the requests of the hand's control port; those of the hand hold the lock."""

    def locked(method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)  # the control port checks the fields of a request against the signature
        def call(**fields: Any) -> Any:
            with lock:
                return method(**fields)

        return call

    return {**{name: locked(getattr(hand, name)) for name in REQUESTS}, **link.faults.requests}


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=f"{NAME}.py", description="Simulated ReFlex TakkTile hand.")
    parser.add_argument("--interface", default="lo", help="network interface (default: lo)")
    parser.add_argument("--port", type=port, default=11333, help="UDP port; 0: any free one (default: 11333)")
    parser.add_argument("--control-port", type=port, default=11433, help="TCP port; 0: any free one (default: 11433)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the hand's slack, zeros and noise (default: 0)")
    add_option(parser, HAND_FAULTS)
    return parse_options(parser, arguments)
