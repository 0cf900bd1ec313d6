"""Tells what is in a dataset of grasps by an operator; files that are damaged or foreign are named and left out.

For each object: episodes, frames, fraction that was held, how far the operator's grasp is from GGCNN's (median of
distance, angle in the image, and tilt of the approach), first and last grasp, size. For each configuration of the rig,
by its fingerprint: episodes, and in what it differs from the first.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from common.poses import inverse
from grasping.lab.dataset import store
from grasping.lab.dataset.episode import Episode, Metadata
from grasping.lab.dataset.labels import own_grasp, relative_label

SHORT = 12  # digits of a fingerprint in a table


class OffsetStatistics(NamedTuple):
    """The operator's grasp as GGCNN's sees it."""

    position: np.ndarray  # in the frame of GGCNN's grasp, shape (3,) [m]: x through its fingers, z its approach
    angle: float  # less GGCNN's [rad]
    tilt: float  # between both approaches [rad]


class Entry(NamedTuple):
    """What the tables need of an episode."""

    name: str  # of its file
    size: int  # of its file [bytes]
    metadata: Metadata
    held: bool
    frames: int
    span: float  # from the first frame to the grasp [s]
    offsets: list[OffsetStatistics]  # of the frames where they have a label


def entry(name: str, size: int, episode: Episode) -> Entry:
    """Returns what the tables need of an episode, `size` [bytes] large."""
    span = episode.t_grasp - float(episode.stamp[0])
    return Entry(name, size, episode.metadata, episode.held, len(episode), span, offsets(episode))


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
    rows = [
        (e.name, e.metadata.object, e.metadata.operator, e.metadata.source, e.frames, f"{e.span:.1f}",
         "yes" if e.held else "no", f"{1e-6 * e.size:.1f}", e.metadata.fingerprint[:SHORT])
        for e in entries
    ]  # fmt: skip
    return _table(("episode", "object", "operator", "source", "frames", "s", "held", "MB", "fingerprint"), rows)


def objects_table(entries: list[Entry]) -> str:
    """Returns one line an object, and one for all."""
    rows = []
    for name in (*sorted({e.metadata.object for e in entries}), None):
        chosen = [e for e in entries if name in (None, e.metadata.object)]
        dates = sorted(e.metadata.date for e in chosen)
        held = f"{100.0 * np.mean([e.held for e in chosen]):.0f}"
        beside = _beside([o for e in chosen for o in e.offsets])
        size = f"{1e-6 * sum(e.size for e in chosen):.1f}"
        counts = len(chosen), sum(e.frames for e in chosen)
        rows.append(("all" if name is None else name, *counts, held, *beside, dates[0], dates[-1], size))
    header = ("object", "episodes", "frames", "held %", "mm", "deg", "tilt deg", "first", "last", "MB")
    return _table(header, rows)


def fingerprints_table(entries: list[Entry]) -> str:
    """Returns one line a configuration of the rig, and what each has other than the first."""
    first = entries[0].metadata.configuration
    counts = Counter(e.metadata.fingerprint for e in entries)
    configurations = {e.metadata.fingerprint: e.metadata.configuration for e in entries}
    rows = [
        (fingerprint[:SHORT], count, ", ".join(differences(first, configurations[fingerprint])) or "-")
        for fingerprint, count in counts.items()
    ]
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
    count = len({e.metadata.fingerprint for e in entries})
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


def read(folder: Path) -> Iterator[Entry | str]:
    """Yields the entry of each episode in and below a folder, or a sentence for a file that is not one."""
    for path in sorted(folder.rglob("*")):
        if store.unfinished(path.name):
            yield f"{path}: the process that wrote it died; the episode is lost."
        elif path.suffix == store.SUFFIX and not path.name.startswith("."):
            try:
                data = path.read_bytes()
                yield entry(path.stem, len(data), store.decode(data))
            except store.DatasetError as error:
                yield f"{path}: {error}"
            except OSError as error:
                yield f"{path}: {error.strerror}."


def plot(entries: list[Entry], path: Path) -> None:
    """Draws where the operator grasped, seen from GGCNN's grasps."""
    import matplotlib.figure

    figure = matplotlib.figure.Figure(figsize=(12, 4.2), layout="constrained")
    place, depth, turn = figure.subplots(1, 3)

    def across(found: list[OffsetStatistics]) -> np.ndarray:
        return 1e3 * np.array([o.position[:2] for o in found]).T

    def turned(found: list[OffsetStatistics]) -> np.ndarray:
        return np.degrees([(o.angle, o.tilt) for o in found]).T

    for held, colour, name in ((True, "tab:green", "held"), (False, "tab:red", "not held")):
        chosen = [e.offsets for e in entries if e.held == held and e.offsets]
        if not chosen:
            continue
        every = [o for found in chosen for o in found]
        last = [found[-1] for found in chosen]
        for axes, value in ((place, across), (turn, turned)):
            axes.scatter(*value(every), s=6, color=colour, alpha=0.3, linewidths=0)
            axes.scatter(*value(last), s=40, color=colour, edgecolors="black", linewidths=0.6, label=name)
        depth.hist([1e3 * o.position[2] for o in every], bins=30, color=colour, alpha=0.6, label=name)
    place.axhline(0.0, color="grey", linewidth=0.6)
    place.axvline(0.0, color="grey", linewidth=0.6)
    place.set(xlabel="through GGCNN's fingers [mm]", ylabel="across them [mm]", aspect="equal")
    place.set_title("operator's grasp from GGCNN's\n(dots: frames, circles: last frame of an episode)", fontsize=9)
    depth.set(xlabel="farther along GGCNN's approach [mm]", ylabel="frames")
    turn.set(xlabel="angle less GGCNN's [deg]", ylabel="tilt of the approach [deg]")
    for axes in (place, depth, turn):
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of the episodes, also in folders below it")
    parser.add_argument("--episodes", action="store_true", help="list every episode")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the operator's grasps from GGCNN's: .png, .pdf")
    check = "end with 1 if something should not be trained with as it is"
    parser.add_argument("--check", action="store_true", help=check)
    arguments = parser.parse_args()
    if not arguments.folder.is_dir():
        parser.error(f"{arguments.folder} is not a folder")
    found = list(read(arguments.folder))
    entries = [item for item in found if isinstance(item, Entry)]
    faults = [item for item in found if isinstance(item, str)]
    if entries:
        tables = [episodes_table] if arguments.episodes else []
        tables += [objects_table, fingerprints_table]
        sys.stdout.write("\n".join(table(entries) for table in tables))
    else:
        faults.append(f"{arguments.folder} holds no episode.")
    if arguments.check:
        faults += complaints(entries)
    sys.stdout.flush()
    sys.stderr.writelines(f"{fault}\n" for fault in faults)
    if arguments.plot is not None and entries:
        try:
            plot(entries, arguments.plot)
        except (OSError, ValueError) as error:
            parser.error(f"the image {arguments.plot} cannot be written: {error}")
    sys.exit(1 if faults and (arguments.check or not entries) else 0)
