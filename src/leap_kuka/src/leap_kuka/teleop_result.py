"""What the teleoperation of an arm returns for each frame, and what it counts."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from common import teleop_record
from common.reasons import ReasonCode
from leap_kuka.tool_hold import HoldState
from leap_kuka.virtual_leap import Attitude


class StreamState(Enum):
    """Whether a hand steers the arm."""

    WAITING = teleop_record.WAITING
    RUNNING = teleop_record.RUNNING


@dataclass(frozen=True)
class TeleopResult:
    """The result of a frame; poses have shape (4, 4)."""

    state: StreamState  # RUNNING while the hand steers
    reason: str  # one sentence: which hand is followed, or what the stream waits for
    usable: bool  # whether the frame was new and current; only then its poses are to be published
    T_base_virtual: np.ndarray  # pose of the virtual Leap in the base frame
    T_virtual_hand: np.ndarray | None = None  # pose of the hand as measured in this frame, if it has a valid sample
    T_virtual_filtered: np.ndarray | None = None  # pose of the averaged or filtered hand, if there is one
    T_virtual_tool: np.ndarray | None = None  # pose of the desired tool while the stream runs or the tool is held
    measured: Attitude | None = None  # of the hand relative to the heading of its stream, while that runs
    clipped: Attitude | None = None  # the same with each angle within its limit
    hold: HoldState = HoldState.NONE  # HELD while the tool is held, TAKEN while the hand that took it over steers
    owner: tuple[int, bool] | None = None  # id of the hand that steers, and whether it is a left one
    obstacle: str | None = None  # why the tool does not follow the hand although the stream runs
    keep_grip: bool = False  # whether the robot hand keeps its grip when it does not see the hand that steers
    hold_left: float = 0.0  # time until the hold ends [s]
    unmet: frozenset[str] = frozenset()  # of start_gate.CONDITIONS; none while the stream runs
    enabled: bool = True
    clutched: bool = False
    source: str = ""  # what enables or clutches
    codes: tuple[ReasonCode, ...] = ()  # of the reason
    limits: tuple[str, ...] = ()  # angles of the hand that are at their limit; "position": see feasible_side

    @property
    def follows(self) -> bool:
        """Whether the tool follows the hand."""
        return self.state is StreamState.RUNNING and self.obstacle is None


@dataclass
class TeleopCounts:
    """Events since the start."""

    frames: int = 0
    frames_refused: int = 0
    samples_left_out: int = 0
    streams: int = 0
    id_changes: int = 0  # of the hand that steers
    frames_without_owner: int = 0
    slow_frames: int = 0  # in which the tool stayed because the tracker was slow
    holds: int = 0
    kept: int = 0  # times that the tool stayed for the next relative engagement
    clutched: int = 0  # of them, times by the clutch
