"""A recorded motion as what a program may ask the controller for: PTP motions, and straight lines of the tool."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from common.rotations import rotation_angle, scaled_rotation
from leap_rig.recording.recording_files import RecordingFault

LEVER_M = 0.2  # a turn of the tool counts as a way of so much for each rad [m]
OFF_M = 0.005  # the lines stay within this of the path [m]


@dataclass(frozen=True, eq=False)
class RecordedLine:
    """One line: where it ends, and the mean speed on it, turns included."""

    T_base_tool: np.ndarray  # shape (4, 4) [m]
    velocity: float  # [m/s]


@dataclass(frozen=True, eq=False)
class StreamedMotion:
    """One stream of servo goals: the joints where it begins, and its path."""

    q_start: np.ndarray  # shape (7,) [rad]
    times: np.ndarray  # shape (n,) [s]
    poses: np.ndarray  # of the tool, shape (n, 4, 4) [m]


def streamed_motions(
    times: np.ndarray, goals: np.ndarray, velocities: np.ndarray, forward: Callable[[np.ndarray], np.ndarray]
) -> list[StreamedMotion]:
    """Returns the streams among the goals that were sent: at `times`, shape (n,) [s], joints, shape (n, 7) [rad], and
    `velocities` of PTP motions, shape (n,), 0 for servo goals. `forward` returns the tool pose of joints. A clock that
    was set back parts two streams too. Raises RecordingFault for a goal that is not finite."""
    pause_s = 0.5  # a longer pause between two servo goals parts two motions
    smallest_m = 0.002  # a part that moves the tool less is left out: the identification of the servo law does so
    bad = np.flatnonzero(~np.isfinite(goals).all(axis=1) | ~np.isfinite(velocities))
    if len(bad):
        raise RecordingFault(f"Goal {bad[0]} of the recording is not finite: {goals[bad[0]].tolist()}.")
    steps = np.diff(times)
    ends = np.flatnonzero((velocities[:-1] != 0.0) | (steps > pause_s) | (steps < 0.0)) + 1
    motions = []
    for part in np.split(np.arange(len(times)), ends):
        part = part[velocities[part] == 0.0]
        poses = np.array([forward(q) for q in goals[part]])
        if len(part) and max(distance(poses[0], T) for T in poses) > smallest_m:
            motions.append(StreamedMotion(goals[part[0]], times[part], poses))
    return motions


def lines_along(times: np.ndarray, poses: np.ndarray, rate: float, fastest: float) -> list[RecordedLine]:
    """Returns lines along poses, shape (n, 4, 4) [m], at `times` [s], shape (n,), `rate` times as fast as recorded, at
    most `fastest` [m/s]. They begin at the first pose."""
    sample_s = 0.05  # poses are taken from the path this often
    slowest_m_per_s = 0.01
    kept = [0]
    for i in range(1, len(times)):
        if times[i] - times[kept[-1]] >= sample_s or i == len(times) - 1:
            kept.append(i)
    corners = _corners(poses[kept])
    lines = []
    for a, b in zip(corners, corners[1:]):
        first, last = kept[a], kept[b]
        seconds = max(times[last] - times[first], sample_s) / rate
        speed = distance(poses[first], poses[last]) / seconds
        lines.append(RecordedLine(poses[last], float(min(max(speed, slowest_m_per_s), fastest))))
    return lines


def distance(T_a: np.ndarray, T_b: np.ndarray) -> float:
    """Returns the way between two poses, shape (4, 4) [m]: of the tool point, or of its turn if that is longer."""
    turn = rotation_angle(T_a[:3, :3].T @ T_b[:3, :3])
    return max(float(np.linalg.norm(T_b[:3, 3] - T_a[:3, 3])), LEVER_M * turn)


def _corners(poses: np.ndarray) -> list[int]:
    """Returns the numbers of the poses between which straight lines stay within OFF_M (Douglas and Peucker 1973)."""
    corners, open_parts = {0, len(poses) - 1}, [(0, len(poses) - 1)]
    while open_parts:
        first, last = open_parts.pop()
        off = [_off(poses[i], poses[first], poses[last], (i - first) / (last - first)) for i in range(first + 1, last)]
        if off and max(off) > OFF_M:
            worst = first + 1 + int(np.argmax(off))
            corners.add(worst)
            open_parts += [(first, worst), (worst, last)]
    found = sorted(corners)
    return [i for n, i in enumerate(found) if n == 0 or distance(poses[found[n - 1]], poses[i]) > 1e-4]


def _off(T: np.ndarray, T_a: np.ndarray, T_b: np.ndarray, share: float) -> float:
    """Returns how far a pose is from the line between two others; `share` of the way if the tool point stands."""
    way, here = T_b[:3, 3] - T_a[:3, 3], T[:3, 3] - T_a[:3, 3]
    length = float(way @ way)
    s = min(max(float(here @ way) / length, 0.0), 1.0) if length > OFF_M**2 else share
    R = T_a[:3, :3] @ scaled_rotation(T_a[:3, :3].T @ T_b[:3, :3], s)
    return max(float(np.linalg.norm(here - s * way)), LEVER_M * rotation_angle(R.T @ T[:3, :3]))
