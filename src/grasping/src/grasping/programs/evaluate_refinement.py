"""Compares what predicts a person's grasps, on episodes that no training saw; resumable.

GGCNN alone, with the person's constant offset, the nearest neighbour among the training episodes, and GGCNN with the
second network: how far from the person's grasp, in the last frame of each episode whose grasp held; all maps are
smoothed alike. Where the episodes are simulated, each grasp is tried by lifting in MuJoCo too, hand wide open, and the
bound is what the simulated person intended: the grasp without the tremor, which nobody can foresee. Results go to
results.csv, one line a grasp, and table.md, with the differences over the same episodes. Where second networks learned
from different numbers of episodes, as settings.json beside their files says, curve.png shows what more of them bring.
"""

from __future__ import annotations

import argparse
import csv
import json
from functools import lru_cache
from pathlib import Path

import cv2
import mujoco
import numpy as np
import torch
from tqdm import tqdm

from common.errors import RigError
from common.poses import inverse
from common.statistics import median, paired_difference, share
from grasping import refinement, weights
from grasping.dataset.labels import own_grasp, pose_from_label, windowed
from grasping.evaluation import learning_curve
from grasping.evaluation.person_errors import NEAR_M, Neighbours, miss
from grasping.predictor import Predictor, PredictorSettings
from grasping.programs import episode_files
from grasping.programs.evaluate import NETWORK_SMOOTHING, kept_rows
from grasping.programs.make_dataset import ignore_warning
from grasping.synthetic import episodes
from grasping.training.refinement_examples import constant_offset, offset_label

FIRST = 3
"""So many of a method's grasps are what a person is offered."""
COLUMNS = ("episode", "object", "method", "position_mm", "rotation_deg", "near", "nearest_of_3_mm", "lifted")
ALONE, OFFSET, NEIGHBOUR, BOUND = "GGCNN alone", "GGCNN + constant offset", "nearest neighbour", "bound: without tremor"
MEASURES = {
    "position error mm, median": (np.median, lambda r: float(r["position_mm"] or "inf")),
    "within 20 mm %": (np.mean, lambda r: 100.0 * _within(r["position_mm"])),
    "rotation error deg, median": (np.median, lambda r: float(r["rotation_deg"] or "inf")),
    "within 20 mm and 15 deg %": (np.mean, lambda r: 100.0 * (r["near"] == "True")),
    "one of three within 20 mm %": (np.mean, lambda r: 100.0 * _within(r["nearest_of_3_mm"])),
    "lifted %": (np.mean, lambda r: 100.0 * (r["lifted"] == "True")),
}
"""Columns of the tables: what is made of the episodes' values, and the value of a line of results.csv."""


def methods(training: list[episode_files.Named], first: Path, second: list[tuple[str, str]]) -> dict:
    """Returns for each name what makes poses before the camera of a frame, each of shape (4, 4) [m], best first.

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
    predict = _predicting(network, None)

    def own(frame):
        frames = (frame._replace(peak=peak) for peak in predict(frame).peaks)
        return [f for f in frames if own_grasp(f) is not None]

    found = {
        ALONE: lambda frame: [own_grasp(f).T_camera_grasp for f in own(frame)],
        OFFSET: lambda frame: [pose_from_label(f, offset_label(f, offset)) for f in own(frame)],
        NEIGHBOUR: lambda frame: [neighbours.grasp(f) for f in own(frame)[:1]],
    }
    for name, file in second:
        found[name] = _refined(network, refinement.load(Path(file).read_bytes()))
    return found


def _predicting(network, second: refinement.Refinement | None):
    """Returns what makes the prediction for a frame."""

    @lru_cache(maxsize=2)
    def predictor(side: int) -> Predictor:
        settings = PredictorSettings(side, smoothing=NETWORK_SMOOTHING, count=FIRST, threshold=0.0)
        return Predictor(network, settings, second)

    return lambda frame: predictor(frame.crop.side).predict(frame.depth_m, windowed(frame.camera, frame.crop))


def _refined(network, second: refinement.Refinement):
    predict = _predicting(network, second)
    return lambda frame: [g.T_camera_grasp for g in predict(frame).grasps if g is not None]


def row(named: episode_files.Named, scene, name: str, method, lift: bool) -> dict:
    """Returns the line of one method's grasp in an episode.

    Args:
        named: the episode.
        scene: that it shows, None where it is no simulated one; only then the bound is known, and grasps are lifted.
        name: of the method.
        method: as `methods` has it.
        lift: whether to lift.
    """
    frame = named.episode.frame(len(named.episode) - 1)
    line = {**dict.fromkeys(COLUMNS, ""), "episode": named.name, "object": named.episode.metadata.object}
    line.update(method=name, near="False")
    if name == BOUND:
        found = [inverse(frame.T_base_camera) @ episodes.intended(scene, named.episode)]
    else:
        found = method(frame)
    lift = lift and scene is not None
    if not found:
        return {**line, "lifted": "False" if lift else ""}
    misses = [miss(frame.T_camera_grasp, T) for T in found]
    line.update(position_mm=1000.0 * misses[0].position, rotation_deg=np.degrees(misses[0].rotation))
    line.update(near=str(misses[0].is_near), nearest_of_3_mm=1000.0 * min(m.position for m in misses))
    if lift:
        line["lifted"] = str(episodes.held(scene, frame.T_base_camera @ found[0]))
    return line


def _within(millimetres) -> bool:
    return millimetres != "" and float(millimetres) < 1000.0 * NEAR_M


def tables(rows: list[dict], names: list[str], second: list[str]) -> str:
    """Returns the results as Markdown, and the differences of the second networks to GGCNN alone and with the offset;
    in brackets the 95 % intervals.

    Args:
        rows: lines of results.csv.
        names: of all methods.
        second: of second networks.
    """
    of = {name: {r["episode"]: r for r in rows if r["method"] == name} for name in (*names, *second)}
    measures = {k: v for k, v in MEASURES.items() if k != "lifted %" or any(r["lifted"] != "" for r in rows)}
    lines = [_line("method", *measures), _line(*["---"] * (1 + len(measures)))]
    for name in names:
        cells = []
        for statistic, value in measures.values():
            values = [value(r) for r in of[name].values()]
            cells.append(str(median(values) if statistic is np.median else share(np.array(values) > 0.0)))
        lines.append(_line(name, *cells))
    lines += ["", _line("difference", *measures), _line(*["---"] * (1 + len(measures)))]
    for name in second:
        for other in (ALONE, OFFSET):
            episodes_of = sorted(of[name].keys() & of[other].keys())
            cells = [
                str(paired_difference(*([value(of[m][e]) for e in episodes_of] for m in (name, other)), statistic))
                for statistic, value in measures.values()
            ]
            lines.append(_line(f"{name} less {other}", *cells))
    return "\n".join(lines) + "\n"


def curve(rows: list[dict], second: list[tuple[str, str]], path: Path) -> None:
    """Draws the learning curve if there is one.

    Args:
        rows: lines of results.csv.
        second: names and weight files of second networks.
        path: of the picture.
    """
    counts = {}
    for name, file in second:
        about = Path(file).with_name("settings.json")
        if about.exists():
            counts[json.loads(about.read_text())["episodes"]] = name
    if len(counts) < 2:
        return
    _, error = next(iter(MEASURES.values()))
    of = {name: [error(r) for r in rows if r["method"] == name] for name in (*counts.values(), ALONE, OFFSET, BOUND)}
    others = {name: of[name] for name in (ALONE, OFFSET, BOUND) if of[name]}
    learning_curve.draw(path, {n: of[name] for n, name in counts.items()}, others, 1000.0 * NEAR_M)


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


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
    if all(episodes.scene_of(named.name) for named in test):
        found[BOUND] = None
    arguments.folder.mkdir(parents=True, exist_ok=True)
    results = arguments.folder / "results.csv"
    rows = kept_rows(results)
    done = {(r["episode"], r["method"]) for r in rows}
    with results.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        if not rows:
            writer.writeheader()
        for named in tqdm(test, unit="episode"):
            missing = [name for name in found if (named.name, name) not in done]
            at = episodes.scene_of(named.name)
            scene = episodes.situation(*at) if at and missing else None
            for name in missing:
                line = row(named, scene, name, found[name], not arguments.no_lifting)
                writer.writerow(line)
                rows.append(line)
            file.flush()
    (arguments.folder / "table.md").write_text(tables(rows, list(found), [name for name, _ in arguments.refinement]))
    curve(rows, arguments.refinement, arguments.folder / "curve.png")
