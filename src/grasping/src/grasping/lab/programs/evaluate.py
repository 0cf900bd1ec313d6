"""Compares grasp methods on held-out objects, by lifting in MuJoCo and by the rectangle metric; resumable.

Half of the scenes hold one object, half three to five. Results go to results.csv, one line a grasp, and table.md. With
--export scenes and grasps go to a file instead, for whoever lifts with another hand (rosrun rig_simulation
lift_grasps.py). Each split, and each --tool, wants a folder of its own: lines that are there are not made again.
With --folder the methods see labelled depth images instead (Cornell's, Jacquard's or label_grasps.py's), and the
rectangle metric alone judges; results go to rectangles.csv and rectangles.md.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import json
import multiprocessing
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import cv2
import mujoco
import numpy as np
import torch
from tqdm import tqdm

from common.config import parse
from common.errors import RigError
from common.ros.files import read_yaml
from common.statistics import proportion
from grasping.lab.dataset import labelled_images
from grasping.lab.evaluation import trials
from grasping.lab.programs.make_dataset import ignore_warning
from grasping.lab.synthetic.scene import world_xml
from grasping.network import maps, weights
from grasping.network.depth_image import CROP_SIDE, NetworkImage, prepare
from grasping.network.networks import WIDTH_SCALE_PX, frozen, infer
from grasping.pipeline.projection import pixel_size
from grasping.pipeline.tool_pose import ToolPoseConfig, preferred

COLUMNS = ("scene", "objects", "method", *trials.TrialOutcome._fields)
EXPORT_SCHEMA = 1
OVERLAPS = (0.25, 0.5, 0.75)  # of the rectangle metric; publications give the first
QUALITY_LIMITS = (0.3, 0.4, 0.5, 0.6)
NETWORK_SMOOTHING = maps.Smoothing(quality=2.0)  # as the reference experiments; the node blurs for a moving camera


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Returns a table in Markdown."""
    lines = (header, ["---"] * len(header), *rows)
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


class ResultsFile:
    """A CSV file of results; reads the rows of an earlier run first. Raises OSError if it cannot be read or written."""

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.rows: list[dict] = []
        if path.exists():
            with path.open(newline="") as file:
                self.rows = list(csv.DictReader(file))
        self._file = path.open("a", newline="")
        self._writer = csv.DictWriter(self._file, columns, lineterminator="\n")
        if not self.rows:
            self._writer.writeheader()

    def add(self, rows: list[dict]) -> None:
        """Appends rows to the file."""
        self._writer.writerows(rows)
        self._file.flush()
        self.rows += rows

    def close(self) -> None:
        self._file.close()


class Trained(NamedTuple):
    """A network to be tried."""

    file: Path  # of its weights
    tool: ToolPoseConfig | None  # the hand whose openings it prefers, None where it knows no hand


class Task(NamedTuple):
    """A scene to be tried."""

    split: str  # of the scene
    number: int  # of the scene
    methods: list[str]  # their names
    trained: dict[str, Trained]  # the networks among them


@lru_cache(maxsize=8)
def network(file: Path) -> torch.jit.ScriptModule:
    """Returns the network of a weight file."""
    return frozen(weights.load(file.read_bytes()).network)


def network_grasp(image: NetworkImage, trained: Trained) -> maps.Peak:
    """Returns the best grasp of a network."""
    found = maps.smoothed(infer(network(trained.file), image.input), image.valid, NETWORK_SMOOTHING)
    if trained.tool is not None:
        size = pixel_size(image, trials.camera())
        found = preferred(found, size, trained.tool, maps.THRESHOLD)
    return maps.highest(found)


def try_scene(task: Task) -> list[dict]:
    """Returns the rows of all methods that are still missing for one scene."""
    split, number, missing, trained = task
    of, chosen = chosen_grasps(split, number, missing, trained)
    row = {"scene": number, "objects": len(of.view.scene.objects)}
    return [{**row, "method": name, **trials.judge(of, peak)._asdict()} for name, peak in chosen.items()]


def export_scene(task: Task) -> dict:
    """Returns one scene and all methods' grasps in it, as the file of --export has them."""
    split, number, names, trained = task
    of, chosen = chosen_grasps(split, number, names, trained)
    tried = {name: trials.executed(of, peak) for name, peak in chosen.items()}
    friction = next((t.friction for t in tried.values() if t is not None), trials.FRICTION[0])
    poses = {name: (None, None) if t is None else (t.T_world_grasp.tolist(), t.width) for name, t in tried.items()}
    return {
        "scene": number,
        "objects": len(of.view.scene.objects),
        "mjcf": world_xml(of.view.scene.objects, friction),
        "qpos": of.view.scene.state.tolist(),
        "grasps": [{"method": name, "T_world_grasp": T, "width": width} for name, (T, width) in poses.items()],
    }


def chosen_grasps(
    split: str, number: int, names: Iterable[str], trained: Mapping[str, Trained]
) -> tuple[trials.TrialScene, dict[str, maps.Peak | None]]:
    """Returns a scene and what each method chooses in it."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)
    of = trials.situation(split, number, 1 if number % 2 == 0 else 3 + number // 2 % 3)
    chosen: dict[str, maps.Peak | None] = {}
    for name in names:
        if name == "oracle":
            chosen[name] = trials.oracle(of)
        elif name in trained:
            chosen[name] = network_grasp(of.image, trained[name])
        else:
            chosen[name] = trials.HEURISTICS[name](of.image, of.widest, np.random.default_rng([7, number]))
    return of, chosen


def try_images(folder: Path, side: int, trained: Mapping[str, Trained]) -> list[dict]:
    """Returns a row for each labelled image of a folder and each method; `side`: of the window about the grasps [px].

    Raises RigError if the folder holds none, or an image cannot be used.
    """
    rows = []
    for number, labelled in enumerate(tqdm(labelled_images.read(folder), unit="image")):
        depth = labelled.depth()
        crop = labelled_images.crop_around(labelled.grasps, depth.shape, side)
        try:
            image = prepare(depth, crop)
        except ValueError as error:
            raise RigError(f"{labelled.name}: {error}.") from error
        wanted = labelled_images.labels(labelled, crop)
        for name in (*trials.HEURISTICS, *trained):
            if name in trained:
                found: maps.Peak | None = network_grasp(image, trained[name])
            else:
                found = trials.HEURISTICS[name](image, WIDTH_SCALE_PX, np.random.default_rng([7, number]))
            right = {f"{least:g}": found is not None and trials.is_right(found, wanted, least) for least in OVERLAPS}
            rows.append({"image": labelled.name, "method": name, "quality": found.quality if found else 0.0, **right})
    return rows


def rectangle_table(rows: list[dict], methods: Iterable[str]) -> str:
    """Returns the rows of `try_images` as a Markdown table."""
    columns = [f"{least:g}" for least in OVERLAPS]
    lines = [[method, *(_fraction(rows, method, column, lambda _: True) for column in columns)] for method in methods]
    return markdown_table(("right %, by the least overlap", *columns), lines)


def table(rows: list[dict], methods: Iterable[str]) -> str:
    """Returns the results as a Markdown table."""
    header = ("method", *(f"{n}: {field} %" for field in ("lifted", "rectangle") for n in ("one object", "clutter")))
    parts = (lambda r: int(r["objects"]) == 1), (lambda r: int(r["objects"]) > 1)
    fields = ("lifted", "rectangle")
    lines = [[m, *(_fraction(rows, m, field, part) for field in fields for part in parts)] for m in methods]
    return markdown_table(header, lines)


def calibration(rows: list[dict], methods: Iterable[str]) -> str:
    """Returns, as a Markdown table, how many grasps were lifted by the quality that the method gave them."""
    ranges = list(zip((-np.inf, *QUALITY_LIMITS), (*QUALITY_LIMITS, np.inf)))
    names = [f"< {QUALITY_LIMITS[0]}", *(f"{a} to {b}" for a, b in ranges[1:-1]), f">= {QUALITY_LIMITS[-1]}"]
    parts = [(lambda r, low=low, high=high: low <= float(r["quality"]) < high) for low, high in ranges]
    lines = [[method, *(_fraction(rows, method, "lifted", part) for part in parts)] for method in methods]
    return markdown_table(("lifted %, quality", *names), lines)


def _fraction(rows: list[dict], method: str, field: str, chosen: Callable[[dict], bool]) -> str:
    """Returns the fraction of the chosen rows of a method in which a field is true."""
    outcomes = [str(r[field]) == "True" for r in rows if r["method"] == method and chosen(r)]
    return str(proportion(outcomes)) if outcomes else "-"


def export(path: Path, tasks: Sequence[Task], processes: int) -> None:
    """Writes the file of --export."""
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        scenes = list(tqdm(pool.imap(export_scene, tasks), total=len(tasks), unit="scene"))
    path.write_text(json.dumps({"schema": EXPORT_SCHEMA, "scenes": scenes}) + "\n")


def judge_images(
    parser: argparse.ArgumentParser, results: Path, images: Path, side: int, trained: Mapping[str, Trained]
) -> None:
    """Writes and prints what --folder asks for."""
    try:
        rows = try_images(images, side, trained)
        results.mkdir(parents=True, exist_ok=True)
        with (results / "rectangles.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        found = rectangle_table(rows, (*trials.HEURISTICS, *trained))
        (results / "rectangles.md").write_text(found)
    except RigError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"{error.filename} cannot be used: {error.strerror}.")
    sys.stdout.write(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", help="where the results go")
    parser.add_argument("--scenes", type=int, default=300, help="how many")
    parser.add_argument("--weights", nargs=2, action="append", default=[], metavar=("NAME", "FILE"), help="a network")
    splits = "test: families that training never saw; validation: new scenes of its own, to choose by"
    parser.add_argument("--split", choices=("test", "validation"), default="test", help=splits)
    preferred_help = "a tool_pose.yaml: try each network with that hand's preferred openings as well"
    parser.add_argument("--tool", type=Path, metavar="FILE", help=preferred_help)
    parser.add_argument("--processes", type=int, default=1, help="how many scenes at a time")
    folder_help = "labelled depth images instead of scenes"
    parser.add_argument("--folder", dest="images", type=Path, metavar="IMAGES", help=folder_help)
    side_help = f"with --folder, side of the window about an image's grasps [px], default {CROP_SIDE}; Jacquard: 1024"
    parser.add_argument("--window", type=int, default=CROP_SIDE, help=side_help)
    parser.add_argument("--export", type=Path, metavar="FILE", help="write scenes and grasps there, lift nothing")
    arguments = parser.parse_args()
    if (arguments.folder is None) == (arguments.export is None):
        parser.error("Either a folder for the results is needed, or --export.")
    if arguments.images is not None and (arguments.export is not None or arguments.tool is not None):
        parser.error("--folder judges by rectangles in images: it goes with neither --export nor --tool.")
    if arguments.window < 1:
        parser.error(f"--window is {arguments.window} and must be at least 1 pixel.")
    trained = {}
    try:
        tool = arguments.tool and parse(ToolPoseConfig, read_yaml(arguments.tool))
        for name, file in arguments.weights:
            weights.load(Path(file).read_bytes())
            trained[name] = Trained(Path(file), None)
            if tool:
                trained[f"{name}, preferred openings"] = Trained(Path(file), tool)
    except (OSError, RigError) as error:
        parser.error(str(error))
    if arguments.images is not None:
        judge_images(parser, arguments.folder, arguments.images, arguments.window, trained)
        return
    methods = ["oracle", *trials.HEURISTICS, *trained]
    if arguments.export is not None:
        every = [Task(arguments.split, number, methods, trained) for number in range(arguments.scenes)]
        export(arguments.export, every, arguments.processes)
        return
    try:
        results = ResultsFile(arguments.folder / "results.csv", COLUMNS)
    except OSError as error:
        parser.error(f"{error.filename} cannot be used: {error.strerror}.")
    done = {(int(r["scene"]), r["method"]) for r in results.rows}
    wanted = ((number, [m for m in methods if (number, m) not in done]) for number in range(arguments.scenes))
    tasks = [Task(arguments.split, number, missing, trained) for number, missing in wanted if missing]
    with contextlib.closing(results), multiprocessing.get_context("spawn").Pool(arguments.processes) as pool:
        for new in tqdm(pool.imap_unordered(try_scene, tasks), total=len(tasks), unit="scene"):
            results.add(new)
    tables = table(results.rows, methods), calibration(results.rows, trained)
    (arguments.folder / "table.md").write_text("\n".join(tables))
