"""An operator under remote control: the hand comes into view, moves from pose to pose, and leaves. Moves follow the
minimum-jerk law of human arm movements (Flash and Hogan 1985). The reports of the hand have the noise of a real hand,
and its behaviour at entry and exit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from common import clock
from leap_motion.service import wire
from leap_motion.service.hand import ReportedHand
from rig_simulation.devices.leap.sensing import SETTLE_S, Tracker
from rig_simulation.operator import motion
from rig_simulation.operator.sources import ScriptedOperator, Sensed, as_frames, next_interval
from rig_simulation.operator.steering import FARTHEST_M

LARGEST_ANGLE = np.radians(90.0)


@dataclass(frozen=True)
class HandTarget:
    """A target of the hand."""

    # Palm from the centre of the workspace [m], from the operator's view
    right: float = 0.0
    up: float = 0.0
    back: float = 0.0
    pitch: float = 0.0  # [rad]
    yaw: float = 0.0  # [rad]
    roll: float = 0.0  # [rad]
    curl: float = 0.0  # 0 open, 1 fist
    seconds: float = 1.0  # duration of the move

    def __post_init__(self) -> None:
        longest_reach_s = 60.0
        limits = {
            **dict.fromkeys(("right", "up", "back"), (-FARTHEST_M, FARTHEST_M, "m")),
            **dict.fromkeys(("pitch", "yaw", "roll"), (-LARGEST_ANGLE, LARGEST_ANGLE, "rad")),
            "curl": (0.0, 1.0, ""),
            "seconds": (0.0, longest_reach_s, "s"),
        }
        for name, (low, high, unit) in limits.items():
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and low <= value <= high):
                raise ValueError(f"The field {name} is {value!r}, but must lie in {low:g} to {high:g} {unit}.")

    @property
    def state(self) -> np.ndarray:
        """The target as a state of motion.py, shape (7,) [mm, rad]."""
        palm = 1e3 * self.right, 1e3 * self.up, 1e3 * self.back
        return np.array([*palm, self.pitch, self.yaw, self.roll, self.curl])


class GuidedOperator:
    """A source whose hand moves as its methods request, from any thread; `scripted`: its size, side, workspace."""

    def __init__(self, scripted: ScriptedOperator) -> None:
        self._scripted = scripted
        self._lock = clock.Lock()
        self._state: np.ndarray | None = None
        self._path = (np.zeros(motion.STATE_SIZE), np.zeros(motion.STATE_SIZE), 0.0)
        self._elapsed, self._shown = 0.0, 0
        self._leaves_in: float | None = None
        self._second: float | None = None  # curl that the second hand comes to, None without one

    def show(self, **at: float) -> None:
        """Shows a hand at a `HandTarget`, with a new id, in place of the one before; ValueError if invalid."""
        state = _target(at).state
        with self._lock:
            self._state, self._path, self._elapsed = state, (state, state, 0.0), 0.0
            self._shown += 1
            self._leaves_in = None

    def reach(self, **to: float) -> None:
        """Moves the hand from its present pose to a `HandTarget`; ValueError if invalid or if no hand is in view."""
        target = _target(to)
        with self._lock:
            if self._state is None:
                raise ValueError("No hand is in view; use show first.")
            self._path, self._elapsed = (self._state, target.state, target.seconds), 0.0

    def hide(self) -> None:
        """Takes the hand out of view, after its confidence has fallen."""
        with self._lock:
            if self._state is not None:
                self._leaves_in = SETTLE_S

    def second(self, curl: float) -> None:
        """Shows the second hand beside the first one, and closes it to `curl`, 0 open to 1 fist; ValueError if
        invalid."""
        _target({"curl": curl})
        with self._lock:
            self._second = curl

    def hand(self) -> dict:
        """Returns whether a hand is in view, whether it moves, and its right, up, back [m] and curl."""
        with self._lock:
            if self._state is None:
                return {"in_view": False, "moving": False}
            right, up, back = (1e-3 * self._state[:3]).tolist()
            moving = self._elapsed < self._path[2]
            curl = float(self._state[motion.CURL])
            return {"in_view": True, "moving": moving, "right": right, "up": up, "back": back, "curl": curl}

    def frames(self, rng: np.random.Generator, first_id: int) -> Iterator[tuple[float, wire.Frame]]:
        """Yields frames without end, empty ones while no hand is in view."""
        return as_frames(self.hands(rng, first_id), self._scripted.service, self._scripted.frame_rate)

    def hands(self, rng: np.random.Generator, first_id: int) -> Iterator[Sensed]:
        model, frame_rate = self._scripted.hand_model, self._scripted.frame_rate
        tracker, shown, age = None, 0, 0.0
        second = SecondHand(self._scripted, first_id + 1000, rng)
        order = rng.permutation(5).tolist()
        while True:
            interval = next_interval(rng, frame_rate)
            state, speed, left, count = self._advance(interval)
            hands = []
            if state is not None:
                if tracker is None or count != shown:
                    tracker, shown, age = Tracker(model, first_id + count - 1, rng, frame_rate), count, 0.0
                curl = float(state[motion.CURL])
                hands = [tracker.report(self._scripted.pose(state), curl, speed, age, left)]
                age += interval
            else:
                tracker = None
            if self._second is not None:
                hands.append(second.report(self._second, interval))
            yield interval, hands, order

    def _advance(self, dt: float) -> tuple[np.ndarray | None, float, float, int]:
        """Advances by dt [s]; returns state, speed of the palm [mm/s], time left in view [s], hands so far."""
        with self._lock:
            if self._leaves_in is not None:
                self._leaves_in -= dt
                if self._leaves_in <= 0.0:
                    self._state = self._leaves_in = None
            if self._state is None:
                return None, 0.0, 0.0, self._shown
            before = self._state
            start, end, seconds = self._path
            self._elapsed = min(self._elapsed + dt, seconds)
            fraction = self._elapsed / seconds if seconds > 0.0 else 1.0
            self._state = start + motion.min_jerk(fraction) * (end - start)
            speed = float(np.linalg.norm(self._state[:3] - before[:3])) / dt
            return self._state, speed, 1e3 if self._leaves_in is None else self._leaves_in, self._shown


class SecondHand:
    """The other hand, which stays beside the first one and closes smoothly."""

    def __init__(self, scripted: ScriptedOperator, hand_id: int, rng: np.random.Generator) -> None:
        second_at_mm = (-220.0, -40.0, 40.0)  # from the centre, of the second hand beside a right one
        side = "left" if scripted.side == "right" else "right"
        self._scripted = replace(scripted, side=side)
        self._tracker = Tracker(self._scripted.hand_model, hand_id, rng, scripted.frame_rate)
        x, y, z = second_at_mm
        self._state = np.array([x if side == "left" else -x, y, z, 0.0, 0.0, 0.0, 0.0])
        self._age = 0.0

    def report(self, curl: float, dt: float) -> ReportedHand:
        """Returns the report of the hand `dt` [s] after the one before, on its way to `curl`."""
        second_fist_s = 0.3  # time in which it closes
        most = dt / second_fist_s
        self._state[motion.CURL] += float(np.clip(curl - self._state[motion.CURL], -most, most))
        self._age += dt
        return self._tracker.report(
            self._scripted.pose(self._state), float(self._state[motion.CURL]), 0.0, self._age, 1e3
        )


def _target(fields: dict) -> HandTarget:
    unknown = sorted(set(fields) - set(HandTarget.__dataclass_fields__))
    if unknown:
        known = ", ".join(HandTarget.__dataclass_fields__)
        raise ValueError(f"Unknown field {', '.join(unknown)}; the fields are {known}.")
    return HandTarget(**fields)
