"""Which hands a webcam's frames show, and what of them can be trusted. A hand is reported from its third frame on
and keeps its id while it is tracked. One that cannot be trusted is withheld, and `FrameHands.remark` says why.
Before its neutral pose is taken its confidence is 0, with which no arm follows it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leap_motion.numbers import ENOUGH_RATE_HZ, KEPT_S, SETTLE_S
from leap_motion.service.hand import ReportedHand, hand_from_joints
from leap_motion.webcam.palm_pose import PALM, CameraHand, camera_hand
from leap_motion.webcam.setups import CameraPlacement, NeutralPose

LEAST_FRAMES = 3  # with a hand before it is reported: MediaPipe sometimes finds one where nobody holds one
AWAY_S = 3.0  # a hand that was away for longer gets a new neutral pose
SAME_SIZES = 1.0  # a hand moves by less than its size in the image from one frame to the next
FARTHEST_MM = 1000.0
WORST_RESIDUAL = 0.2  # the filmed hand has 0.08 in the median, 0.16 in the worst hundredth
JUMP_MM_S = 2000.0  # a hand moves no farther between two frames
JUMP_RAD = math.radians(30.0)
JUMP_RAD_S = math.radians(600.0)
SLOW_RATE_HZ = 22.0  # a lower frame rate is said

NO_HAND = "No hand is seen."
SEVERAL = "More than two hands are seen; the two most certain ones count."
UNCLEAR = "The hand is not clear: turn its palm or its back to the camera."
JUMPS = "The hand is seen in two ways by turns: turn its palm or its back to the camera."
CUT = "The hand is cut off by the image's edge."
CUT_FINGERS = "Some fingers are cut off by the image's edge."
TOO_DARK = "It is too dark; turn a light on."
RATHER_DARK = "It is rather dark; more light makes the hand steadier."
HOLD_STILL = "Hold the hand still for a second, as feels natural: this becomes level, and the middle of the box."


@dataclass(frozen=True)
class SeenHand:
    """A hand that was found in an image."""

    side: str  # "right" or "left"
    score: float  # how sure that is, 0.5 to 1
    landmarks: np.ndarray  # in the image, 0 to 1 from left to right and from top to bottom, shape (21, 2)
    rays: np.ndarray  # see palm_pose.py, shape (21, 2)
    world: np.ndarray  # see palm_pose.py, shape (21, 3)


@dataclass(frozen=True)
class FrameHands:
    """What a frame shows."""

    hands: list[ReportedHand]
    remark: str  # one sentence about what is missing; empty if nothing is
    rate: float  # of the frames [Hz]
    distances: list[float]  # of the hands from the camera [mm]


@dataclass(eq=False)
class _Track:
    """A hand over its frames."""

    id: int
    side: str
    born: float  # [s]
    seen: float  # when it was trusted last [s]
    centre: np.ndarray  # of its palm's rays, shape (2,)
    frames: int = 0  # in which it was trusted
    other_side: int = 0
    hand: CameraHand | None = None
    report: ReportedHand | None = None


class HandTracks:
    """Follows the hands in front of a camera over its frames; `palm_width`: of the person [mm]."""

    def __init__(self, camera: CameraPlacement, palm_width: float) -> None:
        rate_frames = 30
        self.camera = camera
        self._palm_width = palm_width
        self._tracks: list[_Track] = []
        self._last_id = 0
        self._neutral = {side: NeutralPose() for side in ("right", "left")}
        self._seen_at = dict.fromkeys(self._neutral, -math.inf)
        self._centred = not camera.neutral
        self._stamps: deque[float] = deque(maxlen=rate_frames)
        self._renewed = False
        self._settled = -math.inf

    def renew(self) -> None:
        """Forgets the neutral poses and the middle of the box; they are taken anew. Until then the axes of a hand are
        others all at once, so that nothing may continue with it: for SETTLE_S no hand is reported, then new ones.
        """
        self._renewed = True
        self._tracks.clear()
        self._centred = not self.camera.neutral
        for neutral in self._neutral.values():
            neutral.forget()

    @property
    def centred(self) -> bool:
        return self._centred

    def step(self, seen: Sequence[SeenHand], brightness: float, now: float) -> FrameHands:
        """Returns the hands of a frame that was taken at `now` [s], in Leap axes; `brightness`: the image's mean, 0
        to 255."""
        dark = 25.0  # mean brightness of the image, 0 to 255
        dim = 50.0
        self._stamps.append(now)
        if self._renewed:
            self._renewed, self._settled = False, now + SETTLE_S
        self._tracks = [track for track in self._tracks if now - track.seen <= KEPT_S]
        remarks = [TOO_DARK] if brightness < dark else []
        if brightness >= dark:
            light = min(1.0, 0.3 + 0.7 * (brightness - dark) / (dim - dark))
            remarks += self._follow(seen, light, now)
        reported = [track for track in self._tracks if track.seen == now and track.frames >= LEAST_FRAMES]
        hands = [track.report for track in reported if track.report is not None and now >= self._settled]
        rate = self._rate()
        if 0.0 < rate < SLOW_RATE_HZ:
            slow = f"Only {rate:.0f} frames per second; the arm needs {ENOUGH_RATE_HZ:g}."
            remarks.append(f"{slow} More light or fewer programs help.")
        if brightness < dim:
            remarks.append(RATHER_DARK)
        distances = [track.hand.distance for track in reported if track.hand is not None]
        return FrameHands(hands, remarks[0] if remarks else "", rate, distances)

    def _follow(self, seen: Sequence[SeenHand], light: float, now: float) -> list[str]:
        most_hands = 2
        found = sorted((s for s in seen if _finite(s)), key=lambda s: (self._distance(s), -s.score))
        taken: list[tuple[np.ndarray, float]] = []
        remarks: list[str] = []
        for hand in found:
            rays = hand.rays[PALM]
            centre, size = rays.mean(axis=0), float(np.abs(rays - rays.mean(axis=0)).max())
            if any(np.linalg.norm(centre - other) < max(size, other_size) for other, other_size in taken):
                continue  # the same hand, found twice
            taken.append((centre, size))
            if len(taken) <= most_hands:
                remarks.append(self._judge(hand, centre, size, light, now))
        if len(taken) > most_hands:
            remarks.append(SEVERAL)
        return [remark for remark in remarks if remark] if taken else [NO_HAND]

    def _distance(self, seen: SeenHand) -> float:
        """Returns how far a hand is from the nearest one that is followed, in its own sizes, infinite for a new one:
        a hand that is followed comes before a surer one that reaches over it."""
        rays = seen.rays[PALM]
        centre, size = rays.mean(axis=0), float(np.abs(rays - rays.mean(axis=0)).max())
        followed = [track.centre for track in self._tracks if track.frames >= LEAST_FRAMES]
        nearest = min((float(np.linalg.norm(other - centre)) for other in followed), default=math.inf)
        return nearest / size if nearest < SAME_SIZES * size else math.inf

    def _judge(self, seen: SeenHand, centre: np.ndarray, size: float, light: float, now: float) -> str:
        far_mm = 700.0  # beyond it the confidence falls
        track = self._track(seen, centre, size, now)
        hand = camera_hand(track.side, seen.rays, seen.world, self._palm_width)
        fault = _fault(seen, hand)
        if fault or hand is None:
            return fault or UNCLEAR
        if track.hand is not None and _jumps(track.hand, hand, now - track.seen):
            return JUMPS
        remark = "" if _inside(seen.landmarks) else CUT_FINGERS
        certain = min(1.0, 2.0 * (seen.score - 0.5)) * min(1.0, 1.5 - 5.0 * hand.residual) * light
        certain *= min(1.0, (FARTHEST_MM - hand.distance) / (FARTHEST_MM - far_mm)) * (0.5 if remark else 1.0)
        report, holds = self._report(track, hand, min(max(certain, 0.0), 1.0), now)
        if report is None:
            return UNCLEAR
        track.frames, track.seen, track.centre = track.frames + 1, now, centre
        track.hand, track.report = hand, report
        return remark if holds else HOLD_STILL

    def _track(self, seen: SeenHand, centre: np.ndarray, size: float, now: float) -> _Track:
        other_side_frames = 5  # in a row, in which a hand is called the other one, before it counts as that
        for track in self._tracks:
            if track.seen < now and np.linalg.norm(track.centre - centre) < SAME_SIZES * size:
                track.other_side = track.other_side + 1 if seen.side != track.side else 0
                if track.other_side < other_side_frames:
                    return track
                self._tracks.remove(track)
                break
        self._last_id += 1
        self._tracks.append(_Track(self._last_id, seen.side, now, now - 1e-6, centre))
        return self._tracks[-1]

    def _report(
        self, track: _Track, hand: CameraHand, confidence: float, now: float
    ) -> tuple[ReportedHand | None, bool]:
        """Returns the hand in Leap axes, None where no hand has such joints, and whether its neutral pose is known."""
        palm, axes, holds = self.camera.palm(hand), self.camera.axes @ hand.axes, True
        if self.camera.neutral:
            neutral = self._neutral[track.side]
            if now - self._seen_at[track.side] > AWAY_S:
                neutral.forget()
            self._seen_at[track.side] = now
            known = neutral.level is not None
            neutral.step(palm, axes, now)
            holds = neutral.level is not None
            if holds and not known:  # its axes are others all at once: it is withheld for a moment, as a new one is
                track.frames, track.report = 0, None
            if neutral.level is not None:
                axes = axes @ neutral.level
                if not self._centred and neutral.middle is not None:
                    self._centred = True
                    self.camera = self.camera.centred(neutral.middle)
                    self._last_id += 1  # the hand is elsewhere all at once
                    track.id, track.born, track.report = self._last_id, now, None
                    palm = self.camera.palm(hand)
            else:
                confidence = 0.0
        joints, wrist = palm + hand.joints @ axes.T, palm + axes @ hand.wrist
        try:
            age = now - track.born
            return hand_from_joints(track.id, track.side, joints, wrist, age, confidence, track.report), holds
        except ValueError:
            return None, holds

    def _rate(self) -> float:
        span = self._stamps[-1] - self._stamps[0]
        return (len(self._stamps) - 1) / span if span > 0.0 else 0.0


def _finite(seen: SeenHand) -> bool:
    numbers = np.concatenate([seen.landmarks.ravel(), seen.rays.ravel(), seen.world.ravel(), [seen.score]])
    return bool(np.isfinite(numbers).all())


def _inside(landmarks: np.ndarray) -> bool:
    return bool((landmarks >= 0.0).all() and (landmarks <= 1.0).all())


def _fault(seen: SeenHand, hand: CameraHand | None) -> str:
    nearest_mm = 200.0
    if not _inside(seen.landmarks[PALM]):
        return CUT
    if hand is None or hand.residual > WORST_RESIDUAL:
        return UNCLEAR
    if hand.distance < nearest_mm:
        return f"The hand is too near, {hand.distance / 10:.0f} cm; the camera needs {nearest_mm / 10:g} cm."
    if hand.distance > FARTHEST_MM:
        return f"The hand is too far away, {hand.distance / 10:.0f} cm; up to {FARTHEST_MM / 10:g} cm is possible."
    return ""


def _jumps(before: CameraHand, hand: CameraHand, elapsed: float) -> bool:
    jump_mm = 60.0  # a hand moves no farther between two frames
    turned = math.acos(min(max(0.5 * (float(np.trace(before.axes.T @ hand.axes)) - 1.0), -1.0), 1.0))
    moved = float(np.linalg.norm(hand.palm - before.palm))
    return moved > jump_mm + JUMP_MM_S * elapsed or turned > JUMP_RAD + JUMP_RAD_S * elapsed
