"""Where a tracker stands: the rigid transform T_desk_leap from the tracker's own axes to those of the desk, which are
like the Leap's. The person touches the points with the tip of the index finger, within some 3 mm; half the finger's
thickness (FINGER_M) is the same everywhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from leap_motion.frames import INDEX, LeapBone, LeapFrame, LeapHand

SHEET = {"far left": (-0.1, -0.07), "far right": (0.1, -0.07), "near right": (0.1, 0.07), "near left": (-0.1, 0.07)}
"""Marks of the sheet: x and z from its centre [m]."""
FINGER_M = 0.008  # of the tip's centre above what it touches

PLACED_ANEW = ("WebXR", "WC-front")
"""Serials of trackers whose axes each session, or each neutral pose, places elsewhere: a headset, a webcam in front."""

MAX_TURN_DEG = 60.0  # of a tracker against the desk: beyond this, points were mixed up or mirrored

HOLD_S = 1.0  # time over which a tip is averaged
MIN_FRAMES = 10  # of that time


class RegistrationRefused(ValueError):
    """A hand, or points, that cannot be used; the text says why and what to do."""


@dataclass(frozen=True, eq=False)
class PointFit:
    """The transform that fits the points best."""

    T_desk_leap: np.ndarray  # shape (4, 4) [m]
    residuals: np.ndarray  # distance of each point from where it was shown, shape (n,) [m]
    scale: float  # distances by the tracker to those shown; 1 where they are not known


def check_serial(serial: str) -> None:
    """Raises RegistrationRefused for a tracker that does not stand anywhere for long."""
    if serial in PLACED_ANEW:
        raise RegistrationRefused(
            f"The tracker {serial} places its axes anew for each operator, level already: a registration would turn "
            "and shift the next one's hand. Use none."
        )


def sheet_points(height: float) -> dict[str, tuple[float, float, float]]:
    """Returns the points `height` [m] above the marks of the sheet, by name."""
    return {name: (x, height, z) for name, (x, z) in SHEET.items()}


def check_points(points: Mapping[str, ArrayLike]) -> None:
    """Raises RegistrationRefused if points, (x, y, z) [m] each, are too few, too near each other or on one line."""
    min_points = 3
    min_distance_m = 0.05  # between two points
    min_width_m = 0.02  # rms distance of the points from a line
    if len(points) < min_points:
        raise RegistrationRefused(f"A registration needs at least {min_points} points, not {len(points)}.")
    for (one, p), (other, q) in combinations(points.items(), 2):
        distance = float(np.linalg.norm(np.subtract(p, q)))
        if not distance >= min_distance_m:
            raise RegistrationRefused(
                f"The points {one} and {other} are {1e3 * distance:.0f} mm apart; at least {1e3 * min_distance_m:.0f} "
                "mm are needed."
            )
    xyz = np.array(list(points.values()))
    width = np.linalg.svd(xyz - xyz.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(xyz))
    if not width >= min_width_m:
        raise RegistrationRefused(
            f"The points lie on one line within {1e3 * width:.0f} mm, so the turn about it is unknown: choose "
            "points that span an area."
        )


def fit(shown: Mapping[str, Sequence[float]], touched: Mapping[str, np.ndarray]) -> PointFit:
    """Returns the least-squares fit (Kabsch 1976) of the points touched, shape (3,) [m] each in the tracker's axes,
    to those shown on the desk, with the same names. Raises RegistrationRefused as `check_points` does."""
    check_points(shown)
    check_points(touched)
    desk = np.array([shown[name] for name in touched]) + np.array([0.0, FINGER_M, 0.0])
    leap = np.array(list(touched.values()))
    desk_mean, leap_mean = desk.mean(axis=0), leap.mean(axis=0)
    U, _, Vt = np.linalg.svd((desk - desk_mean).T @ (leap - leap_mean))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    T = _pose(R, desk_mean - R @ leap_mean)
    residuals = np.linalg.norm(leap @ R.T + T[:3, 3] - desk, axis=1)
    return PointFit(T, residuals, float(np.linalg.norm(leap - leap_mean) / np.linalg.norm(desk - desk_mean)))


def fit_level(touched: Mapping[str, np.ndarray]) -> PointFit:
    """Returns the smallest rotation that makes points of one height, shape (3,) [m] each in the tracker's axes,
    level; the origin stays. Raises RegistrationRefused as `check_points` does."""
    check_points(touched)
    leap = np.array(list(touched.values()))
    away = leap - leap.mean(axis=0)
    normal = np.linalg.svd(away)[2][2]
    x, y, z = normal * np.copysign(1.0, normal[1])
    cross = np.array([[0.0, -x, 0.0], [x, 0.0, z], [0.0, -z, 0.0]])  # of the normal and the vertical
    return PointFit(_pose(np.eye(3) + cross + cross @ cross / (1.0 + y), np.zeros(3)), np.abs(away @ normal), 1.0)


def check_fit(found: PointFit, names: Sequence[str], limit: float, scale_limit: float) -> None:
    """Raises RegistrationRefused for a residual above `limit` [m], a scale farther than `scale_limit` from 1, or a
    tracker that would be turned by more than MAX_TURN_DEG."""
    turn = turn_deg(found.T_desk_leap)
    if not turn <= MAX_TURN_DEG:
        raise RegistrationRefused(
            f"The tracker would be turned by {turn:.0f} deg: touch the points in the order asked for, with the "
            "tracker's front to you."
        )
    if not abs(found.scale - 1.0) <= scale_limit:
        raise RegistrationRefused(
            f"By the tracker the points are {100.0 * (found.scale - 1.0):+.1f} % farther apart than stated, the limit "
            f"is {100.0 * scale_limit:.1f} %: check that the sheet was printed at 100 %."
        )
    worst = int(np.argmax(found.residuals))
    if not found.residuals[worst] <= limit:
        raise RegistrationRefused(
            f"The point {names[worst]} is off by {1e3 * found.residuals[worst]:.1f} mm, the limit is {1e3 * limit:.1f} "
            "mm: touch the points again, all with the same part of the finger tip."
        )


def turn_deg(T: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(0.5 * (np.trace(T[:3, :3]) - 1.0), -1.0, 1.0))))


def tilt_deg(T: np.ndarray) -> float:
    """Returns the angle between the tracker's y axis and the vertical of its pose, shape (4, 4) [deg]."""
    return float(np.degrees(np.arccos(np.clip(T[1, 1], -1.0, 1.0))))


def still_tip(frames: Sequence[LeapFrame]) -> np.ndarray:
    """Returns the mean tip of the index finger, shape (3,) [m], over frames of HOLD_S. Raises RegistrationRefused
    unless one hand is seen well, with its index finger stretched, and holds still."""
    min_fraction = 0.9  # of the frames, that show the hand
    min_confidence = 0.3
    still_m = 0.004  # of 90 % of the tips from their median: a hand moves by less than 9 mm/s
    if len(frames) < MIN_FRAMES:
        raise RegistrationRefused(f"Only {len(frames)} frames came within {HOLD_S:g} s: is the tracker slow or paused?")
    if any(len(frame.hands) > 1 for frame in frames):
        raise RegistrationRefused("Two hands are in view: show only the one that touches the point.")
    hands = [frame.hands[0] for frame in frames if frame.hands]
    if len(hands) < min_fraction * len(frames):
        raise RegistrationRefused("The tracker does not see the hand all the time: bring it over the tracker.")
    if len({hand.id for hand in hands}) > 1:
        raise RegistrationRefused("The tracker lost the hand in between: keep it in view.")
    if min(hand.confidence for hand in hands) < min_confidence:
        raise RegistrationRefused(
            "The tracker is unsure of the hand: turn the palm down and spread the fingers a little."
        )
    fingers = [finger for hand in hands for finger in hand.fingers if finger.type == INDEX and finger.extended]
    if len(fingers) < min_fraction * len(frames):
        raise RegistrationRefused("The index finger is not stretched.")
    tips = np.array([finger.tip for finger in fingers])
    away = np.sort(np.linalg.norm(tips - np.median(tips, axis=0), axis=1))[int(0.9 * (len(tips) - 1))]
    if not away <= still_m:
        raise RegistrationRefused(f"The finger moved by {1e3 * away:.0f} mm; hold it still on the point.")
    return tips.mean(axis=0)


def registered(frame: LeapFrame, T_desk_leap: np.ndarray) -> LeapFrame:
    """Returns the frame with all positions, directions, orientations and velocities in the axes of the desk."""
    R, p = T_desk_leap[:3, :3], T_desk_leap[:3, 3]
    return replace(frame, hands=tuple(_registered(hand, R, p) for hand in frame.hands))


def _registered(hand: LeapHand, R: np.ndarray, p: np.ndarray) -> LeapHand:
    def turned(vectors: np.ndarray) -> np.ndarray:
        return _read_only(vectors @ R.T)

    def moved(points: np.ndarray) -> np.ndarray:
        return _read_only(points @ R.T + p)

    def rotated(rotations: np.ndarray) -> np.ndarray:
        return _read_only(R @ rotations)

    arm = hand.arm
    return replace(
        hand,
        palm=moved(hand.palm),
        normal=turned(hand.normal),
        direction=turned(hand.direction),
        velocity=turned(hand.velocity),
        sphere_center=moved(hand.sphere_center) if hand.sphere_radius else hand.sphere_center,
        fingers=tuple(
            replace(f, joints=moved(f.joints), rotations=rotated(f.rotations), tip=moved(f.tip)) for f in hand.fingers
        ),
        arm=None if arm is None else LeapBone(moved(arm.start), moved(arm.end), rotated(arm.rotation)),
    )


def _pose(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return _read_only(T)


def _read_only(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False
    return array
