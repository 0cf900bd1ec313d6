"""A recording as arrays, for tests, exports and replays. Times are seconds since the epoch, poses shape (n, 4, 4)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from common.frames import BASE, TOOL_DESIRED, TOOL_MEASURED, frame_name
from common.poses import pose
from common.rotations import rotation_from_quaternion
from leap_rig.recording import topics
from leap_rig.recording.recording_files import (
    MessageKind,
    RecordingFault,
    StoredMessage,
    between,
    verify,
)
from leap_rig.recording.ros1 import decoder

POSES = {"desired": TOOL_DESIRED, "tool": TOOL_MEASURED}  # the frames that are read from tf, by their fields
READ = (topics.RAW_FRAMES, topics.SENT_GOALS, topics.JOINTS, topics.HAND_STATE, topics.HAND_COMMAND, topics.TF)


@dataclass(frozen=True, eq=False)
class RecordedRun:
    """What `read` found; arrays without a message have length 0."""

    manifest: dict[str, Any]
    remark: str  # about a recording that was not completed; else empty
    frames: tuple[str, ...]  # texts of the Leap service, frames and device events, as they came
    frame_times: np.ndarray  # when the driver received each, shape (n,)
    desired: np.ndarray  # T_base_tool, the desired tool frame, shape (n, 4, 4) [m]
    desired_times: np.ndarray  # its stamps, shape (n,)
    goals: np.ndarray  # as sent to the robot, shape (n, 7) [rad]
    goal_times: np.ndarray  # when they were sent, shape (n,)
    goal_velocities: np.ndarray  # of PTP motions, fraction of the full joint speed, shape (n,); 0: a servo goal
    joints: np.ndarray  # measured, shape (n, 7) [rad]
    joint_times: np.ndarray
    hand: np.ndarray  # motor angles of index, middle, thumb and spread, shape (n, 4) [rad]
    hand_times: np.ndarray  # when the recorder received them: the message has no stamp
    hand_commands: np.ndarray  # likewise
    hand_command_times: np.ndarray
    tool: np.ndarray  # T_base_tool at the measured joints, shape (n, 4, 4) [m]
    tool_times: np.ndarray  # when the controller published it, shape (n,)


class MessageDecoders:
    """Decodes stored messages; each type's definition is read once."""

    def __init__(self) -> None:
        self._decoders: dict[MessageKind, Callable[[bytes], dict[str, Any]]] = {}

    def __call__(self, message: StoredMessage) -> dict[str, Any]:
        """Returns the fields of a message; raises MessageFault."""
        if message.kind not in self._decoders:
            self._decoders[message.kind] = decoder(message.kind.name, message.kind.definition)
        return self._decoders[message.kind](message.data)


def read(folder: Path, start: float = 0.0, end: float = float("inf")) -> RecordedRun:
    """Returns a recording, or what was received between `start` and `end` [s] after its start. Raises RecordingFault,
    of a file that is missing or was changed, or MessageFault."""
    manifest, remark = verify(folder)
    decode = MessageDecoders()
    found: dict[str, list[tuple[int, Any]]] = {key: [] for key in (*READ, *POSES)}
    for message in between(folder, READ, start, end):
        keys: tuple[str, ...] = (message.topic,)
        if message.topic == topics.TF:
            keys = tuple(field for field, frame in POSES.items() if frame.encode() in message.data)
            if not keys:
                continue
        try:
            value = decode(message)
            for key in keys:
                found[key].extend(_rows(key, message.received, value))
        except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
            raise RecordingFault(f"A message on {message.topic} is not one of this rig: {error!r}.") from error

    def arrays(topic: str, *shape: int) -> tuple[np.ndarray, np.ndarray]:
        values = np.array([row for _, row in found[topic]], dtype=float).reshape(-1, *shape)
        return values, _seconds([time for time, _ in found[topic]])

    frames = found[topics.RAW_FRAMES]
    goals, goal_times = arrays(topics.SENT_GOALS, 8)
    return RecordedRun(
        manifest, remark, tuple(text for _, text in frames), _seconds([time for time, _ in frames]),
        *arrays("desired", 4, 4), goals[:, :7], goal_times, goals[:, 7],
        *arrays(topics.JOINTS, 7), *arrays(topics.HAND_STATE, 4), *arrays(topics.HAND_COMMAND, 4),
        *arrays("tool", 4, 4),
    )  # fmt: skip


def _rows(topic: str, received: int, value: dict[str, Any]) -> list[tuple[int, Any]]:
    """Returns what a message holds: times [ns] and what was then; for a goal its joints and velocity. A tf message has
    a key of POSES instead of its topic. Raises whatever a message with other fields makes."""
    if topic == topics.RAW_FRAMES:
        if not isinstance(value["text"], str):
            raise TypeError("the text is not a string")
        rows: list[tuple[int, Any]] = [(value["received"], value["text"])]
    elif topic == topics.SENT_GOALS:
        sent, joints, velocity = value["sent"].tolist(), value["joints"].reshape(-1, 7), value["velocity"]
        if not len(sent) == len(joints) == len(velocity):
            raise ValueError(f"{len(sent)} times, {len(joints)} goals and {len(velocity)} velocities")
        rows = list(zip(sent, np.column_stack([joints, velocity])))
    elif topic == topics.JOINTS:
        rows = [(value["header"]["stamp"], _numbers([value[f"joint_{i}"] for i in range(1, 8)], 7))]
    elif topic == topics.HAND_STATE:
        rows = [(received, _numbers([motor["joint_angle"] for motor in value["motor"]], 4))]
    elif topic == topics.HAND_COMMAND:
        rows = [(received, _numbers(value["radian_commands"], 4))]
    else:
        rows = pose_in_base(value["transforms"], POSES[topic])
    _seconds([time for time, _ in rows])
    return rows


def _numbers(values: Any, count: int) -> np.ndarray:
    numbers = np.array(values, dtype=float)
    if numbers.shape != (count,):
        raise ValueError(f"{numbers.shape} numbers instead of {count}")
    return numbers


def _seconds(nanoseconds: list[int]) -> np.ndarray:
    return np.array(nanoseconds, dtype=np.int64) * 1e-9


def pose_in_base(transforms: Iterable[dict[str, Any]], frame: str) -> list[tuple[int, np.ndarray]]:
    """Returns the stamp [ns] of a frame and its pose in the base, shape (4, 4) [m]; nothing if the transforms of this
    message do not lead to the base, or one of them is no pose."""
    max_chain = 10  # transforms from a frame to the base
    by_child = {frame_name(transform["child_frame_id"]): transform for transform in transforms}
    T, name = np.eye(4), frame
    for _ in range(max_chain):
        if name == BASE:
            return [(by_child[frame]["header"]["stamp"], T)]
        if name not in by_child:
            return []
        value = by_child[name]["transform"]
        p, q = value["translation"], value["rotation"]
        try:
            T = pose(rotation_from_quaternion([q[i] for i in "xyzw"]), np.array([p[i] for i in "xyz"])) @ T
        except ValueError:
            return []
        name = frame_name(by_child[name]["header"]["frame_id"])
    return []
