"""Compares grasp networks on held-out objects, by lifting in MuJoCo, with each other and with the best label.

Half of the scenes hold one object, half three to five. The object that a grasp was meant for must rise and stay up.
Results go to results.csv, one line a grasp with its reason, table.md, with paired differences, reliability.png,
failures_METHOD.png for each network, and settings.json. A NAME given several times is several trainings of one network:
the tables give their mean as well. With --export scenes and grasps go to a file instead, for the rig's hand (rosrun
rig_simulation lift_grasps.py). With --folder the networks see labelled depth images instead (label_grasps.py's,
Cornell's or Jacquard's), and the rectangle metric judges.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import json
import multiprocessing
import re
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import mujoco
import numpy as np
import torch
from tqdm import tqdm

from common.command_line import real, whole
from common.config import parse
from common.errors import RigError
from common.lift_trial import LIFTED
from common.ros.files import read_yaml
from grasping.lab.dataset import labelled_images
from grasping.lab.evaluation import lift_file, sheets, tables, trials
from grasping.lab.programs.make_dataset import ignore_warning
from grasping.lab.synthetic import surroundings
from grasping.lab.synthetic.samples import view
from grasping.lab.synthetic.scene import points
from grasping.network import maps, weights
from grasping.network.depth_image import CROP_SIDE, NetworkImage, prepare
from grasping.network.networks import FLOAT32, PRECISIONS, MapNetwork, frozen, infer
from grasping.pipeline.projection import pixel_size
from grasping.pipeline.tool_pose import ToolPoseConfig, preferred

COLUMNS = ("scene", "objects", "method", *trials.TrialOutcome._fields)
RECTANGLE_COLUMNS = ("image", "method", "quality", "right")
SPLITS = ("test", "validation", "unseen", "blobs", *surroundings.KINDS)
ORACLE = "oracle"
NETWORK_SMOOTHING = maps.Smoothing(quality=2.0)  # as the reference experiments; the node blurs for a moving camera


class Trained(NamedTuple):
    """A network to be tried."""

    file: Path  # of its weights
    tool: ToolPoseConfig | None  # the hand whose openings it prefers, None where it knows no hand
    precision: str = FLOAT32  # in `networks.PRECISIONS`


class Task(NamedTuple):
    """A scene to be tried."""

    split: str  # of the scene
    number: int  # of the scene
    trained: dict[str, Trained]  # the networks by name
    conditions: trials.Conditions


class FailureTask(NamedTuple):
    """A failed grasp to be drawn."""

    split: str  # of the scene
    row: Mapping[str, Any]  # of the results


@lru_cache(maxsize=8)
def network(file: Path, precision: str) -> MapNetwork:
    return frozen(weights.load(file.read_bytes()).network, precision=precision)


def network_grasp(image: NetworkImage, trained: Trained) -> maps.Peak:
    output = infer(network(trained.file, trained.precision), image.input)
    found = maps.smoothed(output, image.valid, NETWORK_SMOOTHING)
    if trained.tool is not None:
        size = pixel_size(image, trials.camera())
        found = preferred(found, size, trained.tool, maps.THRESHOLD)
    return maps.highest(found)


def try_scene(task: Task) -> list[dict]:
    of, chosen = chosen_grasps(task)
    row = {"scene": task.number, "objects": len(of.view.scene.objects)}
    judged = {name: trials.judge(of, peak, task.conditions) for name, peak in chosen.items()}
    return [{**row, "method": name, **outcome._asdict()} for name, outcome in judged.items()]


def export_scene(task: Task) -> dict:
    """Returns one scene and all methods' grasps in it, as the file of --export has them."""
    of, chosen = chosen_grasps(task)
    tried = {name: trials.executed(of, peak, task.conditions) for name, peak in chosen.items()}
    friction = next((t.friction for t in tried.values() if t is not None), trials.FRICTION[0])
    grasps = [
        lift_file.no_grasp(name)
        if (t := tried[name]) is None
        else lift_file.grasp_entry(name, t.T_world_grasp, t.width, t.target, peak)
        for name, peak in chosen.items()
    ]
    return lift_file.scene_entry(task.split, task.number, of.view.scene, friction, grasps)


def object_count(number: int) -> int:
    return 1 if number % 2 == 0 else 3 + number // 2 % 3


def chosen_grasps(task: Task) -> tuple[trials.TrialScene, dict[str, maps.Peak | None]]:
    _prepare_process()
    of = trials.situation(task.split, task.number, object_count(task.number), task.conditions)
    found = {name: network_grasp(of.image, trained) for name, trained in task.trained.items()}
    return of, {ORACLE: trials.oracle(of), **found}


def failed_grasp(task: FailureTask) -> sheets.FailedGrasp:
    _prepare_process()
    row, number = task.row, task.row["scene"]
    seen = view(task.split, number, object_count(number))
    heights = points(prepare(seen.observed, trials.CROP).depth, seen.camera)[..., 2]
    peak = maps.Peak(*(row[name] for name in maps.Peak._fields)) if row["found"] else None
    return sheets.FailedGrasp(number, row["reason"], heights, peak, row["opening"], row.get("tilt", 0.0))


def _prepare_process() -> None:
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)


def report(folder: Path, split: str, rows: list[dict], networks: list[str], processes: int) -> None:
    methods = [ORACLE, *networks]
    drawn = networks or methods
    made = [
        tables.table(rows, methods),
        tables.differences(rows, methods, networks),
        tables.failures(rows, methods),
        tables.calibration(rows, drawn),
    ]
    (folder / "table.md").write_text("\n".join(text for text in made if text), encoding="utf-8")
    of = {name: [row for row in rows if row["method"] == name] for name in drawn}
    reliable = {name: ([r["quality"] for r in own], [r["lifted"] for r in own]) for name, own in of.items()}
    sheets.reliability_plot(folder / "reliability.png", reliable)
    draw_failures(folder, split, of, processes)


def draw_failures(folder: Path, split: str, rows: Mapping[str, Sequence[Mapping[str, Any]]], processes: int) -> None:
    """Draws the failed grasps of each method into failures_METHOD.png; `rows`: results by method."""
    failed = {name: [row for row in own if row["reason"] != LIFTED] for name, own in rows.items()}
    tasks = [FailureTask(split, row) for own in failed.values() for row in own[: sheets.MOST]]
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        pictures = iter(list(tqdm(pool.imap(failed_grasp, tasks), total=len(tasks), unit="picture")))
    for name, own in failed.items():
        shown = [next(pictures) for _ in own[: sheets.MOST]]
        path = folder / f"failures_{re.sub(r'[^0-9A-Za-z]+', '_', name).strip('_')}.png"
        sheets.failure_sheet(path, name, len(rows[name]), [row["reason"] for row in own], shown)


@contextlib.contextmanager
def open_results(folder: Path, columns: Sequence[str]) -> Iterator[csv.DictWriter]:
    """Opens a new results.csv in a folder, which goes again if no result is written; raises RigError if it is there
    already, or cannot be written."""
    path = folder / "results.csv"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with path.open("x", newline="", encoding="utf-8", buffering=1) as file:
            writer = csv.DictWriter(file, columns, lineterminator="\n")
            writer.writeheader()
            empty = file.tell()
            try:
                yield writer
            finally:
                if file.tell() == empty:
                    path.unlink()
    except FileExistsError as error:
        raise RigError(f"{error.filename} is there already: name another folder.") from None
    except OSError as error:
        raise RigError(f"{error.filename or folder} cannot be used: {error.strerror}.") from None


def evaluate(folder: Path, tasks: Sequence[Task], processes: int) -> list[dict]:
    """Tries all scenes, writes results.csv and returns its rows; raises RigError as `open_results`."""
    rows = []
    with open_results(folder, COLUMNS) as writer, multiprocessing.get_context("spawn").Pool(processes) as pool:
        for new in tqdm(pool.imap(try_scene, tasks), total=len(tasks), unit="scene"):
            writer.writerows(new)
            rows += new
    return rows


def judge_images(folder: Path, images: Path, side: int, trained: Mapping[str, Trained]) -> str:
    """Judges each network's best grasp in labelled images, in a window of `side` pixels about the labels, by the
    rectangle metric; writes results.csv and returns a Markdown table. Images that cannot be used are named and left
    out; raises RigError if there are no others, or as `open_results`.
    """
    labelled, left_out = labelled_images.read(images)
    rows: list[dict] = []
    with open_results(folder, RECTANGLE_COLUMNS) as writer:
        for one in tqdm(labelled, unit="image"):
            try:
                depth = one.checked_depth()
                crop = labelled_images.crop_around(one.grasps, depth.shape, side)
                image = prepare(depth, crop)
            except (RigError, ValueError) as error:
                left_out.append(f"{one.name}: {error}")
                continue
            wanted = labelled_images.labels(one, crop)
            for name, of in trained.items():
                peak = network_grasp(image, of)
                right = trials.is_right(peak, wanted)
                rows.append({"image": one.name, "method": name, "quality": peak.quality, "right": right})
                writer.writerow(rows[-1])
    sys.stderr.writelines(f"Left out: {sentence}\n" for sentence in left_out)
    if not rows:
        raise RigError(f"None of the {len(labelled)} labelled images in {images} can be used.")
    lines = [[name, tables.fraction(rows, name, "right", lambda _: True)] for name in trained]
    return tables.markdown_table(("", "right by the rectangle metric %"), lines)


def read_arguments(parser: argparse.ArgumentParser) -> argparse.Namespace:
    add = parser.add_argument
    add("folder", type=Path, nargs="?", help="where the results go")
    add("--scenes", type=whole(1, 10**9), default=300, help="how many")
    add("--first", type=whole(0, 10**9), default=0, help="number of the first one, default 0")
    add("--weights", nargs=2, action="append", default=[], metavar=("NAME", "FILE"), help="a network")
    splits = "validation: new scenes of training's families, to choose by; the others hold objects that it never saw"
    add("--split", choices=SPLITS, default="test", help=splits)
    default = 1000.0 * trials.POSITION_ERROR_M, float(np.degrees(trials.ANGLE_ERROR_RAD))
    error_help = "of the arm, standard deviations across and about the approach, the same in a scene for all methods"
    error_help += f", default {default[0]:.0f} {default[1]:.0f}"
    add("--error", type=real(0.0, 100.0), nargs=2, default=default, metavar=("MM", "DEG"), help=error_help)
    shake_help = "shake the hand after the lift, 0.5 g along three axes; with --export, lift_grasps.py has its own"
    add("--shake", action="store_true", help=shake_help)
    preferred_help = "a tool_pose.yaml: try each network with that hand's preferred openings as well"
    add("--tool", type=Path, metavar="FILE", help=preferred_help)
    add("--precision", choices=PRECISIONS, default=FLOAT32, help="of these networks' convolutions")
    add("--processes", type=whole(1, 1024), default=1, help="how many scenes at a time")
    add("--export", type=Path, metavar="FILE", help="write scenes and grasps there, lift nothing")
    add("--folder", type=Path, metavar="IMAGES", dest="images", help="judge by the labelled images of this folder")
    side_help = f"with --folder, side of the window about an image's grasps [px], default {CROP_SIDE}; Jacquard: 1024"
    add("--window", type=whole(1, 16384), default=CROP_SIDE, help=side_help)
    arguments = parser.parse_args()
    if (arguments.folder is None) == (arguments.export is None):
        parser.error("Either a folder for the results is needed, or --export.")
    if arguments.images is not None and (arguments.export or arguments.tool or not arguments.weights):
        parser.error("--folder judges networks by rectangles in images: with --weights, without --export and --tool.")
    return arguments


def networks(
    given: Iterable[tuple[str, str]], tool: ToolPoseConfig | None, precision: str = FLOAT32
) -> dict[str, Trained]:
    """Returns the networks to be tried by name; raises RigError or OSError if a weight file is not one."""
    given, found = list(given), {}
    many = Counter(name for name, _ in given)
    met: Counter[str] = Counter()
    for name, file in given:
        weights.load(Path(file).read_bytes())
        met[name] += 1
        number = f" #{met[name]}" if many[name] > 1 else ""
        found[name + number] = Trained(Path(file), None, precision)
        if tool:
            found[f"{name}, preferred openings{number}"] = Trained(Path(file), tool, precision)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    arguments = read_arguments(parser)
    try:
        tool = arguments.tool and parse(ToolPoseConfig, read_yaml(arguments.tool))
        trained = networks(arguments.weights, tool, arguments.precision)
    except (OSError, RigError) as error:
        parser.error(str(error))
    if arguments.images is not None:
        try:
            sys.stdout.write(judge_images(arguments.folder, arguments.images, arguments.window, trained))
        except RigError as error:
            parser.error(str(error))
        return
    millimetres, degrees = arguments.error
    conditions = trials.Conditions(0.001 * millimetres, float(np.radians(degrees)), arguments.shake)
    if arguments.export is not None:
        conditions = conditions._replace(hand=maps.REFLEX)
    numbers = range(arguments.first, arguments.first + arguments.scenes)
    tasks = [Task(arguments.split, number, trained, conditions) for number in numbers]
    if arguments.export is not None:
        lift_file.write(arguments.export, export_scene, tasks, arguments.processes)
        return
    try:
        rows = evaluate(arguments.folder, tasks, arguments.processes)
    except RigError as error:
        parser.error(str(error))
    hashes = {name: weights.checked_sha256(of.file.read_bytes(), None) for name, of in trained.items()}
    settings = {name: getattr(arguments, name) for name in ("split", "first", "scenes", "error", "shake", "precision")}
    settings.update(tool=tool and repr(tool), weights=hashes)
    (arguments.folder / "settings.json").write_text(json.dumps(settings, indent=2) + "\n")
    report(arguments.folder, arguments.split, rows, list(trained), arguments.processes)
