"""A hand over the simulated Leap service that does what a test tells it, frame by frame and without noise."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import astuple, dataclass, replace

import numpy as np

from rig_simulation.leap import wire
from rig_simulation.leap.hand_model import HandModel, HandPose, extended, fingers_for, grab_strength, pinch_strength
from rig_simulation.leap.sensing import ReportedHand
from rig_simulation.leap.sources import PERIOD_S

BOX_CENTRE_MM = np.array([0.0, 350.0, 0.0])
"""Centre of the interaction box with the parameters as shipped, in Leap axes."""


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
    """A source of the simulated service. Every call of `show` brings another hand, with a new id.

    Attributes:
        seen: how many frames with a hand were given to the service so far.
    """

    def __init__(self) -> None:
        self.seen = 0
        self._lock = threading.Lock()
        self._model = HandModel("right")
        self._hand: Hand | None = None
        self._path: Iterator[Hand | None] = iter(())
        self._id = 0
        self._glitch: Hand | None = None
        self._moving = False

    def show(self, **at: float) -> None:
        """Shows another hand from the next frame on, in place of the one before."""
        self._follow(iter([Hand(**at)]), new=True)

    def flash(self, frames: int, **at: float) -> None:
        """Shows another hand for so many frames only."""
        self._follow(iter([Hand(**at)] * frames + [None]), new=True)

    def hide(self) -> None:
        """Takes the hand away."""
        self._follow(iter([None]))

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

    @property
    def still(self) -> bool:
        """Whether the last movement is over."""
        with self._lock:
            return not self._moving

    @property
    def glitched(self) -> bool:
        """Whether the last glitch was sent."""
        with self._lock:
            return self._glitch is None

    def frames(self, rng: np.random.Generator, first_id: int) -> Iterator[tuple[float, dict]]:
        """Yields (interval, frame) for ever; called by the service."""
        while True:
            hand, number = self._next()
            self.seen += hand is not None
            yield PERIOD_S, wire.frame([] if hand is None else [self._report(hand, number)], 1.0 / PERIOD_S, "2.x")

    def _follow(self, path: Iterator[Hand | None], new: bool = False) -> None:
        with self._lock:
            self._path, self._moving = path, True
            self._id += new

    def _next(self) -> tuple[Hand | None, int]:
        with self._lock:
            try:
                self._hand = next(self._path)
            except StopIteration:
                self._moving = False
            glitch, self._glitch = self._glitch, None
            return glitch or self._hand, self._id

    def _report(self, hand: Hand, number: int) -> ReportedHand:
        flexion, spread = fingers_for(hand.curl)
        palm = BOX_CENTRE_MM + 1e3 * np.array([hand.right, hand.up, hand.back])
        yaw, pitch, roll = np.radians([hand.yaw, hand.pitch, hand.roll])
        geometry = self._model.place(HandPose(palm, pitch, yaw, roll, flexion, spread))
        return ReportedHand(
            id=number,
            side="right",
            geometry=geometry,
            velocity=np.zeros(3),
            tip_velocities=np.zeros((5, 3)),
            stable_palm=geometry.palm,
            stable_tips=geometry.tips,
            confidence=hand.confidence,
            grab=grab_strength(flexion),
            pinch=pinch_strength(geometry.tips),
            extended=extended(flexion),
            time_visible=1.0,
            palm_width=self._model.palm_width,
            arm_width=self._model.arm_width,
            finger_lengths=self._model.finger_lengths,
            finger_widths=self._model.finger_widths,
            mean_flexion=float(flexion[1:].sum(axis=1).mean()),
        )


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
