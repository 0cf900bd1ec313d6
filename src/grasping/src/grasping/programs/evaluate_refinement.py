"""Compares what predicts a person's grasps, on episodes that no training saw; resumable.

GGCNN alone as the episodes recorded it, with the person's constant offset, the nearest neighbour among the training
episodes, and GGCNN with the second network: how far from the person's grasp, in the last frame of each episode whose
grasp held. Where the episodes are simulated, each grasp is tried by lifting in MuJoCo too, hand wide open. Results go
to results.csv, one line a grasp, and table.md.
"""

from __future__ import annotations

import argparse
import csv
from functools import lru_cache
from pathlib import Path

import cv2
import mujoco
import numpy as np
import torch
from tqdm import tqdm

from common.errors import RigError
from common.statistics import median, share
from grasping import refinement, weights
from grasping.dataset.labels import own_grasp, pose_from_label, windowed
from grasping.evaluation.person_errors import Neighbours, miss
from grasping.predictor import Predictor, PredictorSettings
from grasping.programs import episode_files
from grasping.programs.evaluate import kept_rows
from grasping.programs.make_dataset import ignore_warning
from grasping.synthetic import episodes
from grasping.training.refinement_examples import constant_offset, offset_label

COLUMNS = ("episode", "object", "method", "position_mm", "rotation_deg", "near", "lifted")
PERSON = "the person"


def methods(training: list[episode_files.Named], first: Path, second: list[tuple[str, str]]) -> dict:
    """Returns for each name what makes of a frame a pose before the camera, shape (4, 4) [m], or None.

    Args:
        training: episodes that teach the offset and the neighbours.
        first: weight file of GGCNN.
        second: names and weight files of second networks.

    Raises:
        RigError: a weight file cannot be used.
        OSError: likewise.
    """
    frames = [f for named in training if named.episode.held for f in named.episode.frames()]
    offset, neighbours = constant_offset(frames), Neighbours(frames)
    network = weights.load(first.read_bytes()).network
    found = {
        "GGCNN alone": lambda frame: _pose(own_grasp(frame)),
        "GGCNN + constant offset": lambda frame: pose_from_label(frame, offset_label(frame, offset)),
        "nearest neighbour": neighbours.grasp,
        PERSON: lambda frame: frame.T_camera_grasp,
    }
    for name, file in second:
        found[name] = _refined(network, refinement.load(Path(file).read_bytes()))
    return found


def _refined(network, second: refinement.Refinement):
    @lru_cache(maxsize=2)
    def predictor(side: int) -> Predictor:
        return Predictor(network, PredictorSettings(side), second)

    def grasp(frame):
        camera = windowed(frame.camera, frame.crop)
        return _pose(predictor(frame.crop.side).predict(frame.depth_m, camera).grasps[0])

    return grasp


def _pose(grasp):
    return None if grasp is None else grasp.T_camera_grasp


def row(named: episode_files.Named, scene, name: str, method) -> dict:
    """Returns the line of one method's grasp in an episode; nothing is lifted where no scene is known."""
    frame = named.episode.frame(len(named.episode) - 1)
    found = method(frame)
    line = {"episode": named.name, "object": named.episode.metadata.object, "method": name}
    if found is None:
        return {**line, "near": False, "lifted": "" if scene is None else False}
    missed = miss(frame.T_camera_grasp, found)
    lifted = "" if scene is None else episodes.held(scene, frame.T_base_camera @ found)
    line.update(position_mm=1000.0 * missed.position, rotation_deg=np.degrees(missed.rotation), near=missed.is_near)
    return {**line, "lifted": lifted}


def table(rows: list[dict], names) -> str:
    """Returns the results as a Markdown table; in brackets the 95 % intervals."""
    lines = [
        "| method | position error mm, median | rotation error deg, median | within 20 mm and 15 deg % | lifted % |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name in names:
        own = [r for r in rows if r["method"] == name]
        cells = []
        for column in COLUMNS[3:]:
            values = [str(r[column]) for r in own if r[column] != ""]
            if not values:
                cells.append("-")
            elif column in ("near", "lifted"):
                cells.append(str(share([v == "True" for v in values])))
            else:
                cells.append(str(median([float(v) for v in values])))
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("training", type=Path, help="folder of the episodes that training saw")
    parser.add_argument("test", type=Path, help="folder of episodes that it did not see")
    parser.add_argument("weights", type=Path, help="weight file of GGCNN")
    parser.add_argument("folder", type=Path, help="where the results go")
    parser.add_argument(
        "--refinement", nargs=2, action="append", default=[], metavar=("NAME", "FILE"), help="a second network"
    )
    parser.add_argument("--held-out", action="store_true", help="test on the episodes that training holds out alone")
    parser.add_argument("--no-lifting", action="store_true", help="lift nothing")
    parser.add_argument("--only", action="append", default=[], metavar="OBJECT", help="test on these things alone")
    parser.add_argument("--without", action="append", default=[], metavar="OBJECT", help="as training had it")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)
    try:
        training = episode_files.read(arguments.training, without=arguments.without)
        training = [named for named in training if not episode_files.is_held_out(named.name)]
        test = [named for named in episode_files.read(arguments.test, only=arguments.only) if named.episode.held]
        if arguments.held_out:
            test = [named for named in test if episode_files.is_held_out(named.name)]
        if not test or not any(named.episode.held for named in training):
            raise RigError(f"Of {len(test)} episodes to test on and {len(training)} to learn from, too few held.")
        found = methods(training, arguments.weights, arguments.refinement)
    except (RigError, OSError) as error:
        parser.error(str(error))
    arguments.folder.mkdir(parents=True, exist_ok=True)
    results = arguments.folder / "results.csv"
    rows = kept_rows(results)
    done = {(r["episode"], r["method"]) for r in rows}
    with results.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="", lineterminator="\n")
        if not rows:
            writer.writeheader()
        for named in tqdm(test, unit="episode"):
            missing = [name for name in found if (named.name, name) not in done]
            at = None if arguments.no_lifting else episodes.scene_of(named.name)
            scene = episodes.situation(*at) if at and missing else None
            for name in missing:
                line = {**dict.fromkeys(COLUMNS, ""), **row(named, scene, name, found[name])}
                writer.writerow(line)
                rows.append(line)
            file.flush()
    (arguments.folder / "table.md").write_text(table(rows, found))
