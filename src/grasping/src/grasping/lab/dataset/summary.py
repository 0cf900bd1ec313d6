"""Summarises a dataset in tables and warns of episodes that do not belong together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from common.poses import inverse
from grasping.lab.dataset.episode import Episode
from grasping.lab.dataset.labels import own_grasp, relative_label

SHORT = 12
"""Digits of a fingerprint in a table."""


class OffsetStatistics(NamedTuple):
    """The operator's grasp as GGCNN's sees it."""

    position: np.ndarray  # in the frame of GGCNN's grasp, shape (3,) [m]: x through its fingers, z its approach
    angle: float  # less GGCNN's [rad]
    tilt: float  # between both approaches [rad]


class Entry(NamedTuple):
    """What the tables need of an episode."""

    name: str  # of its file
    size: int  # of its file [bytes]
    object: str
    operator: str
    source: str
    date: str
    held: bool
    frames: int
    span: float
    fingerprint: str
    configuration: Mapping[str, Any]
    offsets: list[OffsetStatistics]  # of the frames where they have a label


def entry(name: str, size: int, episode: Episode) -> Entry:
    """Returns what the tables need of an episode, `size` [bytes] large."""
    meta = episode.metadata
    return Entry(
        name,
        size,
        meta.object,
        meta.operator,
        meta.source,
        meta.date,
        episode.held,
        len(episode),
        episode.t_grasp - float(episode.stamp[0]),
        meta.fingerprint,
        meta.configuration,
        offsets(episode),
    )


def offsets(episode: Episode) -> list[OffsetStatistics]:
    """Returns the operator's grasp relative to GGCNN's for each frame in which both have a pose."""
    found = []
    for frame in episode.frames():
        label, own = relative_label(frame), own_grasp(frame)
        if label is not None and own is not None:
            position = (inverse(own.T_camera_grasp) @ frame.T_camera_grasp)[:3, 3]
            found.append(OffsetStatistics(position, label.angle, float(np.linalg.norm(label.tilt))))
    return found


def episodes_table(entries: list[Entry]) -> str:
    """Returns one line an episode."""
    rows = [
        (e.name, e.object, e.operator, e.source, e.frames, f"{e.span:.1f}", "yes" if e.held else "no",
         f"{1e-6 * e.size:.1f}", e.fingerprint[:SHORT])
        for e in entries
    ]  # fmt: skip
    return _table(("episode", "object", "operator", "source", "frames", "s", "held", "MB", "fingerprint"), rows)


def objects_table(entries: list[Entry]) -> str:
    """Returns one line an object, and one for all."""
    rows = []
    names = sorted({e.object for e in entries})
    for name in (*names, None):
        chosen = [e for e in entries if name in (None, e.object)]
        dates = sorted(e.date for e in chosen)
        rows.append(
            (
                "all" if name is None else name,
                len(chosen),
                sum(e.frames for e in chosen),
                f"{100.0 * np.mean([e.held for e in chosen]):.0f}",
                *_beside([o for e in chosen for o in e.offsets]),
                dates[0],
                dates[-1],
                f"{1e-6 * sum(e.size for e in chosen):.1f}",
            )
        )
    header = ("object", "episodes", "frames", "held %", "mm", "deg", "tilt deg", "first", "last", "MB")
    return _table(header, rows)


def fingerprints_table(entries: list[Entry]) -> str:
    """Returns one line a configuration of the rig, and what each has other than the first."""
    first = entries[0].configuration
    rows = []
    for fingerprint in dict.fromkeys(e.fingerprint for e in entries):
        chosen = [e for e in entries if e.fingerprint == fingerprint]
        differs = ", ".join(differences(first, chosen[0].configuration)) or "-"
        rows.append((fingerprint[:SHORT], len(chosen), differs))
    return _table(("fingerprint", "episodes", "other than the first"), rows)


def differences(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[str]:
    """Returns the names of the entries, also of those of entries, in which two configurations differ."""
    found = []
    for key in sorted({*a, *b}):
        one, other = a.get(key), b.get(key)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            found += [f"{key}/{inner}" for inner in differences(one, other)]
        elif one != other:
            found.append(key)
    return found


def complaints(entries: list[Entry]) -> list[str]:
    """Returns the warnings against training with all of these episodes, one sentence each."""
    found = [f"{e.name} has no frame in which both grasps have a pose." for e in entries if not e.offsets]
    count = len({e.fingerprint for e in entries})
    if count > 1:
        found.append(f"The episodes are of {count} configurations of the rig.")
    return found


def _beside(found: list[OffsetStatistics]) -> tuple[str, str, str]:
    """Returns median distance [mm], angle and tilt [deg] between the operator's grasp and GGCNN's."""
    if not found:
        return "-", "-", "-"
    distance = np.median([np.linalg.norm(o.position) for o in found])
    angle, tilt = (np.degrees(np.median(np.abs(values))) for values in zip(*((o.angle, o.tilt) for o in found)))
    return f"{1e3 * distance:.0f}", f"{angle:.0f}", f"{tilt:.0f}"


def _table(header: tuple, rows: list[tuple]) -> str:
    lines = [[str(cell) for cell in row] for row in (header, *rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    return "".join("  ".join(cell.ljust(w) for cell, w in zip(line, widths)).rstrip() + "\n" for line in lines)
