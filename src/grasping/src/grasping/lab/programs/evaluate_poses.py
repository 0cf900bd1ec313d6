"""Compares grasps in six degrees of freedom with those of GG-CNN alone by lifting them, with the arm's error and a
shake: what GG-CNN takes, and what each network of lifts takes, from above and tilted. Same scenes, friction and error
for all.

Networks for the rig's hand: --export FILE writes scenes and grasps, `rosrun rig_simulation lift_grasps.py FILE --shake
--tips 0 --results RESULTS` lifts them, and the same call with --results RESULTS instead makes the tables.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import mujoco
import numpy as np
import torch
from tqdm import tqdm

from common.command_line import whole
from common.errors import RigError
from common.lift_trial import NO_GRASP
from common.poses import pose
from grasping.lab.evaluation import lift_file, sheets, tables, trials
from grasping.lab.evaluation.antipodal import antipodal_grasp
from grasping.lab.evaluation.lifting import lift
from grasping.lab.programs.evaluate import SPLITS, draw_failures, object_count, open_results
from grasping.lab.programs.make_attempts import lift_network
from grasping.lab.programs.make_attempts import network as ggcnn
from grasping.lab.programs.make_dataset import ignore_warning
from grasping.lab.synthetic.attempts import image_maps
from grasping.lab.synthetic.pose_labels import meant
from grasping.lab.synthetic.samples import SPLITS as ALL_SPLITS
from grasping.lab.synthetic.samples import SceneView, view
from grasping.lab.synthetic.scene import HeapScene
from grasping.network import maps, weights
from grasping.pipeline.projection import CameraGrasp, along, project_grasp, seen_by
from grasping.poses.chooser import ImageMaps, choose
from grasping.poses.gripper import GRIPPER, Gripper
from grasping.poses.hypotheses import ABOVE_RAD, MAX_TILT_RAD, pixels_of
from grasping.poses.lift_network import loaded

ALONE = "GG-CNN along the camera's axis"
ABOVE = "GG-CNN, from above"
CLOUD = "opposed surfaces of the point cloud"
ALL = ALONE, ABOVE, CLOUD
"""The methods that know nothing of lifts."""
WAYS = {"from above": ABOVE_RAD, "tilted": MAX_TILT_RAD}
"""Greatest tilt [rad] of what a network of lifts may take."""
VALIDATION = tuple(name for name in ALL_SPLITS if name.startswith("validation_"))
COLUMNS = ("scene", "objects", "method", "found", "lifted", "reason", "tilt", "opening", *maps.Peak._fields)


class PoseTrialTask(NamedTuple):
    """A scene to be tried."""

    split: str
    number: int
    ggcnn: Path
    beside: Mapping[str, Path]
    lifts: Mapping[str, Path]
    gripper: Gripper


class ChosenPose(NamedTuple):
    """A grasp in the camera's frame."""

    T_camera_grasp: np.ndarray
    opening: float
    quality: float


class ExecutedPose(NamedTuple):
    """A grasp as the arm takes it."""

    T_world_grasp: np.ndarray  # with the arm's error, shape (4, 4) [m]
    opening: float
    target: int  # number of the object that it is meant for
    tilt: float  # of what was meant [rad]
    peak: maps.Peak


class PosesOfScene(NamedTuple):
    """A scene and each method's grasp, None where it has none."""

    scene: HeapScene
    friction: float
    executed: Mapping[str, ExecutedPose | None]


def of_scene(task: PoseTrialTask) -> PosesOfScene:
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)
    seen = view(task.split, task.number, object_count(task.number))
    friction, miss = trials.drawn(task.number, trials.USUAL)
    of = image_maps(seen, ggcnn(task.ggcnn))
    T_world_camera = pose(seen.camera.R, seen.camera.position)
    executed: dict[str, ExecutedPose | None] = {}
    for method, chosen in _chosen(task, seen, of).items():
        executed[method] = None
        if chosen is not None:
            T = T_world_camera @ chosen.T_camera_grasp
            target, tilt = meant(task.split, seen.scene, T), float(np.arccos(np.clip(-T[2, 2], -1.0, 1.0)))
            executed[method] = ExecutedPose(T @ miss, chosen.opening, target, tilt, _peak(chosen, of))
    return PosesOfScene(seen.scene, friction, executed)


def try_scene(task: PoseTrialTask) -> list[dict[str, Any]]:
    of, rows = of_scene(task), []
    for method, chosen in of.executed.items():
        row = {"scene": task.number, "objects": len(of.scene.objects), "method": method, "found": chosen is not None}
        if chosen is None:
            nothing = maps.Peak(0, 0, 0.0, 0.0, 0.0)
            rows.append({**row, "lifted": False, "reason": NO_GRASP, "tilt": 0.0, "opening": 0.0, **nothing._asdict()})
            continue
        at = chosen.T_world_grasp, chosen.opening, task.gripper, of.friction, chosen.target
        result = lift(of.scene, *at, shake=True)
        said = {"tilt": chosen.tilt, "opening": chosen.opening, **chosen.peak._asdict()}
        rows.append({**row, "lifted": result.lifted, "reason": result.reason, **said})
    return rows


def exported(task: PoseTrialTask) -> dict[str, Any]:
    """Returns a scene and all methods' grasps in it, as the file of --export has them."""
    of, grasps = of_scene(task), []
    for method, chosen in of.executed.items():
        if chosen is None:
            grasps.append(lift_file.no_grasp(method))
            continue
        at = chosen.T_world_grasp, chosen.opening, chosen.target, chosen.peak
        grasps.append(lift_file.grasp_entry(method, *at, own_approach=True))
    return lift_file.scene_entry(task.split, task.number, of.scene, of.friction, grasps)


def of_results(file: Path, tasks: Sequence[PoseTrialTask]) -> Iterator[list[dict[str, Any]]]:
    """Yields the rows of each scene from what became of its exported grasps; raises RigError for those of others."""
    scenes = lift_file.results_by_scene(file)
    for task in tasks:
        rows = []
        for of in scenes[task.split, task.number]:
            peak = of["peak"] or maps.Peak(0, 0, 0.0, 0.0, 0.0)._asdict()
            row = {name: of[name] for name in ("scene", "objects", "method", "lifted", "reason")}
            rows.append({**row, "found": of["reason"] != NO_GRASP, "tilt": "", "opening": of["width"] or 0.0, **peak})
        if not rows:
            raise RigError(f"{file} holds nothing of scene {task.number} of {task.split}.")
        yield rows


def _chosen(task: PoseTrialTask, seen: SceneView, of: ImageMaps) -> dict[str, ChosenPose | None]:
    peak = maps.highest(of.maps)
    where = _projected(of, peak, seen)
    above = None if where is None else along(where, of.frame.R[:, 2], of.camera)
    found = {ALONE: _pose(where, peak), ABOVE: _pose(above, peak)}
    opposed = antipodal_grasp(of, task.gripper, MAX_TILT_RAD, np.random.default_rng(task.number))
    found[CLOUD] = None if opposed is None else ChosenPose(*opposed)
    for name, file in task.beside.items():
        other = image_maps(seen, ggcnn(file))
        best = maps.highest(other.maps)
        found[name] = _pose(_projected(other, best, seen), best)
    own = None if above is None else of.hypotheses(above.T_camera_grasp[None], np.array([above.width]))
    for name, file in task.lifts.items():
        for way, most in WAYS.items():
            ranked = choose(lift_network(file), of, task.gripper.opening, most, own=own)
            found[f"{name}, {way}"] = None
            if len(ranked.probability):
                first = ranked.of.T[0], float(ranked.of.opening[0]), float(ranked.probability[0])
                found[f"{name}, {way}"] = ChosenPose(*first)
    return found


def _projected(of: ImageMaps, peak: maps.Peak, seen: SceneView) -> CameraGrasp | None:
    return project_grasp(peak, trials.CROP, len(of.image.depth), seen.observed, of.camera)


def _pose(grasp: CameraGrasp | None, peak: maps.Peak) -> ChosenPose | None:
    return None if grasp is None else ChosenPose(grasp.T_camera_grasp, grasp.width, peak.quality)


def _peak(chosen: ChosenPose, of: ImageMaps) -> maps.Peak:
    """Returns the grasp in the network's image."""
    T = chosen.T_camera_grasp
    (row,), (column,), _ = pixels_of(T[None, :3, 3], of.image, of.camera)
    angle, _, width = seen_by(of.camera, T, chosen.opening)
    return maps.Peak(int(row), int(column), chosen.quality, angle, width * len(of.image.depth) / of.image.crop.side)


def report(folder: Path, rows: list[dict[str, Any]], methods: list[str]) -> str:
    lines = []
    for method in methods:
        lines.append([method, *(tables.fraction(rows, method, "lifted", part) for part in tables.PARTS.values())])
    compared = [
        tables.markdown_table(("lifted %", *tables.PARTS), lines),
        tables.differences(rows, methods, methods),
        tables.failures(rows, methods),
    ]
    text = "\n".join(part for part in compared if part)
    (folder / "table.md").write_text(text, encoding="utf-8")
    of = {name: [row for row in rows if row["method"] == name] for name in methods if name not in ALL}
    sheets.reliability_plot(
        folder / "reliability.png",
        {name: ([r["quality"] for r in own], [r["lifted"] for r in own]) for name, own in of.items()},
    )
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", help="where the results go")
    parser.add_argument("ggcnn", type=Path, help="weights of GG-CNN")
    parser.add_argument(
        "--beside",
        nargs=2,
        action="append",
        default=[],
        metavar=("NAME", "FILE"),
        help="another GG-CNN, along the axis",
    )
    parser.add_argument(
        "--lifts", nargs=2, action="append", default=[], metavar=("NAME", "FILE"), help="a network of lifts"
    )
    parser.add_argument("--split", choices=(*SPLITS, *VALIDATION), default="validation", help="which scenes")
    parser.add_argument("--scenes", type=whole(1, 10**9), default=300, help="how many, default 300")
    parser.add_argument("--first", type=whole(0, 10**9), default=0, help="number of the first one, default 0")
    parser.add_argument("--export", type=Path, metavar="FILE", help="write the grasps of the rig's hand there instead")
    parser.add_argument("--results", type=Path, metavar="FILE", help="what lift_grasps.py said of them")
    parser.add_argument("--processes", type=whole(1, 1024), default=1, help="how many scenes at a time")
    given = parser.parse_args()
    if (given.folder is None) == (given.export is None) or (given.results and given.export):
        parser.error("Either a folder for the results is needed, or --export.")
    try:
        weights.load(given.ggcnn.read_bytes())
        files = {name: Path(file) for name, file in given.lifts}
        beside = {name: Path(file) for name, file in given.beside}
        if len({*files, *beside}) < len(given.lifts) + len(given.beside):
            parser.error("Two networks have one name.")
        for file in beside.values():
            weights.load(file.read_bytes())
        hands = {(n.hand, n.gripper) for n in (loaded(file.read_bytes()) for file in files.values())}
        if len(hands) > 1:
            parser.error("The networks of lifts are of several hands.")
    except (OSError, RigError) as error:
        parser.error(str(error))
    numbers = range(given.first, given.first + given.scenes)
    hand, gripper = hands.pop() if hands else (maps.PARALLEL, GRIPPER)
    if (hand == maps.PARALLEL) != (given.export is given.results is None):
        parser.error("With networks for the rig's hand, and only then, either --export or --results is needed.")
    tasks = [PoseTrialTask(given.split, number, given.ggcnn, beside, files, gripper) for number in numbers]
    methods = [*ALL, *beside, *(f"{name}, {way}" for name in files for way in WAYS)]
    rows: list[dict[str, Any]] = []
    try:
        if given.export is not None:
            lift_file.write(given.export, exported, tasks, given.processes)
            return
        pool_of = multiprocessing.get_context("spawn").Pool
        with open_results(given.folder, COLUMNS) as writer, pool_of(given.processes) as pool:
            tried = pool.imap(try_scene, tasks) if given.results is None else of_results(given.results, tasks)
            for new in tqdm(tried, total=len(tasks), unit="scene"):
                writer.writerows(new)
                rows += new
    except (RigError, OSError) as error:
        parser.error(str(error))
    settings = {name: getattr(given, name) for name in ("split", "first", "scenes")}
    hashes = {
        file.name: weights.checked_sha256(file.read_bytes(), None)
        for file in (given.ggcnn, *beside.values(), *files.values())
    }
    settings["weights"] = hashes
    (given.folder / "settings.json").write_text(json.dumps(settings, indent=2) + "\n")
    sys.stdout.write(report(given.folder, rows, methods))
    drawn = {name: [row for row in rows if row["method"] == name] for name in methods}
    draw_failures(given.folder, given.split, drawn, given.processes)
