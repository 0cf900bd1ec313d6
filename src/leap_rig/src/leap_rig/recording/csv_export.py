"""A recording as CSV files, one for each series of the reader; the table of the series is a generated page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from common.frames import BASE
from common.rotations import quaternion_from_rotation
from leap_rig.recording.run import POSES, RecordedRun
from leap_rig.recording.topics import HAND_COMMAND, HAND_STATE, JOINTS, SENT_GOALS

POSE_COLUMNS = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
JOINT_COLUMNS = tuple(f"joint_{i}_rad" for i in range(1, 8))
MOTOR_COLUMNS = ("index_rad", "middle_rad", "thumb_rad", "spread_rad")
AS_SENT = "motor angles of index, middle, thumb and spread; 0 is open"


@dataclass(frozen=True)
class RecordedSeries:
    """A series of a recording: arrays of RecordedRun with the same times."""

    field: str  # of RecordedRun, with its values
    times: str  # that with their times
    columns: tuple[str, ...]  # of the CSV file, after the time
    source: str  # topic or tf frame
    says: str  # what it holds, and in which frame or unit
    timed: str  # what its times are
    more: tuple[str, ...] = ()  # further fields, whose values stand in the last columns


SERIES = (
    RecordedSeries(
        *("tool", "tool_times", POSE_COLUMNS, POSES["tool"]),
        f"the tool where the arm is: at the measured joints, in `{BASE}`",
        "published",
    ),
    RecordedSeries(
        *("desired", "desired_times", POSE_COLUMNS, POSES["desired"]),
        f"the desired tool, neither scaled nor clipped to the workspace, in `{BASE}`",
        "stamp",
    ),
    RecordedSeries("joints", "joint_times", JOINT_COLUMNS, JOINTS[1:], "measured joints of the arm", "published"),
    RecordedSeries(
        *("goals", "goal_times", (*JOINT_COLUMNS, "velocity"), SENT_GOALS[1:]),
        "joints sent to the robot; `goal_velocities`: of a PTP motion the fraction of the full joint speed, 0: a servo "
        "goal",
        "sent",
        ("goal_velocities",),
    ),
    RecordedSeries("hand", "hand_times", MOTOR_COLUMNS, HAND_STATE[1:], f"measured {AS_SENT}", "received"),
    RecordedSeries(
        "hand_commands", "hand_command_times", MOTOR_COLUMNS, HAND_COMMAND[1:], f"commanded {AS_SENT}", "received"
    ),
)
"""What is exported; the order is that of the table."""


def lines(run: RecordedRun, series: RecordedSeries) -> Iterator[str]:
    """Yields the lines of a series' file: the names of the columns, then a row for each time [s] since the epoch."""
    yield ",".join(("time_s", *series.columns))
    values = getattr(run, series.field)
    if series.columns is POSE_COLUMNS:
        values = np.array([[*T[:3, 3], *quaternion_from_rotation(T[:3, :3])] for T in values]).reshape(-1, 7)
    values = np.column_stack([values, *(getattr(run, name) for name in series.more)])
    for time, row in zip(getattr(run, series.times).tolist(), values.tolist()):
        yield ",".join((f"{time:.6f}", *map(repr, row)))


def table() -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    head = ("field", "shape", "unit", "holds", "times", "from", "columns of the CSV file")
    rows: list[tuple[str, ...]] = []
    for series in SERIES:
        pose = series.columns is POSE_COLUMNS
        shape = "(n, 4, 4)" if pose else f"(n, {len(series.columns) - len(series.more)})"
        fields = ", ".join(f"`{name}`" for name in (series.field, *series.more))
        first, last = series.columns[0], series.columns[-1 - len(series.more)]
        columns = ", ".join(("time_s", *((first, "...", last) if len(series.columns) > 4 else series.columns)))
        columns += "".join(f", {name}" for name in series.columns[len(series.columns) - len(series.more) :])
        times = f"`{series.times}`: {series.timed}"
        rows.append((fields, shape, "m" if pose else "rad", series.says, times, f"`{series.source}`", f"`{columns}`"))
    return head, rows
