#!/usr/bin/env python3
"""The simulated Leap service with a hand that does what a test tells it, frame by frame and without noise. Run as a
program, with the loopback address of its service, it prints the ports on which it listens: that of the service, its
control port, and the port on which the calls of `HandPuppet` are taken. A process of its own, because the frames must
not wait for the tests."""

from __future__ import annotations

import inspect
import itertools
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass, replace

import numpy as np

from common import clock
from leap_motion.service import wire
from leap_motion.service.hand import ReportedHand
from rig_simulation.control_port import ControlClient, ControlPort
from rig_simulation.devices.leap.sensing import at_rest
from rig_simulation.devices.leap.server import SimulatedLeapService
from rig_simulation.operator.hand_model import HandModel, HandPose, fingers_for
from rig_simulation.operator.sources import Playback

HOST = "127.0.0.1"

PERIOD_S = 1.0 / 50.0
"""Half the tracker's frame rate, to leave the processor time for other things."""

ENTRY_M, ENTRY_S = 0.25, 0.8
GONE_FRAMES = 70  # more than the node under test waits for a hand that is missing
PATIENCE_S = 60.0  # longest wait for an answer: a pause of the machine is no fault of the rig
BOX_CENTRE_MM = np.array([0.0, 350.0, 0.0])
"""Centre of the interaction box with the parameters as shipped, in Leap axes."""

CALLS = ("show", "flash", "join", "leave", "hide", "glide", "sway", "glitch", "state")


@dataclass(frozen=True)
class Hand:
    """A right hand: palm to the right, up and back from the centre of the box [m]; angles [deg]; curl 1 is a fist."""

    right: float = 0.0
    up: float = 0.0
    back: float = 0.0
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    curl: float = 0.0
    confidence: float = 0.9


class HandPuppet:
    """A source of the simulated service. Every call of `show`, `flash` or `join` brings another hand, with a new id."""

    def __init__(self) -> None:
        self._seen = 0
        self._lock = clock.Lock()
        self._model = HandModel("right")
        self._hand: Hand | None = None
        self._path: Iterator[Hand | None] = iter(())
        self._id = self._newest_id = 0
        self._other: Hand | None = None
        self._other_path: Iterator[Hand | None] = iter(())
        self._other_id = 0
        self._glitch: Hand | None = None
        self._moving = False

    def show(self, **at: float) -> None:
        """Brings another hand in from the operator's side of the box, once the one before is gone and given up."""
        hand = Hand(**at)
        entry = replace(hand, back=hand.back + ENTRY_M)
        gone = [] if self._hand is None else [None] * GONE_FRAMES
        self._follow(itertools.chain(gone, [entry] * 5, _glide(entry, hand, ENTRY_S)), new=True)

    def flash(self, frames: int, **at: float) -> None:
        """Shows another hand where it is to be, for so many frames only."""
        self._follow(iter([Hand(**at)] * frames + [None]), new=True)

    def join(self, seconds: float, to: dict[str, float], **at: float) -> None:
        """Brings in a second right hand, another person's, which sways; it stays when the first leaves."""
        with self._lock:
            self._newest_id += 1
            self._other_id, self._other_path = self._newest_id, _sway(Hand(**at), Hand(**{**at, **to}), seconds)

    def leave(self) -> None:
        """Takes the first hand away; a second one stays."""
        self._follow(iter([None]))

    def hide(self) -> None:
        """Takes all hands away."""
        with self._lock:
            self._other_path = iter([None])
        self.leave()

    def glide(self, seconds: float, **to: float) -> None:
        """Moves the hand smoothly; what is not named stays as it is."""
        self._follow(_glide(self._hand, replace(self._hand, **to), seconds))

    def sway(self, seconds: float, **to: float) -> None:
        """Moves the hand there and back again, each way in so many seconds, for ever."""
        self._follow(_sway(self._hand, replace(self._hand, **to), seconds))

    def glitch(self, **to: float) -> None:
        """Moves the hand for a single frame."""
        with self._lock:
            self._glitch = replace(self._hand, **to)

    def state(self) -> dict:
        """Returns how many frames with a hand were made so far, and whether the last movement still runs."""
        with self._lock:
            return {"seen": self._seen, "moving": self._moving}

    def frames(self, rng: np.random.Generator, first_id: int) -> Iterator[tuple[float, dict]]:
        """Yields (interval, frame) for ever; called by the service."""
        while True:
            hands = [self._report(hand, number) for hand, number in self._next() if hand is not None]
            yield PERIOD_S, wire.frame(hands, 1.0 / PERIOD_S)

    def _follow(self, path: Iterator[Hand | None], new: bool = False) -> None:
        with self._lock:
            self._path, self._moving = path, True
            if new:
                self._newest_id += 1
                self._id = self._newest_id

    def _next(self) -> list[tuple[Hand | None, int]]:
        """Returns the hands of the next frame with their ids; the second comes first, to be taken for the first one."""
        with self._lock:
            self._other = next(self._other_path, self._other)
            try:
                self._hand = next(self._path)
            except StopIteration:
                self._moving = False
            glitch, self._glitch = self._glitch, None
            self._seen += self._hand is not None
            return [(self._other, self._other_id), (glitch or self._hand, self._id)]

    def _report(self, hand: Hand, number: int) -> ReportedHand:
        flexion, spread = fingers_for(hand.curl)
        palm = BOX_CENTRE_MM + 1e3 * np.array([hand.right, hand.up, hand.back])
        yaw, pitch, roll = np.radians([hand.yaw, hand.pitch, hand.roll])
        pose = HandPose(palm, pitch, yaw, roll, flexion, spread)
        return at_rest(number, self._model, pose, hand.confidence, time_visible=1.0)


class PuppetClient:
    """The calls of a HandPuppet that runs as a program, for the test's process: methods of the same names."""

    def __init__(self, port: int) -> None:
        self._client = ControlClient(HOST, port, PATIENCE_S)

    def __getattr__(self, name: str) -> Callable[..., dict]:
        _, *names = inspect.signature(getattr(HandPuppet, name)).parameters
        return lambda *values, **fields: self._client.ask(name, **dict(zip(names, values)), **fields)

    @property
    def seen(self) -> int:
        """How many frames with a hand were made so far."""
        return self._client.ask("state")["seen"]

    @property
    def still(self) -> bool:
        """Whether the last movement is over."""
        return not self._client.ask("state")["moving"]

    def close(self) -> None:
        self._client.close()


def _glide(start: Hand, end: Hand, seconds: float) -> Iterator[Hand]:
    """Yields the hands of a minimum-jerk move, one a frame."""
    a, b = np.array(astuple(start)), np.array(astuple(end))
    count = max(1, round(seconds / PERIOD_S))
    for i in range(1, count + 1):
        s = i / count
        yield Hand(*(a + s**3 * (10.0 - 15.0 * s + 6.0 * s * s) * (b - a)).tolist())


def _sway(start: Hand, end: Hand, seconds: float) -> Iterator[Hand]:
    while True:
        yield from _glide(start, end, seconds)
        yield from _glide(end, start, seconds)


def main() -> None:
    puppet = HandPuppet()
    service = SimulatedLeapService(Playback(puppet), sys.argv[1], 0, 0)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: service.stop())
    with ControlPort({name: getattr(puppet, name) for name in CALLS}) as port:
        print("ready", service.port, service.control_port, port.port, flush=True)
        service.run()


if __name__ == "__main__":
    sys.exit(main())
