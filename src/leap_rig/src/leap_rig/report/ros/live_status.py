"""Shows the state of the demo in the terminal. Apart from the listener, whose imports take as long as roslaunch's."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

from common import clock

if TYPE_CHECKING:
    from leap_rig.report.ros.listener import RigListener

CLEAR_LINE = "\r\033[K"
COMPLAINT = "[${severity}] ${node}: ${message}"
"""ROSCONSOLE_FORMAT of the nodes."""


class LiveStatus:
    """One live line on a terminal, a line every five seconds elsewhere; nodes print their own warnings as COMPLAINT.
    `started` is the time of its start [s]."""

    def __init__(self) -> None:
        self._terminal = sys.stdout.isatty()
        self._period = 0.5 if self._terminal else 5.0
        self._next = 0.0
        self._frames = 0
        self.started = self._time = clock.monotonic()

    def update(self, listeners: Mapping[str, RigListener], phase: str) -> None:
        """Prints the state of each arm by its name, at most once a period."""
        now = clock.monotonic()
        recorder = next(iter(listeners.values())).recorder
        if now < self._next:
            return
        self._next = now + self._period
        rate = max(recorder.frames - self._frames, 0) / max(now - self._time, 1e-3)
        self._frames, self._time = recorder.frames, now
        text = f"{phase:>8}"
        for arm, listener in listeners.items():
            text += f" | {arm or 'arm'} {listener.mode or '-':<9}"
            if recorder.teleoperated:
                text += f" | hand {'steers' if listener.recorder.streaming else 'waits':<6}"
        text += f" | {rate:4.0f} frames/s" if recorder.teleoperated else ""
        speed = recorder.counters.get("simulation", {}).get("tcp_speed")
        if speed is not None and len(listeners) == 1:
            text += f" | TCP {1e3 * float(speed):4.0f} mm/s"
        if recorder.scenario is not None:
            text += f" | {recorder.scenario['step']}"
        self._print(text + ("" if self._terminal else "\n"))

    def say(self, sentence: str) -> None:
        self._print(sentence + "\n")

    def finish(self) -> None:
        if self._terminal:
            print()

    def _print(self, text: str) -> None:
        print(f"{CLEAR_LINE}{text}" if self._terminal else text, end="", flush=True)
