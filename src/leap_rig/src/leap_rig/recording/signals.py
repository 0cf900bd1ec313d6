"""What else a recording holds for training, besides joints and images: numbers by topic, and each row's newest of them.

A row knows only what had been received by its time. Numbers of which nothing had come yet are 0, and their age is -1.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from common.robot_hand import HAND
from common.rotations import quaternions_from_rotations, steady_quaternion
from leap_rig.recording import topics
from leap_rig.recording.episode import ARM as JOINTS
from leap_rig.recording.recording_files import RecordingFault, between
from leap_rig.recording.run import MessageDecoders, RecordedRun

FINGERS = "index", "middle", "thumb"
TAXELS = tuple(f"{finger}_{i}" for finger in FINGERS for i in range(9))
POSE = "x", "y", "z", "qx", "qy", "qz", "qw"
FAR_M = 10.0  # of a guard that sees nothing
BACK_S = 0.05  # over which a joint's velocity is measured


class Signal(NamedTuple):
    """Numbers of a topic's messages."""

    key: str  # in the dataset
    topic: str
    names: tuple[str, ...]
    unit: str  # of all, as each name says where they differ
    numbers: Callable[[Mapping[str, Any]], Sequence[float]]


def _joints(message: Mapping[str, Any]) -> list[float]:
    return [message[f"joint_{i}"] for i in range(1, 8)]


def _of_vector(message: Mapping[str, Any]) -> list[float]:
    return [message["vector"][axis] for axis in "xyz"]


def _of_taxels(name: str) -> Callable[[Mapping[str, Any]], Sequence[float]]:
    return lambda message: [float(value) for finger in message["finger"] for value in finger[name]]


def _of_fingers(message: Mapping[str, Any]) -> list[float]:
    return [finger[joint] for joint in ("proximal", "distal_approx") for finger in message["finger"]]


def _of_controller(message: Mapping[str, Any]) -> list[float]:
    on = [float(message[name]) for name in ("control_on", "gripper_on")]
    return [*on, message["scaling_factor"], float(bool(message["limited_by"])), message["round_trip"]]


def _of_guard(message: Mapping[str, Any]) -> list[float]:
    return [float(message["on"]), min(message["distance"], FAR_M), message["scale"]]


def _of_teleoperation(message: Mapping[str, Any]) -> list[float]:
    return [float(message[name]) for name in ("follows", "enabled", "clutched")] + [float(bool(message["limits"]))]


def _of_tracker(message: Mapping[str, Any]) -> list[float]:
    try:
        hands = json.loads(message["text"]).get("hands", [])
        return [float(len(hands)), max((float(hand.get("confidence", 0.0)) for hand in hands), default=0.0)]
    except (AttributeError, TypeError, ValueError):
        return [0.0, 0.0]  # no frame, and so no hand


STATE = f"/{HAND.state}"
SIGNALS = (
    Signal("observation.external_torque", "/kuka/joint_torques_external", JOINTS, "Nm", _joints),
    Signal("observation.measured_torque", "/kuka/joint_torques_measured", JOINTS, "Nm", _joints),
    Signal("observation.flange_force", "/kuka/flange_force", ("x", "y", "z"), "N", _of_vector),
    Signal("observation.flange_torque", "/kuka/flange_torque", ("x", "y", "z"), "Nm", _of_vector),
    Signal("observation.taxel_pressure", STATE, TAXELS, "counts above zero", _of_taxels("pressure")),
    Signal("observation.taxel_contact", STATE, TAXELS, "0 or 1", _of_taxels("contact")),
    Signal(
        "observation.finger_joints",
        STATE,
        tuple(f"{finger}_{joint}" for joint in ("proximal", "distal") for finger in FINGERS),
        "rad",
        _of_fingers,
    ),
    Signal(
        "observation.motor_load",
        STATE,
        HAND.motors,
        "0.1 % of the largest torque",
        lambda message: [motor["load"] for motor in message["motor"]],
    ),
    Signal(
        "observation.controller",
        "/kuka/status",
        ("control_on", "gripper_on", "scaling_factor", "limited", "round_trip_s"),
        "0 or 1 but for the factor and s",
        _of_controller,
    ),
    Signal("observation.guard", "/kuka/guard", ("on", "distance_m", "scale"), "0 or 1, m, 0 to 1", _of_guard),
    Signal(
        "observation.teleoperation",
        "/leap_kuka/state",
        ("follows", "enabled", "clutched", "at_limit"),
        "0 or 1",
        _of_teleoperation,
    ),
    Signal("observation.tracker", topics.RAW_FRAMES, ("hands", "confidence"), "hands, 0 to 1", _of_tracker),
)
AGE = "observation.age"


class SignalTable(NamedTuple):
    """Signals at the rows of an episode."""

    names: Mapping[str, tuple[str, ...]]  # of the numbers, by key
    units: Mapping[str, str]
    rows: Mapping[str, np.ndarray]  # shape (n, number of names), by key


def read_signals(folder: Path, times: np.ndarray, run: RecordedRun) -> SignalTable:
    """Returns all signals at `times`, shape (n,), since the epoch [s]; raises RecordingFault for a message of another
    kind."""
    wanted: dict[str, list[Signal]] = {}
    for signal in SIGNALS:
        wanted.setdefault(signal.topic, []).append(signal)
    received: dict[str, list[float]] = {topic: [] for topic in wanted}
    found: dict[str, list[Sequence[float]]] = {signal.key: [] for signal in SIGNALS}
    decode = MessageDecoders()
    for message in between(folder, wanted, 0.0, float("inf")):
        try:
            fields = decode(message)
            numbers = {signal.key: list(map(float, signal.numbers(fields))) for signal in wanted[message.topic]}
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise RecordingFault(f"A message on {message.topic} is not one of this rig: {error!r}.") from error
        received[message.topic].append(1e-9 * message.received)
        for key, row in numbers.items():
            found[key].append(row)
    rows, ages = {}, {}
    for signal in SIGNALS:
        values = np.array(found[signal.key], float).reshape(-1, len(signal.names))
        rows[signal.key], ages[signal.topic] = held(np.array(received[signal.topic]), values, times)
    names = {signal.key: signal.names for signal in SIGNALS}
    units = {signal.key: signal.unit for signal in SIGNALS}
    for key, of, at in (
        ("observation.tool_pose", run.tool, run.tool_times),
        ("action.desired_tool", run.desired, run.desired_times),
    ):
        rows[key], ages[key] = held(at, _flat(of), times)
        names[key], units[key] = POSE, "m, and a quaternion, in kuka/base_frame"
    rows["observation.velocity"] = _velocities(run, times)
    names["observation.velocity"], units["observation.velocity"] = JOINTS, "rad/s"
    rows[AGE] = np.column_stack(list(ages.values()))
    names[AGE], units[AGE] = tuple(name.strip("/").replace("/", ".") for name in ages), "s since it came; -1: never yet"
    return SignalTable(names, units, rows)


def held(times: np.ndarray, values: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the newest of `values`, shape (m, k), that had come by each time, shape (n, k), and its age [s]; 0 and -1
    before the first one. `times`: when each came, shape (m,)."""
    order = np.argsort(times, kind="stable")
    index = np.searchsorted(times[order], at, side="right") - 1
    there = index >= 0
    rows, age = np.zeros((len(at), values.shape[1])), np.full(len(at), -1.0)
    rows[there] = values[order][index[there]]
    age[there] = at[there] - times[order][index[there]]
    return rows, age


def moving(action: np.ndarray, fps: int) -> slice:
    """Returns the rows from half a second before the first motion of an action to half a second behind the last one;
    all where nothing moves. `action`: shape (n, k) [rad]."""
    still_rad_s, margin_s = 0.02, 0.5
    moved = np.flatnonzero((np.abs(np.diff(action, axis=0)) * fps > still_rad_s).any(axis=1))
    if not len(moved):
        return slice(0, len(action))
    margin = round(margin_s * fps)
    return slice(max(0, int(moved[0]) - margin), min(len(action), int(moved[-1]) + 2 + margin))


def _flat(T: np.ndarray) -> np.ndarray:
    q = quaternions_from_rotations(T[:, :3, :3])
    return np.hstack([T[:, :3, 3], steady_quaternion(q)])


def _velocities(run: RecordedRun, times: np.ndarray) -> np.ndarray:
    """Returns how fast the joints had turned over the last `BACK_S`, shape (n, 7) [rad/s]."""
    now, age = held(run.joint_times, run.joints, times)
    before, older = held(run.joint_times, run.joints, times - BACK_S)
    passed = BACK_S + older - age
    known = (age >= 0.0) & (older >= 0.0) & (passed > 0.0)
    return np.where(known[:, None], (now - before) / np.where(known, passed, 1.0)[:, None], 0.0)
