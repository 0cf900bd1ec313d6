"""The tracking of a hand: noise, confidence, and the behaviour at entry and exit. The noise levels come from recordings
of real hands: a still hand is reported within 0.02 to 0.07 mm, ten times worse when it moves fast or is poorly
recognised. The noise is low-pass: errors of successive frames are similar."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from leap_motion.service.hand import FIRST_VELOCITY_MM_S, ReportedHand, extended
from rig_simulation.operator.hand_model import HandModel, HandPose

FRAME_RATE = 115.3  # of the device [Hz]
ANGLE_NOISE = np.radians(0.04)
FLEXION_NOISE = np.radians(0.1)
WANDER_ANGLE = np.radians(0.5)
SETTLE_S = 0.3


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


def at_rest(
    hand_id: int,
    model: HandModel,
    pose: HandPose,
    confidence: float,
    time_visible: float,
    flexion: np.ndarray | None = None,
) -> ReportedHand:
    """Returns the report of a hand in a pose, without velocity; its grab follows from `flexion` where that is given."""
    geometry = model.place(pose)
    flexion = pose.flexion if flexion is None else flexion
    return ReportedHand(
        id=hand_id,
        side=model.side,
        confidence=confidence,
        time_visible=time_visible,
        palm=geometry.palm,
        direction=geometry.direction,
        normal=geometry.normal,
        joints=geometry.joints,
        bases=geometry.bases,
        tips=geometry.tips,
        wrist=geometry.wrist,
        elbow=geometry.elbow,
        arm_basis=geometry.arm_basis,
        palm_width=model.palm_width,
        arm_width=model.arm_width,
        lengths=model.finger_lengths,
        widths=model.finger_widths,
        curl=float(flexion[1:].sum(axis=1).mean()),
        extended=extended(flexion.sum(axis=1)),
        velocity=np.full(3, FIRST_VELOCITY_MM_S),
        tip_velocities=np.zeros((5, 3)),
        stable_palm=geometry.palm,
        stable_tips=geometry.tips,
    )


class Tracker:
    """Follows one hand from its entry to its exit, with `frame_rate` reports a second [Hz]."""

    def __init__(
        self, model: HandModel, hand_id: int, rng: np.random.Generator, frame_rate: float = FRAME_RATE
    ) -> None:
        # Fraction of a filter's value that remains from frame to frame at FRAME_RATE.
        noise_memory = 0.86
        wander_memory = 0.992
        confidence_memory = 0.95
        self._model, self._id, self._rng = model, hand_id, rng
        frames = FRAME_RATE / frame_rate
        self._noise = LowPassNoise(rng, 21, noise_memory**frames)
        self._wander = LowPassNoise(rng, 6, wander_memory**frames)
        self._confidence_noise = LowPassNoise(rng, 1, confidence_memory**frames)
        self._entry_confidence = rng.uniform(0.55, 0.8)
        self._last: ReportedHand | None = None

    def report(self, pose: HandPose, curl: float, speed: float, age: float, left: float) -> ReportedHand:
        """Returns the report of the hand in its true pose: `curl` 0 open to 1 fist, `speed` of the palm [mm/s], `age`
        since it came into view [s], `left` until it leaves the view [s]."""
        noise_speed_mm_s = 40.0  # at this speed of the palm the noise is twice that at rest
        confidence = self._confidence(curl, age, left)
        measured = self._measured(pose, (1.0 + speed / noise_speed_mm_s) * (4.0 - 3.0 * confidence))
        hand = at_rest(self._id, self._model, measured, confidence, age, pose.flexion)
        if self._last is not None:
            hand = hand.following(self._last)
        self._last = hand
        return hand

    def _measured(self, pose: HandPose, level: float) -> HandPose:
        palm_noise_mm = 0.04
        wander_mm = 1.2
        noise, wander = level * self._noise.step(), self._wander.step()
        angles = ANGLE_NOISE * noise[3:6] + WANDER_ANGLE * wander[3:]
        return replace(
            pose,
            palm=pose.palm + palm_noise_mm * noise[:3] + wander_mm * wander[:3],
            pitch=pose.pitch + angles[0],
            yaw=pose.yaw + angles[1],
            roll=pose.roll + angles[2],
            flexion=pose.flexion + FLEXION_NOISE * noise[6:].reshape(5, 3),
        )

    def _confidence(self, curl: float, age: float, left: float) -> float:
        fist_confidence = 0.72
        settled = 0.98 - (0.98 - fist_confidence) * curl
        entered = settled
        if age < SETTLE_S:
            rising = [self._entry_confidence, self._entry_confidence - 0.1, settled]
            entered = min(settled, float(np.interp(age, [0.0, 0.1, SETTLE_S], rising)))
        leaving = float(np.interp(left, [0.0, SETTLE_S], [0.1, 1.0])) if left < SETTLE_S else 1.0
        noise = 0.02 * (1.0 + 2.0 * curl) * self._confidence_noise.step()[0]
        return min(max(float(entered * leaving + noise), 0.02), 1.0)
