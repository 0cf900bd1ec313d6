"""Recordings as episodes of a dataset: rows, signals and cameras at one rate, whatever format they then get."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from common.episode_marks import SUCCESS as SUCCEEDED
from leap_rig.lerobot.actions import ACTION as ROBOT_ACTION
from leap_rig.lerobot.actions import FINGERS, SILENT_S, SLOW_S
from leap_rig.lerobot.actions import STATE as ROBOT_STATE
from leap_rig.recording import topics
from leap_rig.recording.episode import (
    ARM,
    DEPTH_CODE,
    IMAGE,
    TrainingEpisode,
    color_image,
    depth_image,
    training_episode,
)
from leap_rig.recording.leader import read_leader
from leap_rig.recording.recording_files import RecordingFault, between
from leap_rig.recording.run import MessageDecoders, read
from leap_rig.recording.session import LABEL, read_label
from leap_rig.recording.signals import AGE, SignalTable, moving, read_signals

STATE, ACTION, SUCCESS, IMAGES = "observation.state", "action", "next.success", "observation.images."
POLICY_LED, INTERVENTION = "policy_led", "intervention"  # who gave the action of a row
KNOWN = {topics.COLOR: "color", topics.DEPTH: "depth"}
"""Names of the rig's own cameras; those of others follow from their topics."""
FLAG = {"dtype": "bool", "shape": (1,), "names": None}
ENDLESS = float("inf")


class ExportedEpisode(NamedTuple):
    """What a recording gives a dataset."""

    recording: Path
    task: str
    rows: TrainingEpisode
    signals: SignalTable
    leader: Mapping[str, np.ndarray]  # POLICY_LED and INTERVENTION, bool, shape (n,)
    cameras: Mapping[str, str]  # topics by key
    size: Sequence[int] | None  # width and height of the images [px]; None: as they were taken
    features: dict[str, Any]
    about: Mapping[str, Any]

    def vectors(self) -> dict[str, np.ndarray]:
        """Returns all numbers by key, shape (n, number of names)."""
        rows = {STATE: self.rows.state, ACTION: self.rows.action, **self.signals.rows}
        return {key: values.astype(np.float32) for key, values in rows.items()}

    def images(self) -> dict[str, Iterator[np.ndarray]]:
        """Returns the images of each camera by key, one a row."""
        return {key: images(self.recording, topic, self.rows.times, self.size) for key, topic in self.cameras.items()}


def exported_episodes(
    recordings: Sequence[Path],
    fps: int,
    task: str,
    start: float = 0.0,
    end: float = ENDLESS,
    trim: bool = False,
    size: Sequence[int] | None = None,
    robot: bool = False,
) -> list[ExportedEpisode]:
    """Returns an episode for each recording; `task` for those that name none; `start` and `end` cut each [s], `trim`
    cuts what does not move at its ends; `size` of the images; `robot`: see `as_robot`. Raises RecordingFault if a
    recording has no task, or the recordings do not fit together."""
    episodes: list[ExportedEpisode] = []
    for recording in recordings:
        one = _episode(recording, fps, task, start, end, trim, size, depth=not robot)
        episodes.append(as_robot(one) if robot else one)
        if episodes[-1].features != episodes[0].features:
            raise RecordingFault(f"{recording} has other signals than the first one, so they are not one dataset.")
        for key, rows in episodes[-1].vectors().items():
            if not np.isfinite(rows).all():
                raise RecordingFault(
                    f"{recording} has numbers in {key} that are not finite, of which nothing is learned; leave it out."
                )
    return episodes


def about(episodes: Sequence[ExportedEpisode]) -> dict[str, Any]:
    """Returns what a format has no place for: units, and where each episode comes from."""
    units = {STATE: "rad", ACTION: "rad", **episodes[0].signals.units}
    return {"units": units, "depth": DEPTH_CODE, "episodes": [one.about for one in episodes]}


def _episode(
    recording: Path, fps: int, task: str, start: float, end: float, trim: bool, size: Sequence[int] | None, depth: bool
) -> ExportedEpisode:
    run = read(recording, start, end)
    words = task or run.manifest.get("task", "")
    if not words:
        raise RecordingFault(f"{recording} does not say what is done; give --task, a sentence.")
    first = first_images(recording, depth)
    rows = training_episode(run, fps)
    begins = max((received for received, _ in first.values()), default=0.0)
    rows = _part(rows, slice(int(np.searchsorted(rows.times, begins)), None))
    if not len(rows.times):
        raise RecordingFault(f"{recording} has a camera without an image in this time.")
    if trim:
        rows = _part(rows, moving(rows.action, fps))
    signals = read_signals(recording, rows.times, run)
    cameras = {IMAGES + camera_name(topic): topic for topic in first}
    robot = run.manifest.get("robot", {}).get("model", {}).get("robot", "unknown")
    origin: dict[str, Any] = {"recording": recording.name, "started": run.manifest.get("started", ""), "robot": robot}
    vector = {"dtype": "float32", "shape": (len(rows.names),), "names": list(rows.names)}
    policy_led, intervention = read_leader(recording, rows.times + 1.0 / fps)
    leader = {POLICY_LED: policy_led, INTERVENTION: intervention}
    origin["interventions"] = int((np.diff(intervention.astype(int), prepend=0) > 0).sum())
    features: dict[str, Any] = {STATE: vector, ACTION: dict(vector)}
    for key in leader:
        features[key] = dict(FLAG)
    for key, names in signals.names.items():
        features[key] = {"dtype": "float32", "shape": (len(names),), "names": list(names)}
    for key, topic in cameras.items():
        shape = (*(first[topic][1][:2] if size is None else tuple(size)[::-1]), 3)
        kind = "image" if topic == topics.DEPTH else "video"  # a film would not keep the depth
        features[key] = {"dtype": kind, "shape": shape, "names": ["height", "width", "channels"]}
    if (recording / LABEL).exists():
        label = read_label(recording)
        origin.update(asdict(label), success=label.outcome == SUCCEEDED)
        features[SUCCESS] = dict(FLAG)
    return ExportedEpisode(recording, words, rows, signals, leader, cameras, size, features, origin)


def as_robot(one: ExportedEpisode) -> ExportedEpisode:
    """Returns only what the plug-in's robot has, so that a policy that learns from it can move the rig: the state,
    colour images, and as the action the desired tool of the next row, or where nobody led it the measured one. LeRobot
    itself records an action of the same instant. Raises RecordingFault if something is not known, was silent for too
    long, or a policy led, whose actions would be learned."""
    rows, signals = one.rows, one.signals.rows
    if rows.state.shape[1] != len(ARM) + len(FINGERS):
        raise RecordingFault(f"{one.recording} has no robot hand, which the plug-in's robot has.")
    if not any(topic != topics.DEPTH for topic in one.cameras.values()):
        raise RecordingFault(f"{one.recording} has no colour images, which the plug-in's robot has.")
    if one.leader[POLICY_LED].any():
        raise RecordingFault(f"A policy led {one.leader[POLICY_LED].sum()} rows of {one.recording}; leave it out.")
    age = dict(zip(one.signals.names[AGE], signals[AGE].T))
    tool, torques = age["observation.tool_pose"], age["kuka.joint_torques_external"]
    known = np.flatnonzero((tool >= 0.0) & (torques >= 0.0))
    if len(known) < 2:
        raise RecordingFault(f"{one.recording} has no tool pose with torques, which the plug-in's robot has.")
    part = slice(int(known[0]), len(tool) - 1)
    for name, ages, longest in (("tool pose", tool, SILENT_S), ("torques", torques, SLOW_S)):
        if ages[part].max() > longest:
            raise RecordingFault(f"In {one.recording} no {name} came for {ages[part].max():.1f} s; leave it out.")
    led = (age["action.desired_tool"] >= 0.0) & (age["action.desired_tool"] <= SILENT_S)
    wanted = np.where(led[:, None], signals["action.desired_tool"], signals["observation.tool_pose"])
    joints, fingers = np.split(rows.state, [len(ARM)], axis=1)
    state = np.hstack([joints, signals["observation.external_torque"], fingers, signals["observation.tool_pose"]])
    action = np.hstack([wanted[1:], rows.action[:-1, len(ARM) :]])
    names = {STATE: ROBOT_STATE, ACTION: ROBOT_ACTION}
    features: dict[str, Any] = {
        key: {"dtype": "float32", "shape": (len(of),), "names": list(of)} for key, of in names.items()
    }
    features.update({key: one.features[key] for key in one.cameras})
    units = {STATE: "rad, Nm, and m and a quaternion in kuka/base_frame", ACTION: "m and a quaternion there, rad"}
    return one._replace(
        rows=_part(rows, part),
        signals=SignalTable(names, units, {STATE: state[part], ACTION: action[part]}),
        leader={},
        features=features,
    )


def camera_name(topic: str) -> str:
    """Returns the name of a camera whose images come on a topic."""
    return KNOWN.get(topic) or topic.strip("/").replace("/", "_")


def first_images(recording: Path, depth: bool = True) -> dict[str, tuple[float, tuple[int, ...]]]:
    """Returns when the first image came on each topic that has some [s], and its shape; `depth`: also of depths.
    RecordingFault: a size changes, which no video has, or the encoding is one of none."""
    found: dict[str, tuple[float, tuple[int, ...]]] = {}
    decode = MessageDecoders()
    for message in between(recording, None, 0.0, ENDLESS):
        if message.kind.name != IMAGE or (message.topic == topics.DEPTH and not depth):
            continue
        fields = decode(message)
        size = fields["height"], fields["width"]
        if message.topic not in found:
            found[message.topic] = 1e-9 * message.received, _picture(message.topic)(fields).shape
        elif size != found[message.topic][1][:2]:
            height, width = found[message.topic][1][:2]
            raise RecordingFault(
                f"The images of {message.topic} in {recording} are {width} x {height} px, then {size[1]} x {size[0]}: "
                "a dataset has one size; record each in a run of its own."
            )
    return dict(sorted(found.items()))


def _picture(topic: str) -> Callable[[dict[str, Any]], np.ndarray]:
    return depth_image if topic == topics.DEPTH else color_image


def _part(rows: TrainingEpisode, part: slice) -> TrainingEpisode:
    return replace(rows, times=rows.times[part], state=rows.state[part], action=rows.action[part])


def images(recording: Path, topic: str, times: np.ndarray, size: Sequence[int] | None = None) -> Iterator[np.ndarray]:
    """Yields for each time the newest image of a topic; before the first one, that one. RecordingFault: another
    encoding."""
    decode, newest = MessageDecoders(), None
    how = cv2.INTER_NEAREST if topic == topics.DEPTH else cv2.INTER_AREA
    coming_ones = between(recording, [topic], 0.0, ENDLESS)
    coming = next(coming_ones, None)
    for time in times:
        late = None
        while coming is not None and ((newest is None and late is None) or coming.received * 1e-9 <= time):
            late, coming = coming, next(coming_ones, None)
        if late is not None:
            newest = _picture(topic)(decode(late))
            newest = newest if size is None else cv2.resize(newest, tuple(size), interpolation=how)
        if newest is None:
            return
        yield newest
