"""A scripted visit above the Leap: the hand comes in flat, holds still, draws a figure, grips, tilts, and leaves. A
visit is a sequence of segments that start and end at rest: moves from pose to pose follow the minimum-jerk law of human
reaching (Flash and Hogan 1985), figures have a smooth start and end. A state is x, y, z [mm] from the centre of the
workspace, pitch, yaw, roll [rad], and curl (0 open, 1 fist)."""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from typing import Callable, Mapping

import numpy as np

MIN_JERK_PEAK = 1.875  # ratio of the highest to the mean speed of a minimum-jerk move
RAMP = 0.15  # fraction of a figure's time for its acceleration, and for its deceleration
HOLD_S = 2.5  # time for which the hand waits at the centre until the arm follows
FAR_MM = 320.0
TILT_SPEED = np.radians(40.0)
FIGURES = ("circle", "square", "eight", "line")
CURVES: Mapping[str, Callable[[float], tuple[float, float]]] = {
    "circle": lambda angle: (np.sin(angle), -np.cos(angle)),
    "eight": lambda angle: (np.sin(angle), np.sin(angle) * np.cos(angle)),
}
PLANES = {"upright": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), "flat": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0))}
X, Y, Z, PITCH, YAW, ROLL, CURL = range(7)
STATE_SIZE = 7


@dataclass(frozen=True)
class Script:
    """The script of the operator."""

    figure: str = "circle"  # one of FIGURES
    size: float = 150.0  # width of the figure [mm]
    speed: float = 150.0  # highest speed of the palm [mm/s]
    plane: str = "upright"  # of the figure, a key of PLANES
    laps: int = 2  # number of rounds of the figure
    away: float = 3.0  # time out of view after each visit [s]


class Visit:
    """One visit of the hand; `rng` makes each slightly different."""

    def __init__(self, script: Script, rng: np.random.Generator) -> None:
        # distance from the centre, on the operator's side, at which the hand enters and leaves the view
        edge_mm = 200.0
        if script.figure not in FIGURES or script.plane not in PLANES:
            chosen = f"The figure is {script.figure!r} in the plane {script.plane!r}"
            raise ValueError(f"{chosen}, but must be {FIGURES}, {[*PLANES]}.")
        self._script = script
        # Each starts and ends at rest: its duration [s], and its state as a function of the elapsed fraction, 0 to 1
        self._segments: list[tuple[float, Callable[[float], np.ndarray]]] = []
        entry = rng.uniform(-40, 40), rng.uniform(-30, 10), FAR_MM
        self._here = np.array([*entry, *np.radians([6.0, rng.uniform(-8, 8), 3.0]), 0.0])
        rest = np.array([*rng.uniform(-8, 8, 3), *np.radians(rng.uniform([2, -6, -4], [7, 6, 4])), 0.0])
        self._compose(rest)
        self._ends = np.cumsum([duration for duration, _ in self._segments]).tolist()
        self.duration = self._ends[-1]
        times = np.arange(0.0, self.duration, 0.005).tolist()
        self.appears = next(t for t in times if self.state(t)[Z] < edge_mm)
        self.vanishes = next(t for t in reversed(times) if self.state(t)[Z] < edge_mm)

    def state(self, t: float) -> np.ndarray:
        """Returns the state at `t` seconds after the start of the visit, shape (7,)."""
        i = min(bisect.bisect_left(self._ends, t), len(self._segments) - 1)
        duration, state = self._segments[i]
        return state(min(max((t - (self._ends[i] - duration)) / duration, 0.0), 1.0))

    def visible(self, t: float) -> bool:
        return self.appears <= t <= self.vanishes

    def _compose(self, rest: np.ndarray) -> None:
        self._move(rest, speed=1.6 * self._script.speed)
        self._hold(HOLD_S)
        self._figure(rest)
        self._move(rest)
        self._hold(0.5)
        for curl in (0.9, 0.0):
            self._move(_with(rest, CURL, curl), duration=1.2)
            self._hold(0.8)
        for axis, degrees in ((PITCH, 12.0), (PITCH, -10.0), (ROLL, 12.0), (ROLL, -12.0), (YAW, 15.0), (YAW, -15.0)):
            self._move(_with(rest, axis, rest[axis] + np.radians(degrees)))
        self._move(rest)
        self._hold(0.5)
        self._move(_with(rest, Z, FAR_MM), speed=1.6 * self._script.speed)

    def _hold(self, duration: float) -> None:
        here = self._here
        self._segments.append((duration, lambda _: here))

    def _move(self, there: np.ndarray, duration: float = 0.0, speed: float = 0.0) -> None:
        shortest_move_s = 0.6
        here = self._here
        travel = np.linalg.norm(there[:3] - here[:3]) / (speed or self._script.speed)
        turn = np.abs(there[3:6] - here[3:6]).max() / TILT_SPEED
        duration = duration or max(shortest_move_s, MIN_JERK_PEAK * max(travel, turn))
        self._segments.append((duration, lambda fraction: here + min_jerk(fraction) * (there - here)))
        self._here = there

    def _figure(self, rest: np.ndarray) -> None:
        script = self._script
        plane = np.array(PLANES[script.plane])
        half = script.size / 2.0
        if script.figure in ("square", "line"):
            corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)] if script.figure == "square" else [(-1, 0), (1, 0)]
            for corner in (corners * script.laps) + corners[:1]:
                self._move(_shifted(rest, half * np.array(corner) @ plane))
            return
        path = CURVES[script.figure]

        def at(angle: float) -> np.ndarray:
            return _shifted(rest, half * np.array(path(angle)) @ plane)

        angles = np.linspace(0.0, 2.0 * np.pi, 721)
        points = half * np.array([path(angle) for angle in angles])
        fastest = np.linalg.norm(np.gradient(points, angles, axis=0), axis=1).max()
        total = 2.0 * np.pi * script.laps
        duration = fastest * total / (script.speed * (1.0 - RAMP))
        self._move(at(0.0))
        self._segments.append((duration, lambda fraction: at(total * _run(fraction))))
        self._here = at(total)


def min_jerk(fraction: float) -> float:
    """Returns the fraction of the path after a fraction of the time: at rest at both ends, minimum jerk between."""
    return fraction**3 * (10.0 - 15.0 * fraction + 6.0 * fraction**2)


def _run(fraction: float) -> float:
    """Returns the fraction of the path after a fraction of the time: smooth start, steady speed, smooth end."""
    if fraction > 0.5:
        return 1.0 - _run(1.0 - fraction)
    q = min(fraction / RAMP, 1.0)
    ramped = RAMP * (q**3 - 0.5 * q**4)
    return (ramped + max(0.0, fraction - RAMP)) / (1.0 - RAMP)


def _with(state: np.ndarray, axis: int, value: float) -> np.ndarray:
    state = state.copy()
    state[axis] = value
    return state


def _shifted(state: np.ndarray, shift: np.ndarray) -> np.ndarray:
    state = state.copy()
    state[:3] += shift
    return state
