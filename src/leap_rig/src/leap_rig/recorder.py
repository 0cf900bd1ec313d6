"""Records a run of the rig from plain values; times in seconds, lengths in metres, angles in radians.

`report.py` summarises the record.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from common.rotations import rotation_angle
from leap_rig.object_track import ObjectTrack

STAGES = ("leap_motion", "leap_kuka", "kuka_control", "leap_hand")
"""Stages between a received frame and the wires of arm and hand, by the names of their nodes."""


@dataclass
class RecordedStream:
    """A period in which the hand steered the arm; `stopped` is None while it lasts."""

    started: float
    stopped: float | None = None
    reason: str = "still running when the run ended"


@dataclass
class TrackingErrors:
    """Distances and angles between target pose and measured pose of the tool."""

    distance: list[float] = field(default_factory=list)
    angle: list[float] = field(default_factory=list)

    def add(self, T_base_target: np.ndarray, T_base_tool: np.ndarray) -> None:
        """Adds a pair of poses, each of shape (4, 4)."""
        self.distance.append(float(np.linalg.norm(T_base_target[:3, 3] - T_base_tool[:3, 3])))
        self.angle.append(rotation_angle(T_base_target[:3, :3].T @ T_base_tool[:3, :3]))


class Recorder:
    """The record of one run, which begins with `start`."""

    def __init__(self) -> None:
        self.started: float | None = None
        self.frames = 0
        self.streams: list[RecordedStream] = []
        self.desired = TrackingErrors()
        self.commanded = TrackingErrors()
        self.tool_path = 0.0
        self.largest_tcp_speed: float | None = None
        self.hand_low: np.ndarray | None = None
        self.hand_high: np.ndarray | None = None
        self.received: dict[float, float] = {}
        self.stage_times: dict[str, dict[float, float]] = {stage: {} for stage in STAGES}
        self.counters: dict[str, dict[str, str]] = {}
        self.objects: dict[str, ObjectTrack] = {}
        self.scenario: dict[str, str] | None = None
        self.grasps: dict[str, dict[str, str]] = {}
        self._base_counters: dict[str, dict[str, str]] = {}
        self._last_tool: np.ndarray | None = None

    def start(self, now: float) -> None:
        """Begins the run: clears the record, except for a stream that runs already."""
        running = self.streaming
        counters, scenario = self.counters, self.scenario
        Recorder.__init__(self)
        self.started = now
        self.counters, self.scenario = counters, scenario
        self._base_counters = {name: dict(values) for name, values in counters.items()}
        if running:
            self.streams.append(RecordedStream(now))

    @property
    def streaming(self) -> bool:
        """Whether a hand steers the arm now."""
        return bool(self.streams) and self.streams[-1].stopped is None

    @property
    def scenario_over(self) -> bool:
        """Whether the simulated operator has finished the scenario or given it up."""
        return self.scenario is not None and (self.scenario["step"] == "done" or bool(self.scenario["failure"]))

    def stage(self, stage: str, frame_stamp: float, done: float) -> None:
        """Adds the time at which a stage published its result for the frame received at `frame_stamp`."""
        if stage == "leap_motion":
            self.frames += 1
        if stage in self.stage_times:
            frame = round(frame_stamp, 4)  # tf rounds stamps by a nanosecond, frames are milliseconds apart
            self.received.setdefault(frame, frame_stamp)
            self.stage_times[stage].setdefault(frame, done)

    def stream(self, running: bool, reason: str, now: float) -> None:
        """Sets whether the stream of hand poses runs."""
        if running and not self.streaming:
            self.streams.append(RecordedStream(now))
        elif not running and self.streaming:
            self.streams[-1].stopped = now
            self.streams[-1].reason = reason

    def status(self, name: str, values: dict[str, str]) -> None:
        """Sets the counters of a node or device."""
        self.counters[name] = dict(values)
        if "peak_tcp_speed" in values:
            self.largest_tcp_speed = max(self.largest_tcp_speed or 0.0, float(values["peak_tcp_speed"]))

    def count(self, name: str, key: str) -> float | None:
        """Returns the increase of a counter since the start of the run, or None without this counter."""
        if key not in self.counters.get(name, {}):
            return None
        return float(self.counters[name][key]) - float(self._base_counters.get(name, {}).get(key, 0.0))

    def set_scenario(self, scenario: dict[str, str]) -> None:
        """Sets the state of the scenario, which includes the current grasp if there is one."""
        self.scenario = scenario
        if "round" in scenario:
            self.grasps[scenario["round"]] = scenario

    def tool(self, T_base_tool: np.ndarray, desired: np.ndarray | None, commanded: np.ndarray | None) -> None:
        """Adds the tool pose and, while the arm follows a hand, its desired and commanded pose; each shape (4, 4)."""
        if self._last_tool is not None and commanded is not None:
            self.tool_path += float(np.linalg.norm(T_base_tool[:3, 3] - self._last_tool))
        self._last_tool = T_base_tool[:3, 3].copy()
        if desired is not None:
            self.desired.add(desired, T_base_tool)
        if commanded is not None:
            self.commanded.add(commanded, T_base_tool)

    def add_object(
        self, name: str, T_world_object: np.ndarray, clearance: float, touches: Iterable[str], now: float
    ) -> None:
        """Adds pose, clearance above the table [m] and contacts of an object of the simulated world."""
        touched = set(touches)
        held = any(body.startswith(("reflex/", "kuka/")) for body in touched)
        self.objects.setdefault(name, ObjectTrack()).observe(T_world_object, clearance, "table" in touched, held, now)

    def hand(self, angles: np.ndarray) -> None:
        """Adds the four motor angles of the hand, shape (4,) [rad]."""
        self.hand_low = angles if self.hand_low is None else np.minimum(self.hand_low, angles)
        self.hand_high = angles if self.hand_high is None else np.maximum(self.hand_high, angles)
