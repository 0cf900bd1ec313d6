"""A recording as what a policy is trained on: rows of state and action at a fixed rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from common import robot_hand
from leap_rig.recording.recording_files import RecordingFault
from leap_rig.recording.run import RecordedRun

ARM = tuple(f"kuka_joint_{i}" for i in range(1, 8))
HAND = robot_hand.HAND.motors
CHANNELS = {"rgb8": (3, [0, 1, 2]), "bgr8": (3, [2, 1, 0]), "rgba8": (4, [0, 1, 2]), "bgra8": (4, [2, 1, 0])}
"""Encodings that can be exported: bytes of a pixel, and where among them its red, green and blue are."""
DEPTHS: dict[str, Any] = {"32FC1": np.dtype("<f4"), "16UC1": np.dtype("<u2")}  # in m, in mm
IMAGE = "sensor_msgs/Image"
DEPTH_CODE = "256 red + green [mm]; 0: no reading"


@dataclass(frozen=True, eq=False)
class TrainingEpisode:
    """Rows at `times`; arm joints first, then the hand's motors where the run has them. The state is what was measured
    last. The action of a row is what had been commanded one period later: the newest servo goal, or the measured joints
    while none was sent; and the newest command of the hand, or its angles before the first one."""

    names: tuple[str, ...]
    times: np.ndarray  # since the epoch, shape (n,) [s]
    state: np.ndarray  # shape (n, 7) or (n, 11) [rad]
    action: np.ndarray  # likewise


def training_episode(run: RecordedRun, fps: int) -> TrainingEpisode:
    """Returns the rows of a run, `fps` a second; RecordingFault if it has no measured joints, or time went back."""
    longest_s = 86400.0  # of an episode
    back_s = 0.05  # between two messages: time that goes back farther was set
    fresh_s = 0.1  # an older goal no longer moves the arm: between motions it is where it is
    parts = [(run.joint_times, run.joints)]
    if len(run.hand):
        parts.append((run.hand_times, run.hand))
    if not len(run.joints):
        raise RecordingFault("The recording has no measured joints, so there is nothing to learn from.")
    for times in (run.joint_times, run.hand_times, run.goal_times, run.hand_command_times):
        back = np.flatnonzero(np.diff(times) < -back_s)
        if len(back):
            step, after = times[back[0]] - times[back[0] + 1], times[back[0]] - times[0]
            raise RecordingFault(
                f"A clock was set back by {step:.3g} s, {after:.1f} s after the recording began, so its rows have no "
                "order; record it again."
            )
    begin, end = max(times[0] for times, _ in parts), min(times[-1] for times, _ in parts)
    if begin > end:
        raise RecordingFault("Arm and hand were measured at no time together, so there is nothing to learn from.")
    if end - begin > longest_s:
        raise RecordingFault(f"The recording spans {(end - begin) / 3600.0:.0f} hours: a clock was set while it ran.")
    times = begin + np.arange(int((end - begin) * fps) + 1) / fps
    later = times + 1.0 / fps
    state = np.hstack([_newest(*part, times)[0] for part in parts])
    action = np.hstack([_newest(*part, later)[0] for part in parts])
    servo = run.goal_velocities == 0.0
    _command(action[:, :7], run.goal_times[servo], run.goals[servo], later, fresh_s)
    if len(run.hand):
        _command(action[:, 7:], run.hand_command_times, run.hand_commands, later, np.inf)
    return TrainingEpisode(ARM + (HAND if len(run.hand) else ()), times, state, action)


def color_image(message: dict[str, Any]) -> np.ndarray:
    """Returns a decoded sensor_msgs/Image, shape (height, width, 3), red first; RecordingFault: another encoding."""
    height, width, step = message["height"], message["width"], message["step"]
    size, order = CHANNELS.get(message["encoding"], (0, []))
    if not size or step < size * width or len(message["data"]) < height * step:
        raise RecordingFault(
            f"Images of the encoding {message['encoding']!r} cannot be exported; complete {', '.join(CHANNELS)} can."
        )
    rows = np.frombuffer(message["data"], np.uint8, height * step).reshape(height, step)
    return np.ascontiguousarray(rows[:, : size * width].reshape(height, width, size)[..., order])


def depth_values(message: dict[str, Any]) -> np.ndarray:
    """Returns a decoded depth image, shape (height, width), in m as float32 or in mm as uint16; RecordingFault: another
    encoding."""
    height, width, step = message["height"], message["width"], message["step"]
    kind = DEPTHS.get(message["encoding"])
    if kind is None or step < kind.itemsize * width or len(message["data"]) < height * step or message["is_bigendian"]:
        raise RecordingFault(
            f"Depth images of the encoding {message['encoding']!r} cannot be exported; {', '.join(DEPTHS)} can."
        )
    rows = np.frombuffer(message["data"], np.uint8, height * step).reshape(height, step)
    return np.ascontiguousarray(rows[:, : kind.itemsize * width]).view(kind)


def depth_image(message: dict[str, Any]) -> np.ndarray:
    """Returns a decoded depth image as a picture, shape (height, width, 3), see DEPTH_CODE; RecordingFault: another
    encoding."""
    depth = depth_values(message)
    mm = depth if depth.dtype.kind == "u" else np.round(1000.0 * np.nan_to_num(depth, nan=0.0, posinf=0.0, neginf=0.0))
    counts = np.clip(mm, 0, 2**16 - 1).astype(np.uint16)
    return np.stack([counts >> 8, counts & 255, np.zeros_like(counts)], axis=-1).astype(np.uint8)


def _newest(times: np.ndarray, rows: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the newest row at each time, and how old it is [s]; negative where the first came later."""
    index = np.maximum(np.searchsorted(times, at, side="right") - 1, 0)
    return rows[index], at - times[index]


def _command(action: np.ndarray, times: np.ndarray, rows: np.ndarray, at: np.ndarray, fresh: float) -> None:
    """Replaces actions by commands where there is one that is not older than `fresh` [s]."""
    if len(times):
        newest, age = _newest(times, rows, at)
        given = (age >= 0.0) & (age <= fresh)
        action[given] = newest[given]
