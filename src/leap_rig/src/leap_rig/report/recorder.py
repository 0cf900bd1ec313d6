"""Records a run of the rig from plain values; times in seconds, lengths in metres, angles in radians. `report.py`
summarises the record."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from common.hand_delay import Track
from common.reasons import ReasonCode
from common.rotations import rotation_angle

STAGES = ("received", "leap_motion", "leap_kuka", "kuka_control", "leap_hand")
"""Stages between a received frame and the wires of arm and hand, by the names of their nodes."""
UPRIGHT_RAD = float(np.radians(10.0))


@dataclass
class RecordedStream:
    """A period in which the hand steered the arm; `stopped` is None while it lasts."""

    started: float
    stopped: float | None = None
    reason: str = "still running when the run ended"
    codes: tuple[ReasonCode, ...] = ()  # of the reason


@dataclass
class TrackingErrors:
    """Distances and angles between target pose and measured pose of the tool."""

    distance: list[float] = field(default_factory=list)
    angle: list[float] = field(default_factory=list)

    def add(self, T_base_target: np.ndarray, T_base_tool: np.ndarray) -> None:
        """Adds a pair of poses, each of shape (4, 4)."""
        self.distance.append(float(np.linalg.norm(T_base_target[:3, 3] - T_base_tool[:3, 3])))
        self.angle.append(rotation_angle(T_base_target[:3, :3].T @ T_base_tool[:3, :3]))


@dataclass
class ObjectTrack:
    """One object during a run; times in seconds, lengths in metres, angles in radians."""

    lifted: float | None = None  # time at which it first left the table
    highest: float = 0.0  # greatest height of its lowest point above the table
    put_down: float | None = None  # time at which the hand released it on the table after the lift
    moved: float = 0.0  # horizontal distance from its first position
    tilt: float = 0.0  # angle between its vertical axis now and at first
    fell: bool = False  # whether it fell off the table
    at: tuple[float, float] | None = None  # where it is now, x, y in the frame of its poses
    # Of several arms, whose hands touch it off the table: each change with its time
    held_by: list[tuple[float, tuple[str, ...]]] = field(default_factory=list)
    _first: np.ndarray | None = None

    @property
    def picked_and_placed(self) -> bool:
        """Whether it left the table and stands on it again, upright."""
        return self.lifted is not None and self.put_down is not None and self.tilt < UPRIGHT_RAD and not self.fell

    def observe(
        self,
        T_world_object: np.ndarray,
        clearance: float,
        on_table: bool,
        held: bool,
        now: float,
        hands: tuple[str, ...] = (),
    ) -> None:
        """Adds a pose, shape (4, 4), with the height of the lowest point above the table [m], and whether table and
        robot touch the object; `hands`: the arms, of several, whose hands do."""
        # An object whose lowest point is higher than this has left the table.
        off_table_m = 0.01
        on_table_m = 0.003
        # Lower than the table's top: it fell beside it.
        fell_m = -0.02
        self.at = float(T_world_object[0, 3]), float(T_world_object[1, 3])
        if clearance > off_table_m and hands and (not self.held_by or self.held_by[-1][1] != hands):
            self.held_by.append((now, hands))
        if self._first is None:
            self._first = T_world_object
        self.highest = max(self.highest, clearance)
        self.fell |= clearance < fell_m
        self.moved = float(np.linalg.norm((T_world_object - self._first)[:2, 3]))
        up, up_first = T_world_object[:3, 2], self._first[:3, 2]
        self.tilt = float(np.arccos(np.clip(up @ up_first, -1.0, 1.0)))
        if clearance > off_table_m:
            self.lifted = now if self.lifted is None else self.lifted
            self.put_down = None
        elif self.lifted is not None and self.put_down is None and on_table and not held and clearance < on_table_m:
            self.put_down = now


class Recorder:
    """The record of one run, which begins with `start`; `teleoperated`: a hand is to move the arm, else a node."""

    def __init__(self, teleoperated: bool = True) -> None:
        self.teleoperated = teleoperated
        self.started: float | None = None
        self.frames = 0
        self.streams: list[RecordedStream] = []
        self.desired = TrackingErrors()
        self.commanded = TrackingErrors()
        self.palms, self.tools = Track(), Track()  # in the Leap frame and in the base, by the stamps
        self.tool_path = 0.0
        self.largest_tcp_speed: float | None = None
        self._hand_range: tuple[np.ndarray, np.ndarray] | None = None
        self.stamps: dict[float, float] = {}
        self.stage_times: dict[str, dict[float, float]] = {stage: {} for stage in STAGES}
        self.counters: dict[str, dict[str, str]] = {}
        self.objects: dict[str, ObjectTrack] = {}
        self.scenario: dict[str, str] | None = None
        self.grasps: dict[str, dict[str, str]] = {}
        self.loads: list[tuple[float, float]] = []  # time [s], and fraction of all processors in use before it
        self._base_counters: dict[str, dict[str, str]] = {}
        self._last_tool: np.ndarray | None = None

    def start(self, now: float) -> None:
        """Begins the run: clears the record, except for a stream that runs already."""
        running = self.streaming
        counters, scenario = self.counters, self.scenario
        Recorder.__init__(self, self.teleoperated)
        self.started = now
        self.counters, self.scenario = counters, scenario
        self._base_counters = {name: dict(values) for name, values in counters.items()}
        if running:
            self.streams.append(RecordedStream(now))

    @property
    def streaming(self) -> bool:
        return bool(self.streams) and self.streams[-1].stopped is None

    @property
    def scenario_over(self) -> bool:
        """Whether the simulated operator has finished the scenario or given it up."""
        return self.scenario is not None and (self.scenario["step"] == "done" or bool(self.scenario["failure"]))

    def stage(self, stage: str, frame_stamp: float, done: float) -> None:
        """Adds the time at which a stage published its result for the frame of `frame_stamp`."""
        if stage == "leap_motion":
            self.frames += 1
        if stage in self.stage_times:
            frame = round(frame_stamp, 4)  # tf rounds stamps by a nanosecond, frames are milliseconds apart
            self.stamps.setdefault(frame, frame_stamp)
            self.stage_times[stage].setdefault(frame, done)

    def stream(self, running: bool, reason: str, now: float, codes: tuple[ReasonCode, ...] = ()) -> None:
        if running and not self.streaming:
            self.streams.append(RecordedStream(now))
        elif not running and self.streaming:
            self.streams[-1].stopped = now
            self.streams[-1].reason = reason
            self.streams[-1].codes = codes

    def status(self, name: str, values: dict[str, str]) -> None:
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
        bodies = set(touches)
        held = any({"reflex", "kuka"} & set(body.split("/")[:-1]) for body in bodies)  # behind an arm's prefix, too
        parts = [body.split("/") for body in bodies]
        hands = tuple(sorted({of for of, *rest in parts if rest and rest[0] == "reflex"}))
        track = self.objects.setdefault(name, ObjectTrack())
        track.observe(T_world_object, clearance, "table" in bodies, held, now, hands)

    def hand(self, angles: np.ndarray) -> None:
        """Adds the four motor angles of the hand, shape (4,) [rad]."""
        low, high = self._hand_range or (angles, angles)
        self._hand_range = np.minimum(low, angles), np.maximum(high, angles)

    @property
    def hand_travel(self) -> list[float]:
        """The range of each of these angles [rad]; empty if the hand reported none."""
        return [] if self._hand_range is None else np.round(np.subtract(*self._hand_range[::-1]), 3).tolist()
