"""Collects what happens during a run of the rig; times in seconds, lengths in metres, angles in radians.

Knows nothing of ROS: the edge hands it plain values. `report.py` makes the summary of what stands here.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from common.rotations import rotation_angle
from leap_rig.object_track import ObjectTrack

STAGES = ("leap_motion", "leap_kuka", "kuka_control", "leap_hand")
"""Stages of the way from a received frame to the wires of arm and hand, as the nodes name them."""


@dataclass
class Stream:
    """One stretch of time in which the hand steered the arm; `stopped` is None while it lasts."""

    started: float
    stopped: float | None = None
    reason: str = "still running when the run ended"


@dataclass
class TrackingErrors:
    """Distance and angle between where the tool should be and where it is, sample by sample."""

    distance: list[float] = field(default_factory=list)
    angle: list[float] = field(default_factory=list)

    def add(self, T_base_target: np.ndarray, T_base_tool: np.ndarray) -> None:
        """Takes a pair of poses, each of shape (4, 4)."""
        self.distance.append(float(np.linalg.norm(T_base_target[:3, 3] - T_base_tool[:3, 3])))
        self.angle.append(rotation_angle(T_base_target[:3, :3].T @ T_base_tool[:3, :3]))


class Recorder:
    """What was seen during one run. `start(now)` begins it; what came before does not count."""

    def __init__(self) -> None:
        self.started: float | None = None
        self.frames = 0
        self.streams: list[Stream] = []
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
        """Begins the run: forgets what was seen so far, keeps a stream that runs already."""
        running = self.streaming
        counters, scenario = self.counters, self.scenario
        Recorder.__init__(self)
        self.started = now
        self.counters, self.scenario = counters, scenario
        self._base_counters = {name: dict(values) for name, values in counters.items()}
        if running:
            self.streams.append(Stream(now))

    @property
    def streaming(self) -> bool:
        """Whether a hand steers the arm now."""
        return bool(self.streams) and self.streams[-1].stopped is None

    @property
    def scenario_over(self) -> bool:
        """Whether the simulated person's scenario is done or was given up."""
        return self.scenario is not None and (self.scenario["step"] == "done" or bool(self.scenario["failure"]))

    def stage(self, stage: str, frame_stamp: float, done: float) -> None:
        """A stage has handed on, at `done`, what it made of the frame received at `frame_stamp`."""
        if stage == "leap_motion":
            self.frames += 1
        if stage in self.stage_times:
            frame = round(frame_stamp, 4)  # tf rounds stamps by a nanosecond, frames are milliseconds apart
            self.received.setdefault(frame, frame_stamp)
            self.stage_times[stage].setdefault(frame, done)

    def stream(self, running: bool, reason: str, now: float) -> None:
        """The stream of hand poses started or stopped."""
        if running and not self.streaming:
            self.streams.append(Stream(now))
        elif not running and self.streaming:
            self.streams[-1].stopped = now
            self.streams[-1].reason = reason

    def status(self, name: str, values: dict[str, str]) -> None:
        """Counters of a node or device, as they stand now."""
        self.counters[name] = dict(values)
        if "peak_tcp_speed" in values:
            self.largest_tcp_speed = max(self.largest_tcp_speed or 0.0, float(values["peak_tcp_speed"]))

    def count(self, name: str, key: str) -> float | None:
        """Returns how much a counter grew since the run began; None if nobody counted."""
        if key not in self.counters.get(name, {}):
            return None
        return float(self.counters[name][key]) - float(self._base_counters.get(name, {}).get(key, 0.0))

    def tell(self, scenario: dict[str, str]) -> None:
        """Takes what the simulated person tells of the scenario, and of the present grasp if there is one."""
        self.scenario = scenario
        if "round" in scenario:
            self.grasps[scenario["round"]] = scenario

    def tool(self, T_base_tool: np.ndarray, desired: np.ndarray | None, commanded: np.ndarray | None) -> None:
        """Takes where the tool is and, while the arm follows a hand, where hand and controller want it.

        All poses have shape (4, 4).
        """
        if self._last_tool is not None and commanded is not None:
            self.tool_path += float(np.linalg.norm(T_base_tool[:3, 3] - self._last_tool))
        self._last_tool = T_base_tool[:3, 3].copy()
        if desired is not None:
            self.desired.add(desired, T_base_tool)
        if commanded is not None:
            self.commanded.add(commanded, T_base_tool)

    def seen_object(
        self, name: str, T_world_object: np.ndarray, clearance: float, touches: Iterable[str], now: float
    ) -> None:
        """Takes where an object of the simulated world is, how high above the table [m], and what it touches."""
        touched = set(touches)
        held = any(body.startswith(("reflex/", "kuka/")) for body in touched)
        self.objects.setdefault(name, ObjectTrack()).see(T_world_object, clearance, "table" in touched, held, now)

    def hand(self, angles: np.ndarray) -> None:
        """Takes the four motor angles of the hand, shape (4,) [rad]."""
        self.hand_low = angles if self.hand_low is None else np.minimum(self.hand_low, angles)
        self.hand_high = angles if self.hand_high is None else np.maximum(self.hand_high, angles)
