"""Tells what is in a dataset of grasps by an operator; files that are damaged or foreign are named and left out.

For each object: episodes, frames, fraction that was held, how far the operator's grasp is from GGCNN's (median of
distance, angle in the image, and tilt of the approach), first and last grasp, size. For each configuration of the rig,
by its fingerprint: episodes, and in what it differs from the first.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from grasping.lab.dataset import store, summary


def read(folder: Path) -> Iterator[summary.Entry | str]:
    """Yields the entry of each episode in and below a folder, or a sentence for a file that is not one."""
    for path in sorted(folder.rglob("*")):
        if store.unfinished(path.name):
            yield f"{path}: the process that wrote it died; the episode is lost."
        elif path.suffix == store.SUFFIX and not path.name.startswith("."):
            try:
                data = path.read_bytes()
                yield summary.entry(path.stem, len(data), store.decode(data))
            except store.DatasetError as error:
                yield f"{path}: {error}"
            except OSError as error:
                yield f"{path}: {error.strerror}."


def plot(entries: list[summary.Entry], path: Path) -> None:
    """Draws where the operator grasped, seen from GGCNN's grasps."""
    import matplotlib.figure

    figure = matplotlib.figure.Figure(figsize=(12, 4.2), layout="constrained")
    place, depth, turn = figure.subplots(1, 3)
    for held, colour, name in ((True, "tab:green", "held"), (False, "tab:red", "not held")):
        chosen = [e.offsets for e in entries if e.held == held and e.offsets]
        if not chosen:
            continue
        every = [o for found in chosen for o in found]
        last = [found[-1] for found in chosen]
        for axes, value in ((place, _across), (turn, _turned)):
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


def _across(found: list[summary.OffsetStatistics]) -> np.ndarray:
    return 1e3 * np.array([o.position[:2] for o in found]).T


def _turned(found: list[summary.OffsetStatistics]) -> np.ndarray:
    return np.degrees([(o.angle, o.tilt) for o in found]).T


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of the episodes, also in folders below it")
    parser.add_argument("--episodes", action="store_true", help="list every episode")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the operator's grasps from GGCNN's: .png, .pdf")
    parser.add_argument(
        "--check", action="store_true", help="end with 1 if something should not be trained with as it is"
    )
    arguments = parser.parse_args()
    if not arguments.folder.is_dir():
        parser.error(f"{arguments.folder} is no folder")
    found = list(read(arguments.folder))
    entries = [item for item in found if isinstance(item, summary.Entry)]
    faults = [item for item in found if isinstance(item, str)]
    if entries:
        tables = [summary.episodes_table] if arguments.episodes else []
        tables += [summary.objects_table, summary.fingerprints_table]
        sys.stdout.write("\n".join(table(entries) for table in tables))
    else:
        faults.append(f"{arguments.folder} holds no episode.")
    if arguments.check:
        faults += summary.complaints(entries)
    sys.stdout.flush()
    sys.stderr.writelines(f"{fault}\n" for fault in faults)
    if arguments.plot is not None and entries:
        try:
            plot(entries, arguments.plot)
        except (OSError, ValueError) as error:
            parser.error(f"the image {arguments.plot} cannot be written: {error}")
    sys.exit(1 if faults and (arguments.check or not entries) else 0)
