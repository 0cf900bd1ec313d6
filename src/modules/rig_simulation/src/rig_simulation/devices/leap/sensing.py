"""The tracking of a hand: noise, confidence, filtered velocities, ids, and the behaviour at entry and exit.

The noise levels come from recordings of real hands: a still hand is reported within 0.02 to 0.07 mm, ten times worse
when it moves fast or is poorly recognised. The noise is low-pass: errors of successive frames are similar.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rig_simulation.operator.hand_model import HandGeometry, HandModel, HandPose, grab_strength

PALM_NOISE_MM = 0.04
ANGLE_NOISE = np.radians(0.04)
FLEXION_NOISE = np.radians(0.1)
WANDER_MM = 1.2
WANDER_ANGLE = np.radians(0.5)
NOISE_MEMORY, WANDER_MEMORY = 0.86, 0.992  # fraction of a filter's value that remains from frame to frame
NOISE_SPEED_MM_S = 40.0  # at this speed of the palm the noise is twice that at rest
FIST_CONFIDENCE = 0.72
SETTLE_S = 0.3
FIRST_VELOCITY_MM_S = 1.19209e-07
VELOCITY_MEMORY, STABLE_MEMORY = 0.6, 0.8


class LowPassNoise:
    """Low-pass noise of standard deviation 1: white noise through two equal first-order filters."""

    def __init__(self, rng: np.random.Generator, size: int, memory: float) -> None:
        self._rng, self._memory = rng, memory
        self._first, self._second = np.zeros(size), np.zeros(size)
        m2 = memory**2
        self._gain = np.sqrt((1.0 - m2) ** 3 / (1.0 + m2))

    def step(self) -> np.ndarray:
        """Returns the next values, shape (size,)."""
        self._first = self._memory * self._first + self._rng.standard_normal(self._first.size)
        self._second = self._memory * self._second + self._first
        return self._gain * self._second


@dataclass(frozen=True)
class ReportedHand:
    """A hand as the service reports it; lengths in mm, velocities in mm/s, as in the messages."""

    id: int
    model: HandModel
    geometry: HandGeometry
    flexion: np.ndarray
    confidence: float
    time_visible: float
    velocity: np.ndarray
    tip_velocities: np.ndarray
    stable_palm: np.ndarray
    stable_tips: np.ndarray

    @classmethod
    def at_rest(
        cls, hand_id: int, model: HandModel, pose: HandPose, confidence: float, time_visible: float
    ) -> ReportedHand:
        """Returns the report of a hand in a pose, without velocity."""
        geometry = model.place(pose)
        still = np.full(3, FIRST_VELOCITY_MM_S), np.zeros((5, 3)), geometry.palm, geometry.tips
        return cls(hand_id, model, geometry, pose.flexion, confidence, time_visible, *still)

    @property
    def grab(self) -> float:
        """The grab strength."""
        return grab_strength(self.flexion)


class Tracker:
    """Follows one hand from its entry to its exit."""

    def __init__(self, model: HandModel, hand_id: int, rng: np.random.Generator) -> None:
        self._model, self._id, self._rng = model, hand_id, rng
        self._noise = LowPassNoise(rng, 21, NOISE_MEMORY)
        self._wander = LowPassNoise(rng, 6, WANDER_MEMORY)
        self._confidence_noise = LowPassNoise(rng, 1, 0.95)
        self._entry_confidence = rng.uniform(0.55, 0.8)
        self._last: ReportedHand | None = None

    def report(self, pose: HandPose, curl: float, speed: float, age: float, left: float) -> ReportedHand:
        """Returns the report of the hand in its true pose: `curl` 0 open to 1 fist, `speed` of the palm [mm/s], `age`
        since it came into view [s], `left` until it leaves the view [s].
        """
        confidence = self._confidence(curl, age, left)
        measured = self._measured(pose, (1.0 + speed / NOISE_SPEED_MM_S) * (4.0 - 3.0 * confidence))
        if self._last is None:
            hand = replace(ReportedHand.at_rest(self._id, self._model, measured, confidence, age), flexion=pose.flexion)
        else:
            geometry = self._model.place(measured)
            filtered = _filtered(geometry, self._last, age - self._last.time_visible)
            hand = ReportedHand(self._id, self._model, geometry, pose.flexion, confidence, age, *filtered)
        self._last = hand
        return hand

    def _measured(self, pose: HandPose, level: float) -> HandPose:
        noise, wander = level * self._noise.step(), self._wander.step()
        angles = ANGLE_NOISE * noise[3:6] + WANDER_ANGLE * wander[3:]
        return replace(
            pose,
            palm=pose.palm + PALM_NOISE_MM * noise[:3] + WANDER_MM * wander[:3],
            pitch=pose.pitch + angles[0],
            yaw=pose.yaw + angles[1],
            roll=pose.roll + angles[2],
            flexion=pose.flexion + FLEXION_NOISE * noise[6:].reshape(5, 3),
        )

    def _confidence(self, curl: float, age: float, left: float) -> float:
        settled = 0.98 - (0.98 - FIST_CONFIDENCE) * curl
        entered = settled
        if age < SETTLE_S:
            rising = [self._entry_confidence, self._entry_confidence - 0.1, settled]
            entered = min(settled, float(np.interp(age, [0.0, 0.1, SETTLE_S], rising)))
        leaving = float(np.interp(left, [0.0, SETTLE_S], [0.1, 1.0])) if left < SETTLE_S else 1.0
        noise = 0.02 * (1.0 + 2.0 * curl) * self._confidence_noise.step()[0]
        return min(max(float(entered * leaving + noise), 0.02), 1.0)


def _filtered(geometry: HandGeometry, last: ReportedHand, dt: float) -> tuple[np.ndarray, ...]:
    """Returns velocities of palm and tips, and their stabilised positions, which lag behind the measured ones."""
    before = last.geometry

    def velocity(now: np.ndarray, then: np.ndarray, filtered: np.ndarray) -> np.ndarray:
        return VELOCITY_MEMORY * filtered + (1.0 - VELOCITY_MEMORY) * (now - then) / dt

    return (
        velocity(geometry.palm, before.palm, last.velocity),
        velocity(geometry.tips, before.tips, last.tip_velocities),
        STABLE_MEMORY * last.stable_palm + (1.0 - STABLE_MEMORY) * geometry.palm,
        STABLE_MEMORY * last.stable_tips + (1.0 - STABLE_MEMORY) * geometry.tips,
    )
