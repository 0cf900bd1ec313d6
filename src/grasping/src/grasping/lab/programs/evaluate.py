"""Compares grasp methods on held-out objects, by lifting in MuJoCo and by the rectangle metric; resumable.

Half of the scenes hold one object, half three to five. The object that a grasp was meant for must rise and stay up.
Results go to results.csv, one line a grasp with its reason, table.md, with paired differences, reliability.png, and
failures_METHOD.png for each network, or for each method if no network is given. A folder holds one set of conditions:
lines that are there are not made again. A NAME given several times is several trainings of one network: the tables give
their mean as well. With --export scenes and grasps go to a file instead, for the rig's hand (rosrun rig_simulation
lift_grasps.py), and --lifts makes the same tables and pictures of what that hand did.
With --folder the methods see labelled depth images instead (Cornell's, Jacquard's or label_grasps.py's), and the
rectangle metric alone judges; results go to rectangles.csv and rectangles.md.
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
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import mujoco
import numpy as np
import torch
from tqdm import tqdm

from common.config import parse
from common.errors import RigError
from common.lift_trial import LIFTED
from common.ros.files import read_yaml
from grasping.lab.dataset import labelled_images
from grasping.lab.evaluation import sheets, tables, trials
from grasping.lab.evaluation.tables import fraction, markdown_table
from grasping.lab.programs.make_dataset import ignore_warning
from grasping.lab.synthetic.samples import view
from grasping.lab.synthetic.scene import points, world_xml
from grasping.network import maps, weights
from grasping.network.depth_image import CROP_SIDE, NetworkImage, prepare
from grasping.network.maps import WIDTH_SCALE_PX
from grasping.network.networks import FLOAT32, PRECISIONS, MapNetwork, frozen, infer
from grasping.pipeline.projection import pixel_size
from grasping.pipeline.tool_pose import ToolPoseConfig, preferred

COLUMNS = ("scene", "objects", "method", *trials.TrialOutcome._fields)
EXPORT_SCHEMA = 2
SPLITS = ("test", "test_2", "validation")
SETTINGS = "settings.json"
OVERLAPS = (0.25, 0.5, 0.75)  # of the rectangle metric; publications give the first
NETWORK_SMOOTHING = maps.Smoothing(quality=2.0)  # as the reference experiments; the node blurs for a moving camera


class ResultsFile:
    """A CSV file of results; reads the rows of an earlier run first. Raises OSError if it cannot be read or written."""

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.rows: list[dict] = []
        if path.exists():
            with path.open(newline="", encoding="utf-8-sig") as file:
                self.rows = list(csv.DictReader(file))
        self._file = path.open("a", newline="", encoding="utf-8")
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
    precision: str = FLOAT32  # in `networks.PRECISIONS`


class Task(NamedTuple):
    """A scene to be tried."""

    split: str  # of the scene
    number: int  # of the scene
    methods: list[str]  # their names
    trained: dict[str, Trained]  # the networks among them
    conditions: trials.Conditions


class FailureTask(NamedTuple):
    """A failed grasp to be drawn."""

    split: str  # of the scene
    row: Mapping[str, Any]  # of the results


@lru_cache(maxsize=8)
def network(file: Path, precision: str) -> MapNetwork:
    """Returns the network of a weight file."""
    return frozen(weights.load(file.read_bytes()).network, precision=precision)


def network_grasp(image: NetworkImage, trained: Trained) -> maps.Peak:
    """Returns the best grasp of a network."""
    output = infer(network(trained.file, trained.precision), image.input)
    found = maps.smoothed(output, image.valid, NETWORK_SMOOTHING)
    if trained.tool is not None:
        size = pixel_size(image, trials.camera())
        found = preferred(found, size, trained.tool, maps.THRESHOLD)
    return maps.highest(found)


def try_scene(task: Task) -> list[dict]:
    """Returns the rows of all methods that are still missing for one scene."""
    of, chosen = chosen_grasps(task)
    row = {"scene": task.number, "objects": len(of.view.scene.objects)}
    judged = {name: trials.judge(of, peak, task.conditions) for name, peak in chosen.items()}
    return [{**row, "method": name, **outcome._asdict()} for name, outcome in judged.items()]


def export_scene(task: Task) -> dict:
    """Returns one scene and all methods' grasps in it, as the file of --export has them."""
    of, chosen = chosen_grasps(task)
    tried = {name: trials.executed(of, peak, task.conditions) for name, peak in chosen.items()}
    friction = next((t.friction for t in tried.values() if t is not None), trials.FRICTION[0])
    grasps = []
    for name, peak in chosen.items():
        grasp: dict[str, Any] = {"method": name, "T_world_grasp": None, "width": None, "target": None, "peak": None}
        if (t := tried[name]) is not None and peak is not None:
            grasp.update(T_world_grasp=t.T_world_grasp.tolist(), width=t.width, target=t.target, peak=peak._asdict())
        grasps.append(grasp)
    return {
        "split": task.split,
        "scene": task.number,
        "objects": len(of.view.scene.objects),
        "mjcf": world_xml(of.view.scene.objects, friction),
        "qpos": of.view.scene.state.tolist(),
        "grasps": grasps,
    }


def object_count(number: int) -> int:
    """Returns how many objects lie in a scene."""
    return 1 if number % 2 == 0 else 3 + number // 2 % 3


def chosen_grasps(task: Task) -> tuple[trials.TrialScene, dict[str, maps.Peak | None]]:
    """Returns a scene and what each method chooses in it."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)
    number = task.number
    of = trials.situation(task.split, number, object_count(number), task.conditions)
    chosen: dict[str, maps.Peak | None] = {}
    for name in task.methods:
        if name == "oracle":
            chosen[name] = trials.oracle(of)
        elif name in task.trained:
            chosen[name] = network_grasp(of.image, task.trained[name])
        else:
            chosen[name] = trials.HEURISTICS[name](of.image, of.widest, np.random.default_rng([7, number]))
    return of, chosen


def failed_grasp(task: FailureTask) -> sheets.FailedGrasp:
    """Returns what the sheet shows of a failed grasp."""
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)
    row, number = task.row, int(task.row["scene"])
    seen = view(task.split, number, object_count(number))
    heights = points(prepare(seen.observed, trials.CROP).depth, seen.camera)[..., 2]
    peak = None
    if tables.is_true(row["found"]):
        values = (float(row[name]) for name in ("quality", "angle", "width"))
        peak = maps.Peak(int(row["row"]), int(row["column"]), *values)
    return sheets.FailedGrasp(number, row["reason"], heights, peak, float(row["opening"]))


def report(folder: Path, split: str, rows: list[dict], methods: list[str], networks: list[str], processes: int) -> None:
    """Writes tables and pictures of the results."""
    made = [tables.table(rows, methods), tables.differences(rows, methods, networks), tables.failures(rows, methods)]
    drawn = networks or methods
    made.append(tables.calibration(rows, drawn))
    (folder / "table.md").write_text("\n".join(text for text in made if text), encoding="utf-8")
    of = {name: [row for row in rows if row["method"] == name] for name in drawn}
    reliable = {
        name: ([float(r["quality"]) for r in own], [tables.is_true(r["lifted"]) for r in own])
        for name, own in of.items()
    }
    sheets.reliability_plot(folder / "reliability.png", reliable)
    failed = {name: [row for row in own if row["reason"] != LIFTED] for name, own in of.items()}
    tasks = [FailureTask(split, row) for name in drawn for row in failed[name][: sheets.MOST]]
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        pictures = iter(list(tqdm(pool.imap(failed_grasp, tasks), total=len(tasks), unit="picture")))
    for name in drawn:
        shown = [next(pictures) for _ in failed[name][: sheets.MOST]]
        path = folder / f"failures_{re.sub(r'[^0-9A-Za-z]+', '_', name).strip('_')}.png"
        sheets.failure_sheet(path, name, len(of[name]), [row["reason"] for row in failed[name]], shown)


def claim(folder: Path, settings: dict[str, Any]) -> None:
    """Notes the conditions of the results in a folder; raises RigError if it holds results of other ones.

    Networks may join; one name stands for one weight file in one precision.
    """
    path = folder / SETTINGS
    folder.mkdir(parents=True, exist_ok=True)
    try:
        before = json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
    except ValueError as error:
        raise RigError(f"{path} is not JSON ({error}): name another folder.") from None
    if before is None and (folder / "results.csv").exists():
        raise RigError(f"{folder} holds results without {SETTINGS}, of unknown conditions: name another folder.")
    if before is not None:
        for name in settings.keys() - {"weights"}:
            if before.get(name) != settings[name]:
                raise RigError(
                    f"{folder} holds results with {name} {before.get(name)}, not {settings[name]}: name another folder."
                )
        for name, file in settings["weights"].items():
            if before["weights"].get(name, file) != file:
                raise RigError(f"{folder} holds results of another network named {name}: name this one otherwise.")
        settings = {**settings, "weights": {**before["weights"], **settings["weights"]}}
    path.write_text(json.dumps(settings, indent=2) + "\n")


def lifted_rows(path: Path) -> tuple[str, list[dict]]:
    """Returns the split and the rows of what lift_grasps.py wrote; raises RigError if the file is not that."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        rows = []
        for row in found:
            peak = row["peak"] or {}
            rest = {name: row[name] for name in ("scene", "objects", "method", "lifted", "reached", "reason")}
            rest.update(found=bool(peak), rectangle="", quality=peak.get("quality", 0.0), opening=row["width"] or 0.0)
            rows.append({**rest, **{name: peak.get(name, 0) for name in ("row", "column", "angle", "width")}})
        (split,) = {row["split"] for row in found}
        if split not in SPLITS:
            raise ValueError(f"the split is {split}")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise RigError(f"{path} is not a file of lift_grasps.py --results ({error}).") from None
    return split, rows


def try_images(folder: Path, side: int, trained: Mapping[str, Trained]) -> list[dict]:
    """Returns a row for each labelled image of a folder and each method; `side`: of the window about the grasps [px].

    Images that cannot be used are named and left out. Raises RigError if there are no others.
    """
    rows: list[dict] = []
    images, left_out = labelled_images.read(folder)
    for number, labelled in enumerate(tqdm(images, unit="image")):
        try:
            depth = labelled.checked_depth()
            crop = labelled_images.crop_around(labelled.grasps, depth.shape, side)
            image = prepare(depth, crop)
        except (RigError, ValueError) as error:
            left_out.append(f"{labelled.name}: {error}")
            continue
        wanted = labelled_images.labels(labelled, crop)
        for name in (*trials.HEURISTICS, *trained):
            if name in trained:
                found: maps.Peak | None = network_grasp(image, trained[name])
            else:
                found = trials.HEURISTICS[name](image, WIDTH_SCALE_PX, np.random.default_rng([7, number]))
            right = {f"{least:g}": found is not None and trials.is_right(found, wanted, least) for least in OVERLAPS}
            rows.append({"image": labelled.name, "method": name, "quality": found.quality if found else 0.0, **right})
    sys.stderr.writelines(f"Left out: {sentence}\n" for sentence in left_out)
    if not rows:
        raise RigError(f"None of the {len(images)} labelled images in {folder} can be used.")
    return rows


def rectangle_table(rows: list[dict], methods: Iterable[str]) -> str:
    """Returns the rows of `try_images` as a Markdown table."""
    columns = [f"{least:g}" for least in OVERLAPS]
    lines = [[method, *(fraction(rows, method, column, lambda _: True) for column in columns)] for method in methods]
    return markdown_table(("right %, by the least overlap", *columns), lines)


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
        with (results / "rectangles.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, rows[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        found = rectangle_table(rows, (*trials.HEURISTICS, *trained))
        (results / "rectangles.md").write_text(found, encoding="utf-8")
    except RigError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"{error.filename} cannot be used: {error.strerror}.")
    sys.stdout.write(found)


def read_arguments(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Returns the program's arguments."""
    parser.add_argument("folder", type=Path, nargs="?", help="where the results go")
    parser.add_argument("--scenes", type=int, default=300, help="how many")
    parser.add_argument("--first", type=int, default=0, help="number of the first one, default 0")
    parser.add_argument("--weights", nargs=2, action="append", default=[], metavar=("NAME", "FILE"), help="a network")
    splits = "test, test_2: families that training never saw; validation: new scenes of its own, to choose by"
    parser.add_argument("--split", choices=SPLITS, default="test", help=splits)
    gripper_help = "labels: that of the training's labels, opens 100 mm; thick: another one, 85 mm, fingers of 16 mm"
    parser.add_argument("--gripper", choices=tuple(trials.GRIPPERS), default="labels", help=gripper_help)
    default = 1000.0 * trials.POSITION_ERROR_M, float(np.degrees(trials.ANGLE_ERROR_RAD))
    error_help = "of the arm, standard deviations across and about the approach, the same in a scene for all methods"
    error_help += f", default {default[0]:.0f} {default[1]:.0f}"
    parser.add_argument("--error", type=float, nargs=2, default=default, metavar=("MM", "DEG"), help=error_help)
    shake_help = "shake the hand after the lift, 0.5 g along three axes; with --export, lift_grasps.py has its own"
    parser.add_argument("--shake", action="store_true", help=shake_help)
    preferred_help = "a tool_pose.yaml: try each network with that hand's preferred openings as well"
    parser.add_argument("--tool", type=Path, metavar="FILE", help=preferred_help)
    precision_help = "of these networks' convolutions; under another NAME both can be compared in one folder"
    parser.add_argument("--precision", choices=PRECISIONS, default=FLOAT32, help=precision_help)
    parser.add_argument("--processes", type=int, default=1, help="how many scenes at a time")
    folder_help = "labelled depth images instead of scenes"
    parser.add_argument("--folder", dest="images", type=Path, metavar="IMAGES", help=folder_help)
    side_help = f"with --folder, side of the window about an image's grasps [px], default {CROP_SIDE}; Jacquard: 1024"
    parser.add_argument("--window", type=int, default=CROP_SIDE, help=side_help)
    parser.add_argument("--export", type=Path, metavar="FILE", help="write scenes and grasps there, lift nothing")
    lifts_help = "results of lift_grasps.py: make tables and pictures of them, lift nothing"
    parser.add_argument("--lifts", type=Path, metavar="FILE", help=lifts_help)
    arguments = parser.parse_args()
    if (arguments.folder is None) == (arguments.export is None):
        parser.error("Either a folder for the results is needed, or --export.")
    if arguments.images is not None and (arguments.export is not None or arguments.tool is not None):
        parser.error("--folder judges by rectangles in images: it goes with neither --export nor --tool.")
    if arguments.lifts is not None and (arguments.export is not None or arguments.images is not None):
        parser.error("--lifts reads grasps that were lifted: it goes with neither --export nor --folder.")
    if arguments.window < 1:
        parser.error(f"--window is {arguments.window} and must be at least 1 pixel.")
    for name, least in (("scenes", 1), ("first", 0), ("processes", 1)):
        if getattr(arguments, name) < least:
            parser.error(f"--{name} is {getattr(arguments, name)}, but must be at least {least}.")
    if not all(0.0 <= value <= most for value, most in zip(arguments.error, (100.0, 90.0))):
        parser.error("--error is {:g} {:g}, but must be within 0 to 100 mm and 0 to 90 deg.".format(*arguments.error))
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


def identity(of: Trained) -> str:
    """Returns what a name in a folder of results stands for: the hash of the weights, and a precision but float32."""
    sha256 = weights.checked_sha256(of.file.read_bytes(), None)
    return sha256 if of.precision == FLOAT32 else f"{sha256} {of.precision}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    arguments = read_arguments(parser)
    try:
        tool = arguments.tool and parse(ToolPoseConfig, read_yaml(arguments.tool))
        trained = networks(arguments.weights, tool, arguments.precision)
    except (OSError, RigError) as error:
        parser.error(str(error))
    if arguments.images is not None:
        judge_images(parser, arguments.folder, arguments.images, arguments.window, trained)
        return
    methods = ["oracle", *trials.HEURISTICS, *trained]
    if arguments.lifts is not None:
        try:
            split, rows = lifted_rows(arguments.lifts)
            arguments.folder.mkdir(parents=True, exist_ok=True)
        except (OSError, RigError) as error:
            parser.error(str(error))
        methods = list(dict.fromkeys(row["method"] for row in rows))
        known = {"oracle", *trials.HEURISTICS}
        report(arguments.folder, split, rows, methods, [m for m in methods if m not in known], arguments.processes)
        return
    numbers = range(arguments.first, arguments.first + arguments.scenes)
    millimetres, degrees = arguments.error
    gripper = trials.GRIPPERS[arguments.gripper]
    conditions = trials.Conditions(gripper, 0.001 * millimetres, float(np.radians(degrees)), arguments.shake)
    if arguments.export is not None:
        conditions = conditions._replace(hand=maps.REFLEX)
        every = [Task(arguments.split, number, methods, trained, conditions) for number in numbers]
        export(arguments.export, every, arguments.processes)
        return
    try:
        hashes = {name: identity(network) for name, network in trained.items()}
        hands = {"tool": None if tool is None else repr(tool)}
        settings = {name: getattr(arguments, name) for name in ("split", "gripper", "error", "shake")}
        claim(arguments.folder, {**settings, "error": list(arguments.error), **hands, "weights": hashes})
        results = ResultsFile(arguments.folder / "results.csv", COLUMNS)
    except RigError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"{error.filename} cannot be used: {error.strerror}.")
    done = {(int(r["scene"]), r["method"]) for r in results.rows}
    wanted = ((number, [m for m in methods if (number, m) not in done]) for number in numbers)
    tasks = [Task(arguments.split, number, missing, trained, conditions) for number, missing in wanted if missing]
    with contextlib.closing(results), multiprocessing.get_context("spawn").Pool(arguments.processes) as pool:
        for new in tqdm(pool.imap_unordered(try_scene, tasks), total=len(tasks), unit="scene"):
            results.add(new)
    rows = sorted(results.rows, key=lambda row: int(row["scene"]))
    report(arguments.folder, arguments.split, rows, methods, list(trained), arguments.processes)
